"""Votes to features, a task for each run of tiles: as an aggregator makes them of the whole, to the bit.

run -> what its rows add to the trust in masks    where an aggregator trusts masks
run -> its rows, weighed                          of themselves, and that trust
run -> whose features its rows have               of the rows around, in whatever tiles they are, where they vote
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ...base.arrays import (
    Arrays,
    ArraysByName,
    DoubleRows,
    Doubles,
    Embeddings,
    Flags,
    IndexRows,
    Indices,
    OtherIndices,
    Vectors,
)
from ...base.working import Held
from ...formats.tiles import Tile
from ...kernels import weighted_rows
from ...scene.gaussians import Gaussians
from ..evidence.aggregation import Aggregated
from ..evidence.aggregation.entries import with_entries
from ..evidence.aggregation.outliers import OutlierRejection
from ..evidence.aggregation.trust import MaskTrust, tally
from ..evidence.aggregation.voting import (
    RECEIVERS_AT_ONCE,
    SPARE_NEIGHBOURS,
    ModeVoting,
    Voters,
    nearest,
    nearest_first,
    reliability,
)
from ..evidence.evidence import Evidence, MaskIds, csr_of
from .seeing import Gallery
from .store import Store
from .transposing import Run

EMBEDDINGS_FILE = "embeddings.npy"
NO_NEIGHBOUR = np.iinfo(np.int64).max


@dataclass(frozen=True, eq=False)
class RowFiles:
    """Rows of W in files, by the names of their runs. key: of the weights as registered, and of the embeddings."""

    store: Store
    masks: MaskIds
    held: Mapping[str, Held]
    key: str

    def arrays(self, run: Run) -> ArraysByName:
        return self.held[run.name].arrays

    def weights(self, run: Run) -> csr_array:
        arrays = self.arrays(run)
        return csr_of(arrays["indptr"], arrays["indices"], arrays["data"], len(self.masks))

    def embeddings(self) -> Embeddings:
        return np.asarray(np.load(self.store.bring(EMBEDDINGS_FILE), mmap_mode="r"))

    def evidence(self, run: Run) -> Evidence:
        return Evidence(self.weights(run), self.masks, self.embeddings())

    def seen(self, run: Run) -> Evidence:
        """Return the evidence of the rows that have any weight."""
        w = self.weights(run)
        starts = w.indptr[np.append(True, np.diff(w.indptr) > 0)]
        return Evidence(csr_of(starts, w.indices, w.data, len(self.masks)), self.masks, self.embeddings())


@dataclass(frozen=True, eq=False)
class OfTiles(Aggregated):
    """Features whose rows lie in files."""

    files: RowFiles = field(kw_only=True)


@dataclass(frozen=True, eq=False)
class Tallying:
    """Finds what a run adds to the trust in masks: a `Part`."""

    rows: RowFiles

    def __call__(self, run: Run, threads: int) -> Arrays:
        counted = tally(self.rows.evidence(run), threads)
        (columns,) = np.nonzero(counted.weights)
        return {"columns": columns, "surpluses": counted.surpluses[columns], "weights": counted.weights[columns]}


@dataclass(frozen=True, eq=False)
class Weighing:
    """Makes rows whose votes count otherwise: a `Part`. trust: in each mask, where masks are trusted."""

    rows: RowFiles
    step: MaskTrust | OutlierRejection
    trust: Doubles | None = None

    def __call__(self, run: Run, threads: int) -> Arrays:
        evidence = self.rows.evidence(run)
        if isinstance(self.step, MaskTrust) and self.trust is not None:
            return _arrays(self.step.weighed(evidence, self.trust).weights)
        return _arrays(self.step(evidence, threads).weights)


@dataclass(frozen=True, eq=False)
class Believing:
    """Finds how reliable rows are: a `Part`."""

    rows: RowFiles

    def __call__(self, run: Run, threads: int) -> Arrays:
        return {"reliability": reliability(self.rows.evidence(run), threads)}


@dataclass(frozen=True, eq=False)
class Voting:
    """Makes rows as neighbours choose them, from the rows of all runs, and their numbers, `donors`: a `Part`.

    registered: rows as they were before any step. believed: how reliable rows are. gallery: where the tiles are.
    """

    rows: RowFiles
    voting: ModeVoting
    registered: RowFiles
    believed: RowFiles
    gallery: Gallery
    runs: Sequence[Run]

    def __call__(self, run: Run, threads: int) -> Arrays:
        own = self._trust(run)
        donors = np.where(own > 0, run.first + np.arange(len(own)), -1)
        receivers = run.first + np.flatnonzero(np.diff(self.registered.weights(run).indptr) > 0)
        points = np.concatenate([self._shapes(tile).means for tile in run.tiles])
        distances, near = self._nearest(run, points[receivers - run.first], threads)
        for begin in range(0, len(receivers) if near.shape[1] else 0, RECEIVERS_AT_ONCE):
            some = slice(begin, begin + RECEIVERS_AT_ONCE)
            voters = Voters(receivers[some], near[some], distances[some])
            donors[voters.rows - run.first] = self.voting.elected(voters, *self._about(voters.present, threads))
        return _arrays(self._weights(donors)) | {"donors": donors.astype(np.int32)}

    def _trust(self, run: Run) -> Doubles:
        return self.believed.arrays(run)["reliability"]

    def _shapes(self, tile: Tile) -> Gaussians:
        return self.gallery.shapes(tile)

    def _nearest(self, run: Run, points: Vectors, threads: int) -> tuple[DoubleRows, IndexRows]:
        """Return the nearest givers of points: those of the run, then those of all tiles that may hold nearer ones.

        The box of a tile bounds how near its rows are, so that none is missed.
        """
        count = self.voting.neighbours + 1
        distances = np.full((len(points), count), np.inf)
        near = np.full((len(points), count), NO_NEIGHBOUR)
        for other in (run, *(one for one in self.runs if one.first != run.first)):
            trust = self._trust(other)
            for tile in other.tiles:
                givers = np.flatnonzero(trust[tile.first - other.first :][: tile.num_rows] > 0)
                # how far points are from the box of a tile, and a little less: of what is rounded none is missed
                away = np.maximum(np.maximum(tile.low - points, points - tile.high), 0)
                (asking,) = np.nonzero(np.asarray(np.sqrt(np.square(away).sum(1)) * (1 - 1e-6)) <= distances[:, -1])
                if len(givers) and len(asking):
                    tree = cKDTree(self._shapes(tile).means[givers])
                    further, which = nearest(tree, points[asking], count + SPARE_NEIGHBOURS, threads)
                    both = np.concatenate([distances[asking], further], axis=1)
                    rows = np.concatenate([near[asking], tile.first + givers[which]], axis=1)
                    distances[asking], near[asking] = nearest_first(both, rows, count)
        some = np.isfinite(distances).all(0)  # of fewer givers than are asked for
        return distances[:, some], near[:, some]

    def _about(self, numbers: Indices, threads: int) -> tuple[Doubles, Doubles, Embeddings]:
        """Return how reliable rows are, their sizes, and features. numbers: ascending."""
        trust, sizes = [np.empty(0)], [np.empty(0)]
        for run, own in self._by_run(numbers):
            trust.append(self._trust(run)[own - run.first])
            for tile in run.tiles:
                inside = own[(own >= tile.first) & (own < tile.first + tile.num_rows)] - tile.first
                if len(inside):
                    sizes.append(self.voting.sizes(self._shapes(tile).subset(inside)))
        w, table = self._weights(numbers), self.rows.embeddings()
        features = weighted_rows(w.indptr, w.indices, w.data, table, 0, len(numbers), threads=threads)
        return np.concatenate(trust), np.concatenate(sizes), features

    def _weights(self, numbers: Indices) -> csr_array:
        """Return some rows of W in their order; of -1 an empty one."""
        wanted, at = np.unique(numbers, return_inverse=True)
        lengths, indices, data = [np.zeros(0, np.int64)], [np.empty(0, np.int32)], [np.empty(0, np.float32)]
        if len(wanted) and wanted[0] < 0:
            lengths.append(np.zeros(1, np.int64))
        for run, own in self._by_run(wanted[wanted >= 0]):
            part = csr_array(self.rows.weights(run)[own - run.first])
            lengths.append(np.diff(part.indptr).astype(np.int64))
            indices.append(part.indices.astype(np.int32))
            data.append(part.data)
        starts = np.append(0, np.cumsum(np.concatenate(lengths)))
        return csr_array(csr_of(starts, np.concatenate(indices), np.concatenate(data), len(self.rows.masks))[at])

    def _by_run(self, numbers: OtherIndices) -> Iterator[tuple[Run, Indices]]:
        at = np.searchsorted([run.first for run in self.runs], numbers, side="right") - 1
        for number in np.unique(at).tolist():
            yield self.runs[number], numbers[at == number]


@dataclass(frozen=True, eq=False)
class OfColumns:
    """Makes the rows that some columns have weights in, and these weights alone: a `Part`."""

    rows: RowFiles
    kept: Flags

    def __call__(self, run: Run, threads: int) -> Arrays:
        w = self.rows.weights(run)
        w = with_entries(w, self.kept[w.indices] & (w.data > 0))
        return _arrays(w) | {"indptr": w.indptr[np.append(True, np.diff(w.indptr) > 0)].astype(np.int64)}


def _arrays(w: csr_array) -> Arrays:
    return {"indptr": w.indptr.astype(np.int64), "indices": w.indices.astype(np.int32), "data": w.data}
