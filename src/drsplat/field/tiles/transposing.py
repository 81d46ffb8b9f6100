"""Columns of W, a file for each view, to its rows, a file for each run of tiles: a transpose larger than memory."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Arrays, Indices
from ...base.contents import pieces
from ...base.working import Held
from ...formats.replacing import replacing
from ...formats.tensors import map_tensors
from ...formats.tiles import Tile
from ...kernels import Triples
from ..evidence.columns import stacked
from ..evidence.evidence import csr_of
from .store import Store, make_once

ROWS_FOLDER = "rows"  # as they are registered
RUN_BYTES = 256 << 20  # of W that one task makes
WEIGHT_BYTES = 20  # while it does
NO_TRIPLES = Triples(np.empty(0, np.uint32), np.empty(0, np.int32), np.empty(0, np.float32))


class Run(NamedTuple):
    """Tiles, one after another, and the numbers of the views that have weights in them."""

    tiles: tuple[Tile, ...]
    views: Indices

    @property
    def name(self) -> str:
        return self.tiles[0].name

    @property
    def first(self) -> int:
        return self.tiles[0].first

    @property
    def num_rows(self) -> int:
        return sum(tile.num_rows for tile in self.tiles)


@dataclass(frozen=True, eq=False)
class RowMaker:
    """Makes the rows of a run of tiles from the columns of all views: a task.

    views: the name of the file of each. widths: their numbers of masks. key: of all those columns.
    """

    store: Store
    views: Sequence[str]
    widths: Sequence[int]
    key: str

    def __call__(self, run: Run) -> bool:
        """Make the rows of a run; return True if they were made, and not there already."""
        return make_once(self.store, rows_name(run), self.key, lambda: self._rows(run))

    def _rows(self, run: Run) -> Arrays:
        parts: list[Callable[[], Triples]] = [lambda: NO_TRIPLES] * len(self.views)
        for view in run.views.tolist():
            parts[view] = partial(_part, self.store.bring(self.views[view]), run.first, run.num_rows)
        w = stacked(parts, self.widths, run.num_rows)
        return {"indptr": w.indptr.astype(np.int64), "indices": w.indices, "data": w.data}


def _part(view: Path, first: int, count: int) -> Triples:
    """Return a view's triples of a run of rows, which lie together in its file, counted from the first."""
    tensors, _ = map_tensors(view)
    ids = tensors["gaussian_ids"]
    run = slice(*np.searchsorted(ids, np.array([first, first + count], ids.dtype)))
    return Triples(ids[run] - np.uint32(first), tensors["segment_ids"][run], tensors["weights"][run])


def runs_of(tiles: Sequence[Tile], num_weights: int, held: Sequence[bytes]) -> list[Run]:
    """Return tiles in runs whose weights fit in RUN_BYTES, if spread evenly. held: a bit for each tile, by view."""
    bits = np.frombuffer(b"".join(held), np.uint8).reshape(len(held), -1)
    has = np.unpackbits(bits, axis=1, count=len(tiles)).astype(np.bool_)
    rows = tiles[-1].first + tiles[-1].num_rows
    most = max(1, int(RUN_BYTES / WEIGHT_BYTES * rows / max(num_weights, 1)))
    runs: list[list[int]] = []
    for number, tile in enumerate(tiles):
        if not runs or tile.first + tile.num_rows - tiles[runs[-1][0]].first > most:
            runs.append([])
        runs[-1].append(number)
    return [Run(tuple(tiles[n] for n in run), np.flatnonzero(has[:, run].any(1))) for run in runs]


def rows_name(run: Run) -> str:
    return f"{ROWS_FOLDER}/{run.name}.rows.safetensors"


def joined_rows(held: Sequence[Held], folder: Path, num_masks: int) -> csr_array:
    """Return W, all rows one after another, in files that are mapped: memory holds those in use.

    held: the rows of each run. folder: of the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    indptr = [np.zeros(1, np.int64)]
    for part in held:
        indptr.append(part.arrays["indptr"][1:] + indptr[-1][-1])
    starts = np.concatenate(indptr)
    shape = (int(starts[-1]),)
    indices = filed(folder / "indices.npy", np.int32, shape, (part.arrays["indices"] for part in held))
    data = filed(folder / "data.npy", np.float32, shape, (part.arrays["data"] for part in held))
    return csr_of(starts, indices, data, num_masks)


def filed(path: Path, kind: type, shape: tuple[int, ...], parts: Iterable[np.ndarray]) -> np.ndarray:
    """Write an array a part at a time and return it mapped from its file; an empty one cannot be mapped."""
    if not math.prod(shape):
        return np.empty(shape, kind)
    with replacing(path, overwrite=True) as file:  # whoever has mapped an older one keeps it
        header = {"descr": np.lib.format.dtype_to_descr(np.dtype(kind)), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for part in parts:
            file.writelines(pieces(part))
    return np.lib.format.open_memmap(path, "r")
