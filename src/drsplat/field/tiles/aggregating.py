"""Votes to features, a task for each run of tiles: as an aggregator makes them of the whole, to the bit.

run -> what its rows add to the trust in masks    where an aggregator trusts masks
run -> its rows, weighed                          of themselves, and that trust
run -> whose features its rows have               of the rows around, in whatever tiles they are, where they vote
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

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
from ...base.contents import pieces
from ...base.working import Held, Part
from ...formats.tiles import Tile
from ...kernels import weighted_rows
from ...scene.gaussians import Gaussians
from ..codes import Track
from ..evidence.aggregation import Aggregated, Aggregator
from ..evidence.aggregation.outliers import OutlierRejection
from ..evidence.aggregation.trust import MaskTrust, Tally, tally
from ..evidence.aggregation.voting import (
    RECEIVERS_AT_ONCE,
    SPARE_NEIGHBOURS,
    ModeVoting,
    Voters,
    nearest,
    nearest_first,
    reliability,
)
from ..evidence.evidence import Evidence, MaskIds
from .launching import Launcher
from .seeing import Gallery
from .store import Store
from .tasks import ByTasks, Stored
from .transposing import Run, joined_rows, rows_name

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
        shape = (len(arrays["indptr"]) - 1, len(self.masks))
        return csr_array((arrays["data"], arrays["indices"], arrays["indptr"]), shape=shape)

    def embeddings(self) -> Embeddings:
        return np.asarray(np.load(self.store.bring(EMBEDDINGS_FILE), mmap_mode="r"))

    def evidence(self, run: Run) -> Evidence:
        return Evidence(self.weights(run), self.masks, self.embeddings())


@dataclass(frozen=True, eq=False)
class OfTiles(Aggregated):
    """Features whose rows lie in files."""

    files: RowFiles = field(kw_only=True)


def is_by_tasks(how: Aggregator) -> bool:
    """Return whether an aggregator is one of runs of tiles; others may look at whatever they like."""
    return all(isinstance(step, MaskTrust | OutlierRejection) for step in how.steps)


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
        return _arrays(self.step(evidence, threads).weights)  # type: ignore[operator]


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
        held = _Held(self)
        for begin in range(0, len(receivers) if near.shape[1] else 0, RECEIVERS_AT_ONCE):
            some = slice(begin, begin + RECEIVERS_AT_ONCE)
            voters = Voters(receivers[some], near[some], distances[some])
            donors[voters.rows - run.first] = self.voting.elected(voters, *held.about(voters.present, threads))
        made = held.weights(donors)
        return _arrays(made) | {"donors": donors.astype(np.int32)}

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


class _Held:
    """RowFiles of all runs, by their numbers in the scene."""

    def __init__(self, voting: Voting) -> None:
        self.voting, self.rows = voting, voting.rows
        self.firsts = np.array([run.first for run in voting.runs])
        self.table = voting.rows.embeddings()

    def about(self, numbers: Indices, threads: int) -> tuple[Doubles, Doubles, Embeddings]:
        """Return how reliable rows are, their sizes, and features. numbers: ascending."""
        trust, sizes = [np.empty(0)], [np.empty(0)]
        for run, own in self._by_run(numbers):
            trust.append(self.voting._trust(run)[own - run.first])
            for tile in run.tiles:
                inside = own[(own >= tile.first) & (own < tile.first + tile.num_rows)] - tile.first
                if len(inside):
                    sizes.append(self.voting.voting.sizes(self.voting._shapes(tile).subset(inside)))
        w = self.weights(numbers)
        features = weighted_rows(w.indptr, w.indices, w.data, self.table, 0, len(numbers), threads=threads)
        return np.concatenate(trust), np.concatenate(sizes), features

    def weights(self, numbers: Indices) -> csr_array:
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
        shape = (len(wanted), len(self.table))
        return csr_array(csr_array((np.concatenate(data), np.concatenate(indices), starts), shape=shape)[at])

    def _by_run(self, numbers: OtherIndices) -> Iterator[tuple[Run, Indices]]:
        at = np.searchsorted(self.firsts, numbers, side="right") - 1
        for number in np.unique(at).tolist():
            yield self.voting.runs[number], numbers[at == number]


@dataclass(frozen=True, eq=False)
class OfColumns:
    """Makes the rows that some columns have weights in, and these weights alone: a `Part`."""

    rows: RowFiles
    kept: Flags

    def __call__(self, run: Run, threads: int) -> Arrays:
        w = self.rows.weights(run)
        held = self.kept[w.indices] & (w.data > 0)
        starts = np.append(0, np.cumsum(held))[w.indptr]
        starts = starts[np.append(True, np.diff(starts) > 0)]
        return {"indptr": starts.astype(np.int64), "indices": w.indices[held], "data": w.data[held]}


@dataclass(frozen=True, eq=False)
class OnRuns:
    """The runs of a registration that tasks work on. evidence: that of their files.

    key: of the weights. threads: of each worker. gallery: where the tiles are.
    """

    evidence: Evidence
    store: Store
    runs: Sequence[Run]
    launcher: Launcher
    key: str
    threads: int
    gallery: Gallery

    def work(self, threads: int, track: Track) -> ByTasks:
        """Return what lets tasks work; `threads` are those of this process."""
        return ByTasks(self.store, self.launcher, self.threads, track, "made")

    @cached_property
    def registered(self) -> RowFiles:
        """Rows as they are registered."""
        digest = hashlib.blake2b(self.key.encode(), digest_size=16)
        for piece in pieces(self.evidence.embeddings):
            digest.update(piece)
        self.store.send(EMBEDDINGS_FILE)
        held = {run.name: Stored(self.store, rows_name(run)) for run in self.runs}
        return RowFiles(self.store, self.evidence.masks, held, digest.hexdigest())


class TileAggregator(OnRuns):
    """Makes features of the rows of runs by tasks."""

    def __call__(self, how: Aggregator, track: Track) -> OfTiles:
        """Return the features of all rows, which lie in files."""
        rows = self.registered
        for step in how.steps:
            rows = self._weighed(rows, step, track)  # type: ignore[arg-type]
        evidence = self.evidence if rows is self.registered else self._joined(rows)
        if how.voting is None:
            return OfTiles(evidence, None, how.record(), files=rows)
        believed = self._made(Believing(rows), track)
        chosen = self._made(Voting(rows, how.voting, self.registered, believed, self.gallery, self.runs), track)
        donors = np.concatenate([chosen.arrays(run)["donors"] for run in self.runs])
        return OfTiles(evidence, donors, how.record(), files=chosen)

    def of_columns(self, features: OfTiles, kept: Flags, track: Track) -> Aggregated:
        """Return the rows that some columns have weights in."""
        some = self._made(OfColumns(features.files, kept), track)
        parts = [some.arrays(run) for run in self.runs]
        starts = np.append(0, np.cumsum(np.concatenate([np.diff(part["indptr"]) for part in parts])))
        arrays = (np.concatenate([part[name] for part in parts]) for name in ("data", "indices"))
        kind = np.int32 if starts[-1] < 1 << 31 else np.int64
        matrix = csr_array((*arrays, starts.astype(kind)), shape=(len(starts) - 1, len(kept)))
        return Aggregated(Evidence(matrix, self.evidence.masks, self.evidence.embeddings), None, features.record)

    def _weighed(self, rows: RowFiles, step: MaskTrust | OutlierRejection, track: Track) -> RowFiles:
        if not isinstance(step, MaskTrust):
            return self._made(Weighing(rows, step), track)
        counted = self._made(Tallying(rows), track)
        count = len(self.evidence.masks)
        surpluses, weights = np.zeros(count), np.zeros(count)
        for part in map(counted.arrays, self.runs):
            surpluses[part["columns"]] += part["surpluses"]
            weights[part["columns"]] += part["weights"]
        return self._made(Weighing(rows, step, step.trust(Tally(surpluses, weights))), track)

    def _made(self, part: Part[Run], track: Track) -> RowFiles:
        """Let tasks make a file of each run; return those files."""
        made = self.work(0, track)(part, self.runs, "weighing votes")
        return replace(self.registered, held=dict(zip((run.name for run in self.runs), made, strict=True)))

    def _joined(self, rows: RowFiles) -> Evidence:
        held = [rows.held[run.name] for run in self.runs]
        folder = self.store.folder / "made" / "joined"
        weights = joined_rows(held, folder, len(self.evidence.masks))
        return Evidence(weights, self.evidence.masks, self.evidence.embeddings)


def _arrays(w: csr_array) -> Arrays:
    return {"indptr": w.indptr.astype(np.int64), "indices": w.indices.astype(np.int32), "data": w.data}
