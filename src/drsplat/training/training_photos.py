"""The photos of a run: decoded, undistorted and resized once, kept as bytes; and their order."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import NamedTuple

import numpy as np
from PIL import Image

from ..base.arrays import Arrays, ArraysByName, Float32, Mask, Pixels
from ..scene.photo_masks import load_mask
from ..scene.photos import load_image, photo_coverage
from ..scene.views import View


class Photo(NamedTuple):
    """The pixels of a photo, and which of them say nothing.

    outside: True where no photo covers a pixel once its lens is undone. left_out: True where the photo's mask leaves a
    pixel out. None for nowhere.
    """

    pixels: Pixels
    outside: Mask | None = None
    left_out: Mask | None = None

    @property
    def unused(self) -> Mask | None:
        """The pixels that take no part."""
        if self.outside is None or self.left_out is None:
            return self.outside if self.left_out is None else self.left_out
        return self.outside | self.left_out

    @property
    def num_bytes(self) -> int:
        """Memory that is this photo's own."""
        return self.pixels.nbytes + (0 if self.left_out is None else self.left_out.nbytes)

    def smaller(self, width: int, height: int) -> "Photo":
        """Return it on a coarser raster: means of pixels, of which none is used that has a part of an unused one."""
        size, unused = (width, height), self.unused
        # a box would take whole pixels, not parts of them
        weights = Image.Resampling.BILINEAR if self.pixels.shape[1] % width else Image.Resampling.BOX
        pixels = np.asarray(Image.fromarray(self.pixels).resize(size, weights))
        if unused is None:
            return Photo(pixels)
        marks = Image.fromarray(unused * np.uint8(255)).resize(size, weights)
        coarse = np.asarray(marks) > 0
        return Photo(pixels, coarse) if self.left_out is None else Photo(pixels, None, coarse)

    def colors(self) -> Float32[np.ndarray, "h w 3"]:
        """Return colours in [0, 1]."""
        return self.pixels * np.float32(1 / 255)


class TrainingPhotos:
    """Photos by index. The first that fit into `memory_bytes` are kept, the others read again.

    With a random order nothing better can be kept than any fixed share of the photos.
    """

    def __init__(self, views: Sequence[View], memory_bytes: int) -> None:
        self._views, self._room = views, memory_bytes
        self._kept: dict[int, Photo] = {}
        self._coarse: dict[int, Photo] = {}
        self._outside: dict[tuple[object, ...], Mask | None] = {}
        self._counting = Lock()

    def __len__(self) -> int:
        return len(self._views)

    def with_masks_of(self, views: Sequence[View]) -> "TrainingPhotos":
        """Return the photos of the same views with other masks; those that are kept are not read again."""
        photos = TrainingPhotos(views, self._room + sum(photo.num_bytes for photo in self._coarse.values()))
        photos._outside = self._outside
        for index, photo in self._kept.items():
            if views[index].mask_path != self._views[index].mask_path:
                photo = photo._replace(left_out=_left_out(views[index]))
                photos._room += self._kept[index].num_bytes - photo.num_bytes
            photos._kept[index] = photo
        return photos

    def read_all(self, threads: int) -> None:
        """Read photos by several threads, as many as are kept: else each is read when it is first asked for."""
        with ThreadPoolExecutor(threads) as pool:
            for begin in range(0, len(self), threads):
                few = list(pool.map(self.__getitem__, range(begin, min(begin + threads, len(self)))))
                if few[-1].num_bytes > self._room:
                    return

    def __getitem__(self, index: int) -> Photo:
        if index in self._kept:
            return self._kept[index]
        view = self._views[index]
        photo = Photo(load_image(view), self._outside_of(view), _left_out(view))
        with self._counting:
            if photo.num_bytes <= self._room:
                self._kept[index] = photo
                self._room -= photo.num_bytes
        return photo

    def on_raster(self, index: int, width: int, height: int) -> Photo:
        """Return a photo on this raster; the last coarser one of each photo is kept, while there is room."""
        if index in self._coarse and self._coarse[index].pixels.shape[:2] == (height, width):
            return self._coarse[index]
        photo = self[index]
        if photo.pixels.shape[:2] != (height, width):
            if index in self._coarse:
                self._room += self._coarse.pop(index).num_bytes
            photo = photo.smaller(width, height)
            if photo.num_bytes <= self._room:
                self._coarse[index] = photo
                self._room -= photo.num_bytes
        return photo

    def _outside_of(self, view: View) -> Mask | None:
        """Return where the lens covers no pixel; the views of one camera share it."""
        camera = (view.width, view.height, view.distortion, view.K.tobytes())
        with self._counting:
            if camera not in self._outside:
                marks = ~photo_coverage(view)
                outside = marks if marks.any() else None
                if outside is not None and outside.nbytes > self._room:
                    return outside
                self._outside[camera] = outside
                self._room -= 0 if outside is None else outside.nbytes
            return self._outside[camera]


def _left_out(view: View) -> Mask | None:
    kept = load_mask(view)
    return None if kept is None else ~kept


class ViewOrder:
    """Every view once in random order, then again in another, and so on."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.pending = np.empty(0, np.int64)

    def next(self, rng: np.random.Generator) -> int:
        if len(self.pending) == 0:
            self.pending = rng.permutation(self.count)
        following, self.pending = int(self.pending[0]), self.pending[1:]
        return following

    def state(self) -> Arrays:
        return {"order.pending": self.pending}

    def restore(self, state: ArraysByName) -> None:
        self.pending = np.array(state["order.pending"], np.int64)
