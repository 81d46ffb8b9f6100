"""Columns of W, a file for each view, to its rows, a file for each run of tiles: a transpose larger than memory."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from ..evidence.columns import is_finished, stacked
from ..formats.tensors import map_tensors, write_tensors
from ..formats.tiles import Tile
from ..kernels import Triples
from .store import Store

RUN_BYTES = 256 << 20  # of W that one task makes
WEIGHT_BYTES = 20  # while it does


@dataclass(frozen=True, eq=False)
class RowMaker:
    """Makes the rows of a run of tiles from the columns of all views: a task.

    views: the name of the file of each. widths: their numbers of masks. key: of all those columns.
    """

    store: Store
    views: Sequence[str]
    widths: Sequence[int]
    key: str

    def __call__(self, run: Sequence[Tile]) -> bool:
        """Whether they were made, and not there already."""
        name = rows_name(run)
        path = self.store.bring(name)
        is_new = not is_finished(path, {"key": self.key})
        if is_new:
            self._make(run, path)
        if is_new or not self.store.has(name):  # who made it may have been killed before it was sent
            self.store.send(name)
        return is_new

    def _make(self, run: Sequence[Tile], path: Path) -> None:
        first, count = run[0].first, sum(tile.num_rows for tile in run)
        parts = [_held(_part(self.store.bring(view), first, count)) for view in self.views]
        w = stacked(parts, self.widths, count)
        path.parent.mkdir(parents=True, exist_ok=True)
        tensors = {"indptr": w.indptr.astype(np.int64), "indices": w.indices, "data": w.data}
        write_tensors(path, tensors, {"key": self.key}, overwrite=True)


def _part(view: Path, first: int, count: int) -> Triples:
    """A view's triples of some rows, which lie together in its file, counted from the first."""
    tensors, _ = map_tensors(view)
    ids = tensors["gaussian_ids"]
    run = slice(*np.searchsorted(ids, np.array([first, first + count], ids.dtype)))
    return Triples(ids[run] - np.uint32(first), tensors["segment_ids"][run].copy(), tensors["weights"][run].copy())


def _held(triples: Triples) -> Callable[[], Triples]:
    return lambda: triples


def runs_of(tiles: Sequence[Tile], num_weights: int) -> list[tuple[Tile, ...]]:
    """Tiles in runs whose weights fit in RUN_BYTES, if they are spread evenly."""
    rows = tiles[-1].first + tiles[-1].num_rows
    most = max(1, int(RUN_BYTES / WEIGHT_BYTES * rows / max(num_weights, 1)))
    runs: list[list[Tile]] = []
    for tile in tiles:
        if not runs or tile.first + tile.num_rows - runs[-1][0].first > most:
            runs.append([])
        runs[-1].append(tile)
    return [tuple(run) for run in runs]


def rows_name(run: Sequence[Tile]) -> str:
    return f"rows/{run[0].name}.rows.safetensors"


def joined_rows(runs: Sequence[Sequence[Tile]], store: Store, num_masks: int) -> csr_array:
    """W, all rows one after another, in files that are mapped: memory holds those in use."""
    files = [map_tensors(store.bring(rows_name(run)))[0] for run in runs]
    folder = store.folder / "rows"
    count = runs[-1][-1].first + runs[-1][-1].num_rows
    entries = sum(len(file["data"]) for file in files)
    indptr = _new(folder, "indptr", count + 1, np.int32 if entries < 1 << 31 else np.int64)
    indices, data = _new(folder, "indices", entries, np.int32), _new(folder, "data", entries, np.float32)
    row = at = 0
    indptr[0] = 0
    for file in files:
        rows, end = len(file["indptr"]) - 1, at + len(file["data"])
        indptr[row + 1 : row + rows + 1] = file["indptr"][1:] + at
        indices[at:end], data[at:end] = file["indices"], file["data"]
        row, at = row + rows, end
    return csr_array((data, indices, indptr), shape=(count, num_masks))


def _new(folder: Path, name: str, length: int, kind: type) -> np.ndarray:
    """An array in a file; an empty one cannot be mapped."""
    if not length:
        return np.empty(0, kind)
    return np.lib.format.open_memmap(folder / f"{name}.npy", "w+", np.dtype(kind), (length,))
