"""`register` of a scene that is cut into tiles: the same method, by tasks that leave files.

    view  -> its columns of W          onto the tiles that it may see
    tiles -> their rows of W           from the columns of all views
    tiles -> their codes               of their rows of W, when a field is made of the registration
    rows  -> a field                   as of any other scene

W, its masks and their embeddings stay in files, which are mapped: memory holds the tiles of a view, the weights of a
run of tiles, and the codes of all rows.

Rows are coded in a task for each run of tiles, as `field.building` codes all of them, to the bit. What a code is learnt
from are a few views: it goes to all tasks. A row's code depends on that and on its own row of W.
"""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.arrays import Arrays, Embeddings, Flags, Ids, Indices, UnsignedIds
from ...base.contents import pieces
from ...base.working import Part
from ...formats.tensors import map_tensors, write_tensors
from ...formats.tiles import Tiles
from ...kernels.mixture import Encoded
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.views import View
from ..building import RowCoder, encode_features
from ..codes import Codebook, Codes, Track, untracked
from ..codes.mixture import Mixed, SceneAtoms, encode_rows, mixed_of
from ..evidence.aggregation import Aggregated, Aggregator, Sampling
from ..evidence.aggregation.outliers import OutlierRejection
from ..evidence.aggregation.trust import MaskTrust, Tally
from ..evidence.columns import ColumnMaker, part_name
from ..evidence.evidence import Evidence, csr_of
from ..registration import (
    Registration,
    check_one_size,
    encoder_of,
    masks_of,
    provenance_of,
    warn_of_missing,
    with_features,
)
from .aggregating import EMBEDDINGS_FILE, Believing, OfColumns, OfTiles, RowFiles, Tallying, Voting, Weighing
from .launching import ONE_PROCESS, Launcher, followed
from .seeing import Gallery, with_tiles
from .store import Shared, Store, store_of
from .tasks import ByTasks, Stored
from .transposing import ROWS_FOLDER, RowMaker, Run, filed, joined_rows, rows_name, runs_of


class ViewReport(NamedTuple):
    """Report of a view's task on its files.

    is_new: the view was computed now. tiles: a bit for each, set where the view has weights.
    """

    view_name: str
    num_masks: int
    dim: int
    num_weights: int
    key: bytes
    is_new: bool
    tiles: bytes


@dataclass(frozen=True, eq=False)
class ColumnTask:
    """Registers a view: leaves its columns and its masks' embeddings in the store.

    features: where a task that names a key finds them; a task may bring its own. ends: of the rows of each tile.
    """

    maker: ColumnMaker
    store: Store
    features: Mapping[str, ViewFeatures]
    ends: UnsignedIds

    def __call__(self, task: tuple[View, str | ViewFeatures]) -> ViewReport:
        view, given = task
        features = self.features[given] if isinstance(given, str) else given
        name = part_name(view.name)
        self.store.bring(name)
        columns, is_new = replace(self.maker, folder=self.store.folder).columns(view, features)
        write_tensors(embeddings_file(columns.path), {"embeddings": features.embeddings}, overwrite=True)
        self.store.send(embeddings_file(columns.path).name)
        if is_new or not self.store.has(name):  # who made it may have been killed before it was sent
            self.store.send(name)
        count, dim = features.embeddings.shape
        ids = columns.triples().gaussian_ids
        held = np.diff(np.searchsorted(ids, self.ends), prepend=0) > 0
        return ViewReport(view.name, count, dim, len(ids), columns.key, is_new, np.packbits(held).tobytes())


@dataclass(frozen=True, eq=False)
class _Bringing(Sequence[tuple[View, str | ViewFeatures]]):
    """Tasks that bring their features, read when they are given away: for workers that do not see the folder."""

    chosen: Sequence[tuple[View, str]]
    features: Mapping[str, ViewFeatures]

    def __len__(self) -> int:
        return len(self.chosen)

    def __getitem__(self, number: int) -> tuple[View, ViewFeatures]:  # type: ignore[override]
        view, key = self.chosen[number]
        return view, self.features[key]


def embeddings_file(columns: Path) -> Path:
    return columns.with_name(columns.name.replace(".columns.", ".embeddings."))


class Work(NamedTuple):
    """How much of a registration was done now, and how much was there from before."""

    views: int
    views_before: int
    runs: int
    runs_before: int


def register_tiles(
    tiles: Tiles,
    views: Sequence[View],
    features: Mapping[str, ViewFeatures],
    sampling: Sampling = Sampling(),
    *,
    parts: str | os.PathLike[str],
    launcher: Launcher = ONE_PROCESS,
    threads: int = 0,
    track: Track = untracked,
    tell: Callable[[Work], None] = lambda _: None,
) -> Registration:
    """Register views on tiles in the memory of a few of them; the bits equal those of `field.registration.register`.

    parts: folder of the finished work, which every worker sees, or the address of an object store as fsspec takes it;
    the registration's arrays are maps of files there, or of its copies here, so they have to stay until a field is
    saved. launcher: runs the tasks; features have to be picklable for other processes.
    threads: of each worker. tell: receives how much was done.

    Raises: as `field.registration.register`, and as `Launcher.results`.
    """
    chosen = with_features(views, features)
    warn_of_missing(views, chosen)
    store = store_of(parts)
    gallery = Gallery(tiles, sampling.near, with_tiles(store, tiles))
    ends = np.array([tile.first + tile.num_rows for tile in tiles.tiles], np.uint32)
    task = ColumnTask(ColumnMaker(gallery, store.folder, sampling, threads), store, features, ends)
    tasks = chosen if isinstance(store, Shared) else _Bringing(chosen, features)
    if not isinstance(store, Shared):
        task = replace(task, features={})
    reports = launcher.results(task, tasks)
    made = sorted(followed(reports, track, [view.name for view, _ in chosen], "registering views"))
    check_one_size({one.dim: one.view_name for one in made})
    names, widths = [part_name(one.view_name) for one in made], [one.num_masks for one in made]
    runs = runs_of(tiles.tiles, sum(one.num_weights for one in made), [one.tiles for one in made])
    key = _key(tiles, made)
    rows = RowMaker(store, names, widths, key)
    new_rows = list(followed(launcher.results(rows, runs), track, [run.name for run in runs], "gathering rows"))
    embeddings = _embeddings(store, names, sum(widths), made[0].dim)
    by_name = {view.name: view for view, _ in chosen}
    masks = masks_of([by_name[one.view_name] for one in made], widths)
    held = [Stored(store, rows_name(run)) for run in runs]
    evidence = Evidence(joined_rows(held, store.folder / ROWS_FOLDER, sum(widths)), masks, embeddings)
    new = sum(one.is_new for one in made)
    tell(Work(new, len(made) - new, sum(new_rows), len(runs) - sum(new_rows)))
    provenance = provenance_of([view for view, _ in chosen], [one.key for one in made], features)
    return Registration(
        evidence, tiles.fingerprint, encoder_of(features, made[0].dim), replace(sampling, near=gallery.near),
        provenance.up, provenance=provenance, coder=TileCoder(evidence, store, runs, launcher, key, threads, gallery),
    )  # fmt: skip


def _key(tiles: Tiles, made: Sequence[ViewReport]) -> str:
    parts = repr([(one.view_name, one.num_masks, one.key) for one in made])
    return hashlib.blake2b(f"{tiles.digest} {parts}".encode(), digest_size=16).hexdigest()


def _embeddings(store: Store, columns: Sequence[str], count: int, dim: int) -> Embeddings:
    """Return the embeddings of all masks, mapped from a file."""
    parts = (map_tensors(store.bring(embeddings_file(Path(name)).name))[0]["embeddings"] for name in columns)
    return filed(store.folder / EMBEDDINGS_FILE, np.float32, (count, dim), parts)


@dataclass(frozen=True, eq=False)
class Mixing:
    """Codes rows of runs: a `Part`. columns: whose embeddings may be atoms; None: all.

    Ids are columns, then the scene's atoms.
    """

    files: RowFiles
    atoms_per_row: int
    scene: SceneAtoms | None
    columns: Ids | None = None

    def __call__(self, run: Run, threads: int) -> Arrays:
        rows = self.files.seen(run)
        return encode_rows(rows, self.columns, self.scene, self.atoms_per_row, threads=threads)._asdict()


@dataclass(frozen=True, eq=False)
class Quantising:
    """Codes rows of runs: a `Part`."""

    files: RowFiles
    codebook: Codebook

    def __call__(self, run: Run, threads: int) -> Arrays:
        (codes, coarse_ids), directed = encode_features(self.files.seen(run), self.codebook, threads, untracked)
        return {"codes": codes, "directed": directed} | ({} if coarse_ids is None else {"coarse_ids": coarse_ids})


@dataclass(frozen=True, eq=False)
class TileCoder(RowCoder):
    """Lets a launcher make and code the features of runs; other evidence than that of the runs is coded at once.

    evidence: that of the files of the runs. key: of the weights. threads: of each worker. gallery: where the tiles are.
    """

    evidence: Evidence
    store: Store
    runs: Sequence[Run]
    launcher: Launcher
    key: str
    threads: int
    gallery: Gallery

    def aggregated(
        self, how: Aggregator, evidence: Evidence, gaussians: Gaussians | None, threads: int, track: Track
    ) -> Aggregated:
        """See RowCoder. Steps of other kinds may look at whatever they like, and do so at once."""
        if evidence is not self.evidence or not all(isinstance(s, MaskTrust | OutlierRejection) for s in how.steps):
            if how.voting is not None and gaussians is None:
                gaussians = self.gallery.tiles.gaussians()
            return super().aggregated(how, evidence, gaussians, threads, track)
        rows = self.registered
        for step in how.steps:
            rows = self._weighed(rows, step, track)  # type: ignore[arg-type]
        if rows is not self.registered:
            held = [rows.held[run.name] for run in self.runs]
            evidence = replace(
                evidence, weights=joined_rows(held, self.store.folder / "made" / "joined", len(rows.masks))
            )
        if how.voting is None:
            return OfTiles(evidence, None, how.record(), files=rows)
        believed = self._made(Believing(rows), track)
        chosen = self._made(Voting(rows, how.voting, self.registered, believed, self.gallery, self.runs), track)
        donors = np.concatenate([chosen.arrays(run)["donors"] for run in self.runs])
        return OfTiles(evidence, donors, how.record(), files=chosen)

    @cached_property
    def registered(self) -> RowFiles:
        """Rows as they are registered."""
        digest = hashlib.blake2b(self.key.encode(), digest_size=16)
        for piece in pieces(self.evidence.embeddings):
            digest.update(piece)
        self.store.send(EMBEDDINGS_FILE)
        held = {run.name: Stored(self.store, rows_name(run)) for run in self.runs}
        return RowFiles(self.store, self.evidence.masks, held, digest.hexdigest())

    def _weighed(self, rows: RowFiles, step: MaskTrust | OutlierRejection, track: Track) -> RowFiles:
        if not isinstance(step, MaskTrust):
            return self._made(Weighing(rows, step), track)
        counted = self._made(Tallying(rows), track)
        count = len(rows.masks)
        surpluses, weights = np.zeros(count), np.zeros(count)
        for part in map(counted.arrays, self.runs):
            surpluses[part["columns"]] += part["surpluses"]
            weights[part["columns"]] += part["weights"]
        return self._made(Weighing(rows, step, step.trust(Tally(surpluses, weights))), track)

    def _made(self, part: Part[Run], track: Track) -> RowFiles:
        """Let tasks make a file of each run; return those files."""
        made = self.work(0, track)(part, self.runs, "weighing votes")
        return replace(self.registered, held=dict(zip((run.name for run in self.runs), made, strict=True)))

    def of_columns(self, features: Aggregated, kept: Flags) -> Aggregated:
        """See RowCoder."""
        if not isinstance(features, OfTiles):
            return super().of_columns(features, kept)
        parts = list(map(self._made(OfColumns(features.files, kept), untracked).arrays, self.runs))
        starts = np.append(0, np.cumsum(np.concatenate([np.diff(part["indptr"]) for part in parts])))
        indices, data = (np.concatenate([part[name] for part in parts]) for name in ("indices", "data"))
        weights = csr_of(starts, indices, data, len(kept))
        return Aggregated(replace(self.evidence, weights=weights), None, features.record)

    def work(self, threads: int, track: Track) -> ByTasks:
        """See RowCoder. `threads` are those of this process."""
        return ByTasks(self.store, self.launcher, self.threads, track, "made")

    def mixed(
        self, features: Aggregated, seen: Indices, atoms_per_row: int, scene: SceneAtoms | None,
        threads: int, track: Track,
    ) -> Mixed:  # fmt: skip
        """See RowCoder."""
        if not isinstance(features, OfTiles):
            return super().mixed(features, seen, atoms_per_row, scene, threads, track)

        def encode(columns: Ids | None) -> Encoded:
            return Encoded(**self._coded(Mixing(features.files, atoms_per_row, scene, columns), track))

        return mixed_of(encode, self.evidence.embeddings, scene)

    def quantised(
        self, features: Aggregated, seen: Indices, codebook: Codebook, threads: int, track: Track
    ) -> tuple[Codes, Flags]:
        """See RowCoder."""
        if not isinstance(features, OfTiles):
            return super().quantised(features, seen, codebook, threads, track)
        arrays = self._coded(Quantising(features.files, codebook), track)
        return Codes(arrays["codes"], arrays.get("coarse_ids")), arrays["directed"]

    def _coded(self, coding: Mixing | Quantising, track: Track) -> Arrays:
        """Return the coded arrays of all rows that have weights, one after another."""
        files = [held.arrays for held in self.work(0, track)(coding, self.runs, "coding Gaussians")]
        return {name: np.concatenate([file[name] for file in files]) for name in files[0]}
