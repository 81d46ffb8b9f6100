"""Columns of W of each view: computed once, stored on disk, stacked into a sparse matrix."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Embeddings, MaskIds, UnsignedIds
from ...errors import FormatError, InputError, MismatchError
from ...formats.tensors import map_tensors, read_tensors, write_tensors
from ...kernels import SplatArrays, Triples, default_isa, splat_arrays
from ...kernels.algebra import place_entries
from ...kernels.cuda.devices import device_in_use
from ...scene.gaussians import Gaussians, ShapesDigest
from ...scene.masks.features import ViewFeatures
from ...scene.moving import Moving
from ...scene.photo_masks import load_mask
from ...scene.photos import undistort_ids
from ...scene.views import View, same_aspect
from .aggregation import Sampling
from .evidence import csr_of
from .provenance import KEY_BYTES

COLUMNS_VERSION = "2"


@dataclass(frozen=True, eq=False)
class Columns:
    """Part of W of one view, its triples on disk at `path`; mask s is its column s. key: hash of its inputs."""

    view_name: str
    path: Path
    embeddings: Embeddings
    key: bytes

    def triples(self) -> Triples:
        tensors, _ = map_tensors(self.path)
        return Triples(tensors["gaussian_ids"], tensors["segment_ids"], tensors["weights"])


class VisibleSplats(NamedTuple):
    """Gaussians in front of a camera. rows: of the scene, ascending; None: all of them."""

    splats: SplatArrays
    rows: UnsignedIds | None = None


@runtime_checkable
class Scenery(Protocol):
    """Scene that views look at. digest: hash of all that decides what a view sees. near: see `SplatArrays`."""

    @property
    def near(self) -> float: ...
    def digest(self, view: View) -> str: ...
    def visible_splats(self, view: View) -> VisibleSplats: ...


@dataclass(frozen=True, eq=False)
class StillScenery:
    """Still scene in memory; every camera sees all of it."""

    gaussians: Gaussians
    given_near: float | None = None

    @cached_property
    def splats(self) -> SplatArrays:
        return splat_arrays(self.gaussians, self.given_near)

    @property
    def near(self) -> float:
        return self.gaussians.near if self.given_near is None else self.given_near

    @cached_property
    def _digest(self) -> str:
        return f"{ShapesDigest(self.gaussians.origin).add(self.gaussians).text()} {self.near!r}"

    def digest(self, view: View) -> str:
        return self._digest

    def visible_splats(self, view: View) -> VisibleSplats:
        return VisibleSplats(self.splats)


class MovingScenery:
    """Moving scene; every camera sees it at the time of its photo. The scene at the last time is cached.

    near: one for the whole film. Raises: InputError: a view has no time, or one outside of the scene's span.
    """

    def __init__(self, moving: Moving, given_near: float | None = None) -> None:
        self.moving, self.near = moving, moving.canonical.near if given_near is None else given_near
        self._at = lru_cache(maxsize=1)(lambda time: StillScenery(moving.at(time), self.near))

    def digest(self, view: View) -> str:
        return self._at(time_of(view)).digest(view)

    def visible_splats(self, view: View) -> VisibleSplats:
        return self._at(time_of(view)).visible_splats(view)


def scenery_of(scene: Gaussians | Moving, near: float | None = None) -> StillScenery | MovingScenery:
    """Return the scenery of a scene in memory, still or moving."""
    return MovingScenery(scene, near) if isinstance(scene, Moving) else StillScenery(scene, near)


def time_of(view: View) -> float:
    """Return the time of a view of a moving scene. Raises: InputError: it has none."""
    if view.time is None:
        raise InputError(
            f"view '{view.name}' has no time, and the scene moves: give times=TABLE.csv or a pattern of names such as "
            "cam*/frame_{time}.png, or a transforms.json with the time of each frame"
        )
    return view.time


@dataclass(frozen=True, eq=False)
class ColumnMaker:
    """Maker of the columns of one scene's views in `folder`; it recognises those that are there already."""

    scenery: Scenery
    folder: Path
    sampling: Sampling
    threads: int

    def columns(self, view: View, features: ViewFeatures) -> tuple[Columns, bool]:
        """Return the view's columns, and whether they were computed now: the very same ones may be in the folder.

        Raises: MismatchError: the map has another shape than the photo.
        """
        mask_ids, path = _mask_ids(view, features), self.folder / part_name(view.name)
        self.scenery.digest(view)  # before a thread asks for it again
        with ThreadPoolExecutor(1) as pool:  # hashing takes a tenth of the time that weights take
            hashed = pool.submit(self._key, view, mask_ids)
            is_new = not (path.exists() and is_finished(path, _marks(hashed.result())))
            triples = self._triples(view, mask_ids) if is_new else None
        key = hashed.result()
        if triples is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            tensors = dict(zip(("gaussian_ids", "segment_ids", "weights"), triples, strict=True))
            write_tensors(path, tensors, _marks(key) | {"view": view.name}, overwrite=True)
        return Columns(view.name, path, features.embeddings, key), is_new

    def _triples(self, view: View, mask_ids: MaskIds) -> Triples:
        splats, rows = self.scenery.visible_splats(view)
        triples = self.sampling.triples(splats, view, mask_ids, self.threads)
        return triples if rows is None else triples._replace(gaussian_ids=rows[triples.gaussian_ids])

    def key(self, view: View, features: ViewFeatures) -> bytes:
        """Return a hash of all that decides a view's columns; equal keys mean equal columns on one instruction set.

        Raises: MismatchError: the map has another shape than the photo.
        """
        return self._key(view, _mask_ids(view, features))

    def _key(self, view: View, mask_ids: MaskIds) -> bytes:
        sampling = self.sampling
        pixels = "" if sampling.pixels == "all" else f" {sampling.pixels}"
        salt = f"{COLUMNS_VERSION} {sampling.topk} {sampling.first_hits}{pixels} {self.scenery.digest(view)}"
        return digest_of(view.K, view.cam_from_world, mask_ids, salt=salt)


def _marks(key: bytes) -> dict[str, str]:
    """Return what a finished file is known by: also the instruction set or device, which changes the last bits."""
    device = device_in_use()
    return {"key": key.hex(), "isa": default_isa() if device == "cpu" else device}


def _mask_ids(view: View, features: ViewFeatures) -> MaskIds:
    """Return the mask map on the view's raster, undistorted; -1 also where the photo's mask leaves a pixel out."""
    height, width = features.mask_ids.shape
    if not same_aspect((width, height), view.size):
        raise MismatchError(
            f"the masks of '{view.name}' are {width}x{height}, its photo {view.width}x{view.height}: another "
            "aspect ratio. Make the masks on the photos as they are stored (uncropped, not rotated by EXIF)"
        )
    mask_ids = undistort_ids(view, features.resized(*view.size).mask_ids)
    kept = load_mask(view)
    return mask_ids if kept is None else np.where(kept, mask_ids, np.int32(-1))


def part_name(view_name: str) -> str:
    """Return the name of the file of a view's columns."""
    digest = hashlib.blake2b(view_name.encode(), digest_size=12).hexdigest()
    return f"{digest}.columns.safetensors"


def digest_of(*arrays: np.ndarray, salt: str = "") -> bytes:
    """Return a hash of arrays and a text."""
    digest = hashlib.blake2b(salt.encode(), digest_size=KEY_BYTES)
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def is_finished(path: Path, marks: Mapping[str, str]) -> bool:
    """Return whether the file exists, is not damaged and was made with the same marks."""
    if not path.exists():
        return False
    try:
        return marks.items() <= read_tensors(path)[1].items()
    except FormatError:  # a damaged part is computed again
        return False


def stacked(views: Sequence[Callable[[], Triples]], widths: Sequence[int], num_rows: int) -> csr_array:
    """Stack the views' triples into W (N, M) in CSR form, in two passes over them; 8 bytes per weight.

    Columns stay in the order of the views; within a row they are ascending. views: each reads one view's triples.
    widths: columns of each view.
    """
    starts = np.zeros(num_rows + 1, np.int64)
    for triples in views:
        np.add.at(starts, triples().gaussian_ids + 1, 1)
    np.cumsum(starts, out=starts)
    indices, weights = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.float32)
    following, offset = starts[:-1].copy(), 0
    for triples, width in zip(views, widths, strict=True):
        place_entries(triples(), offset, following, indices, weights)
        offset += width
    return csr_of(starts, indices, weights, offset)
