"""The photos of a run on the device, sent once."""

import numpy as np
import torch
from torch import Tensor

from ..arrays import Bool, Float32, UInt8
from .training_photos import Photo, TrainingPhotos

MEMORY_BYTES = 1 << 30
Outside = Bool[Tensor, "h w 1"] | None


class DevicePhotos:
    """Photos by index: colours in [0, 1], and where there is none, or None: there is everywhere.

    They stay on the device as bytes, the first that fit into MEMORY_BYTES; the others are sent each time.
    """

    def __init__(self, photos: TrainingPhotos, device: str) -> None:
        self._photos, self._device, self._room = photos, device, MEMORY_BYTES
        self._kept: dict[int, tuple[UInt8[Tensor, "h w 3"], Outside]] = {}

    def __getitem__(self, index: int) -> tuple[Float32[Tensor, "h w 3"], Outside]:
        pixels, outside = self._kept.get(index) or self._sent(index)
        return pixels * (1 / 255), outside

    def smaller(self, index: int, width: int, height: int) -> tuple[Float32[Tensor, "h w 3"], Outside]:
        """Return a photo on a coarser raster, made and sent anew each time."""
        pixels, outside = _on_device(self._photos[index].smaller(width, height), self._device)
        return pixels * (1 / 255), outside

    def _sent(self, index: int) -> tuple[UInt8[Tensor, "h w 3"], Outside]:
        sent = _on_device(self._photos[index], self._device)
        size = sum(tensor.nbytes for tensor in sent if tensor is not None)
        if size <= self._room:
            self._kept[index] = sent
            self._room -= size
        return sent


def _on_device(photo: Photo, device: str) -> tuple[UInt8[Tensor, "h w 3"], Outside]:
    pixels = torch.tensor(photo.pixels, device=device)
    unused = photo.unused
    if not len(unused):
        return pixels, None
    outside = torch.zeros((*pixels.shape[:2], 1), dtype=torch.bool, device=device)
    places = np.flatnonzero(unused) if photo.left_out is not None else unused
    outside.view(-1)[torch.tensor(places, device=device).long()] = True
    return pixels, outside
