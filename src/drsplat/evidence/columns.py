"""The columns of W that one view makes: computed once, kept on disk, stacked into a sparse matrix."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int32
from scipy.sparse import csr_array

from ..errors import FormatError, MismatchError
from ..formats.tensors import map_tensors, read_tensors, write_tensors
from ..kernels import SplatArrays, Triples, default_isa
from ..masks.features import ViewFeatures
from ..scene.photos import undistort_ids
from ..scene.views import View, same_aspect
from .aggregation import Sampling
from .provenance import KEY_BYTES

COLUMNS_VERSION = "2"


@dataclass(frozen=True, eq=False)
class Columns:
    """One view's part of W: its triples are on disk at `path`; mask s is column s of this view. key: of its inputs."""

    view_name: str
    path: Path
    embeddings: Float32[np.ndarray, "s d"]
    key: bytes

    def triples(self) -> Triples:
        tensors, _ = map_tensors(self.path)
        return Triples(tensors["gaussian_ids"], tensors["segment_ids"], tensors["weights"])


@dataclass(frozen=True, eq=False)
class ColumnMaker:
    """Makes views' columns of one scene into `folder`, and recognises those that are there already."""

    splats: SplatArrays
    folder: Path
    sampling: Sampling
    threads: int

    def columns(self, view: View, features: ViewFeatures) -> Columns:
        """Compute the view's columns, unless the very same ones are in the folder.

        Raises: MismatchError: the map has another shape than the photo.
        """
        mask_ids = _mask_ids(view, features)
        key = self._key(view, mask_ids)
        marks = _marks(key)
        path = self.folder / part_name(view.name)
        if not _is_finished(path, marks):
            triples = self.sampling.triples(self.splats, view, mask_ids, self.threads)
            self.folder.mkdir(parents=True, exist_ok=True)
            tensors = dict(zip(("gaussian_ids", "segment_ids", "weights"), triples, strict=True))
            write_tensors(path, tensors, marks | {"view": view.name}, overwrite=True)
        return Columns(view.name, path, features.embeddings, key)

    def key(self, view: View, features: ViewFeatures) -> bytes:
        """A hash of all that the view's columns are made from: two of one key are equal, on one instruction set.

        Raises: MismatchError: the map has another shape than the photo.
        """
        return self._key(view, _mask_ids(view, features))

    def _key(self, view: View, mask_ids: Int32[np.ndarray, "h w"]) -> bytes:
        return _digest(view.K, view.cam_from_world, mask_ids, salt=self._settings)

    @cached_property
    def _settings(self) -> str:
        """Of all that every view shares."""
        splats, sampling = self.splats, self.sampling
        scene = _digest(*splats[:3], splats.origin, salt=repr(splats.near)).hex()
        counted = f"{sampling.topk} {sampling.first_hits}"
        if sampling.pixels != "all":
            counted = f"{counted} {sampling.pixels}"
        return f"{COLUMNS_VERSION} {counted} {scene}"


def _mask_ids(view: View, features: ViewFeatures) -> Int32[np.ndarray, "h w"]:
    """On the view's raster, its lens undone."""
    height, width = features.mask_ids.shape
    if not same_aspect((width, height), (view.width, view.height)):
        raise MismatchError(
            f"the masks of '{view.name}' are {width}x{height}, its photo {view.width}x{view.height}: another "
            "aspect ratio. Make the masks on the photos as they are stored (uncropped, not rotated by EXIF)"
        )
    return undistort_ids(view, features.resized(view.width, view.height).mask_ids)


def part_name(view_name: str) -> str:
    """Of the file of a view's columns."""
    digest = hashlib.blake2b(view_name.encode(), digest_size=12).hexdigest()
    return f"{digest}.columns.safetensors"


def _digest(*arrays: np.ndarray, salt: str = "") -> bytes:
    digest = hashlib.blake2b(salt.encode(), digest_size=KEY_BYTES)
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def _marks(key: bytes) -> dict[str, str]:
    """Of a finished part: another instruction set changes the last bits."""
    return {"key": key.hex(), "isa": default_isa()}


def _is_finished(path: Path, marks: Mapping[str, str]) -> bool:
    if not path.exists():
        return False
    try:
        return marks.items() <= read_tensors(path)[1].items()
    except FormatError:  # a damaged part is computed again
        return False


def stack_columns(columns: Sequence[Columns], num_gaussians: int) -> csr_array:
    """W (N, M) in CSR form from the views' triples, in two passes over them; 8 bytes per weight.

    Columns stay in the order given; within a row they are ascending.
    """
    starts = np.zeros(num_gaussians + 1, np.int64)
    for view in columns:
        starts[1:] += np.bincount(view.triples().gaussian_ids, minlength=num_gaussians)
    np.cumsum(starts, out=starts)
    indices, weights = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.float32)
    cursor, offset = starts[:-1].copy(), 0
    for view in columns:
        ids, masks, values = view.triples()
        first = np.flatnonzero(np.diff(ids.astype(np.int64), prepend=-1))
        runs = np.diff(first, append=len(ids))
        position = cursor[ids] + np.arange(len(ids)) - np.repeat(first, runs)
        indices[position], weights[position] = masks + offset, values
        cursor[ids[first]] += runs
        offset += len(view.embeddings)
    # SciPy gives both index arrays the wider type: int64 starts would make 12 bytes of the 8.
    starts = starts.astype(np.int32 if starts[-1] < 1 << 31 else np.int64)
    return csr_array((weights, indices, starts), shape=(num_gaussians, offset))
