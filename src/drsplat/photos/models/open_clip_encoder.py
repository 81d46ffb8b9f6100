"""Image-text models by open_clip's own library: those that transformers has not, such as PE-Core and MobileCLIP2.

Images are scaled by drsplat, as for every other encoder; the library has the architectures and the tokens of texts.
"""

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, MissingExtraError, pip_install
from .devices import chosen_device, chosen_dtype
from .open_clip_settings import embedding_size, open_clip_preprocessing
from .preprocessing import OPENAI, Preprocessing
from .pretrained import OPEN_CLIP, OPEN_CLIP_CONFIG, check_headers, model_errors, no_weights
from .torch_encoder import TorchEncoder, as_rows


def open_clip_library() -> Any:
    """Return the module open_clip. Raises: MissingExtraError: not installed, or it cannot be imported; says why."""
    if find_spec("open_clip") is None:
        raise MissingExtraError(
            f"models such as PE-Core and MobileCLIP2 need open_clip_torch, not installed: {pip_install('open-clip')}, "
            "which brings the torchvision that must belong to the installed torch; other encoders need neither"
        )
    try:
        return import_module("open_clip")
    except (ImportError, OSError, RuntimeError, AttributeError) as error:
        raise MissingExtraError(
            f"open_clip_torch is installed but cannot be imported: {error}. It needs timm and the torchvision of the "
            f"installed torch: {pip_install('open-clip')}"
        ) from error


class OpenClipEncoder(TorchEncoder):
    """Model of open_clip in a folder with open_clip_config.json and open_clip_model.safetensors; see TorchEncoder."""

    def __init__(self, name: str, folder: Path, device: str = "auto", dtype: str = "auto") -> None:
        """Load the model.

        Raises: InputError: no settings, no safetensors. FormatError: damaged ones, or they do not fit each other.
        MissingExtraError: as `open_clip_library`.
        """
        self._library = open_clip_library()
        device = chosen_device(device)
        dtype = chosen_dtype(dtype, device)
        weights = folder / OPEN_CLIP
        if not (folder / OPEN_CLIP_CONFIG).is_file():
            raise InputError(
                f"{folder}: has no {OPEN_CLIP_CONFIG}, so it is no folder of open_clip's: load it by its plain name"
            )
        if not weights.is_file():
            raise InputError(no_weights(folder))
        check_headers([weights])
        dim = embedding_size(folder / OPEN_CLIP_CONFIG)
        with model_errors(folder, "model of open_clip"):
            model = self._library.create_model(
                f"local-dir:{folder}", require_pretrained=True, pretrained_text=False, weights_only=True
            )
            self._tokenizer = self._library.get_tokenizer(f"local-dir:{folder}")
        self._model = model.eval().to(device)
        self._model.visual.to(getattr(import_module("torch"), dtype))
        size = self._model.visual.image_size  # which the model takes, whatever the file says
        side = size if isinstance(size, int) else size[0]
        preprocessing = open_clip_preprocessing(folder, Preprocessing(side, "bicubic", *OPENAI))
        super().__init__(name, dim, [weights], replace(preprocessing, side=side), device, dtype)

    def _features(self, values: Any) -> np.ndarray:
        return as_rows(self._model.encode_image(values))

    def _text_rows(self, texts: Sequence[str]) -> np.ndarray:
        tokens = self._tokens(texts).to(self.device)
        with import_module("torch").inference_mode():
            return as_rows(self._model.encode_text(tokens))

    def _tokens(self, texts: Sequence[str]) -> Any:
        """Return the tokens of texts. The library cuts long texts silently; one token more shows it.

        Raises: InputError: a text is too long.
        """
        most = self._tokenizer.context_length
        *ends, padding = self._tokenizer([*texts, ""], context_length=most + 1)[:, most].tolist()
        for text, end in zip(texts, ends, strict=True):
            if end != padding:
                raise InputError(
                    f"{text[:60]!r} has more than the {most} tokens that {self.identity.name} reads: shorten it"
                )
        return self._tokenizer(list(texts))
