"""Encoders by name."""

from typing import TYPE_CHECKING

from .libraries import models_library
from .mini import MiniEncoder
from .pretrained import DEFAULT_ENCODER as DEFAULT_ENCODER
from .pretrained import model_folder
from .words import WordEncoder

if TYPE_CHECKING:
    from .torch_encoder import TorchEncoder

OPEN_CLIP_PREFIXES = ("hf-hub:", "open_clip:")
"""Prefixes of names that open_clip's own library loads; the first is that library's own."""


def load_encoder(
    name: str = DEFAULT_ENCODER, device: str = "auto", dtype: str = "auto", *, threads: int = 0
) -> "WordEncoder | MiniEncoder | TorchEncoder":
    """Load a built-in encoder, or a CLIP, MetaCLIP 2, SigLIP, SigLIP 2, DINOv2, DINOv3 or TIPSv2 of transformers.

    name: "drsplat-words", "drsplat-mini", a folder as `save_pretrained` or OpenCLIP writes it, or an id of the Hugging
    Face hub, which is downloaded unless it is cached. Only safetensors are loaded, never pickles.
    After "hf-hub:" or "open_clip:" it is loaded by open_clip's own library (the extra open-clip), which has models
    that transformers has not, such as "hf-hub:timm/PE-Core-B-16".
    device: auto, cpu, cuda or mps. dtype of images: auto, float32, bfloat16 or float16; auto is
    float16 on CUDA and bfloat16 on processors that multiply it. threads: of drsplat-mini, 0 for all cores; the
    libraries of the others have settings of their own.

    Raises: InputError: no such model, a gated one, another architecture, pickles, no such device.
    FormatError: damaged or missing weights. MissingExtraError: torch, transformers, open_clip or the device is
    absent or unusable. DrSplatError: no network.

    >>> ds.load_encoder("drsplat-mini").encode_texts(["red mug"]).shape
    (1, 512)
    """
    if name == WordEncoder.identity.name:
        return WordEncoder()
    if name == MiniEncoder.name:
        return MiniEncoder(threads=threads)
    for prefix in OPEN_CLIP_PREFIXES:
        if name.startswith(prefix):
            from .open_clip_encoder import OpenClipEncoder, open_clip_library

            open_clip_library()  # fail before a useless download
            return OpenClipEncoder(*model_folder(name, prefix), device, dtype)
    models_library()
    called, folder = model_folder(name)
    from .dense_encoder import DensePatchEncoder
    from .transformers_encoders import TransformersEncoder, family_of

    kind = DensePatchEncoder if family_of(called, folder).dense else TransformersEncoder
    return kind(called, folder, device, dtype)
