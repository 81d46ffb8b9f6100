"""Encoders that compute with torch: batches, cached texts, unit vectors. Subclasses run a model."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Embeddings, OtherPixels
from ...errors import FormatError, InputError
from ...scene.encoders import EncoderIdentity
from .devices import fitting
from .preprocessing import Preprocessing
from .pretrained import weights_hash

BATCH_BYTES = {"cpu": 5 << 20, "mps": 20 << 20, "cuda": 80 << 20}
"""Input bytes per pass by device: 8 images of 224 pixels on a CPU, where more do not fit its caches."""
TEXTS_PER_BATCH, MAX_CACHED_TEXTS = 64, 4096


class TorchEncoder(ABC):
    """Encoder of images and texts to unit vectors; see `loading.load_encoder`.

    identity: name as asked for, hash of the weights, preprocessing. device, dtype: where and in what precision images
    are computed; texts always in float32. batch: images per pass, reduced when the device's memory was full.
    The last MAX_CACHED_TEXTS texts are cached.
    """

    def __init__(
        self, name: str, dim: int, weights: list[Path], preprocessing: Preprocessing, device: str, dtype: str
    ) -> None:
        self.identity = EncoderIdentity(name, dim, weights_hash(weights), str(preprocessing))
        self.preprocessing, self.device, self.dtype = preprocessing, device, dtype
        self.batch = max(1, BATCH_BYTES[device] // (12 * preprocessing.side**2))
        self._texts: dict[str, Any] = {}

    def encode_images(self, images: Sequence[OtherPixels]) -> Embeddings:
        """Return unit vectors of images of any size, in their order; one batch at a time is in memory.

        Raises: InputError: an image without pixels. FormatError: a vector without direction. DrSplatError: not even
        one image fits into the device's memory.
        """
        rows: list[np.ndarray] = []
        done = 0
        while done < len(images):
            fits = fitting(self._image_rows, images[done : done + self.batch], "images")
            done += sum(map(len, fits))
            rows += fits
            self.batch = max(1, self.batch // len(fits))
        return self._unit(rows, "image")

    def encode_texts(self, texts: Sequence[str]) -> Embeddings:
        """Return unit vectors of the texts as they are: no prompt is put around them.

        Raises: InputError: a model without texts, a text that is empty or too long, no tokenizer.
        FormatError: a vector without direction.
        """
        self._check_texts(texts)
        rows = {text: self._texts.pop(text, None) for text in texts}
        new = [text for text, row in rows.items() if row is None]
        for start in range(0, len(new), TEXTS_PER_BATCH):
            block = new[start : start + TEXTS_PER_BATCH]
            rows |= zip(block, self._unit([self._text_rows(block)], "text"), strict=True)
        self._texts |= rows  # so the last ones asked for come last
        for text in list(self._texts)[:-MAX_CACHED_TEXTS]:
            self._texts.pop(text, None)
        return np.stack([rows[text] for text in texts]) if rows else np.empty((0, self.identity.dim), np.float32)

    @abstractmethod
    def _features(self, values: Any) -> np.ndarray:
        """Run the model on (b, 3, side, side) scaled images, a tensor in `dtype` on `device`; one row for each."""

    @abstractmethod
    def _text_rows(self, texts: Sequence[str]) -> np.ndarray:
        """Run the model on texts. Raises: InputError: one is too long."""

    def _image_rows(self, images: Sequence[np.ndarray]) -> np.ndarray:
        with import_module("torch").inference_mode():
            return self._features(self._scaled(images))

    def _scaled(self, images: Sequence[np.ndarray]) -> Any:
        torch = import_module("torch")
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # a GPU would wait for one core's scaling
            scaled = list(pool.map(self.preprocessing.pixel_values, images))
        return torch.from_numpy(np.stack(scaled)).to(getattr(torch, self.dtype)).to(self.device)

    def _check_texts(self, texts: Sequence[str]) -> None:
        if isinstance(texts, str):
            raise InputError(f"texts: expected a list of texts, got the single text {texts!r}")
        empty = [text for text in texts if not text.strip()]
        if empty:
            raise InputError(f"{empty[0]!r} is empty: name an object, e.g. 'a red mug'")

    def _unit(self, blocks: Sequence[np.ndarray], what: str) -> Embeddings:
        rows = np.concatenate([np.empty((0, self.identity.dim), np.float32), *blocks])
        norms = np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
        bad = np.flatnonzero(~(np.isfinite(norms) & (norms > 0)))
        if len(bad):
            raise FormatError(
                f"{self.identity.name}: the vector of {what} {bad[0]} of {len(rows)} has no direction (zero or not "
                f"finite): the weights are damaged, or {self.dtype} is too coarse for them: try dtype 'float32'"
            )
        return np.asarray(rows / norms, np.float32)


def as_rows(tensor: Any) -> np.ndarray:
    """Return a tensor as float32 on the host."""
    return tensor.float().cpu().numpy()
