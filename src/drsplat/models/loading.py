"""An encoder by its name."""

from pathlib import Path
from typing import TYPE_CHECKING

from .libraries import models_library
from .mini import MiniEncoder
from .pretrained import model_folder
from .words import WordEncoder

if TYPE_CHECKING:
    from .transformers_encoders import TransformersEncoder

DEFAULT_ENCODER = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
"""The paper's. Source: Dr. Splat Sec. A."""
OPENCLIP_NAMES = {"ViT-B-16/laion2b_s34b_b88k": DEFAULT_ENCODER}
"""The same model as LangSplat and OpenCLIP name it."""


def load_encoder(
    name: str = DEFAULT_ENCODER, device: str = "auto", dtype: str = "auto", *, threads: int = 0
) -> "WordEncoder | MiniEncoder | TransformersEncoder":
    """A built-in encoder, or a CLIP, SigLIP, SigLIP 2 or DINOv2 of transformers.

    name: "drsplat-words", "drsplat-mini", a folder as `save_pretrained` or OpenCLIP writes it, or an id of the Hugging
    Face hub, which is downloaded unless it is cached. Only safetensors are loaded, never pickles.
    device: auto, cpu, cuda or mps. dtype of images: auto, float32, bfloat16 or float16; auto is
    float16 on CUDA and bfloat16 on processors that multiply it. threads: of drsplat-mini, 0 for all cores; the
    libraries of the others have settings of their own.

    Raises: InputError: no such model, a gated one, another architecture, pickles, no such device.
    FormatError: damaged or missing weights. MissingExtraError: torch, transformers or the device is
    absent or unusable. DrSplatError: no network.
    """
    if name == WordEncoder.identity.name:
        return WordEncoder()
    if name == MiniEncoder.name:
        return MiniEncoder(threads=threads)
    models_library()
    folder = model_folder(OPENCLIP_NAMES.get(name, name))
    from .transformers_encoders import TransformersEncoder

    called = folder.resolve().name if Path(name).expanduser().is_dir() else name
    return TransformersEncoder(called, folder, device, dtype)
