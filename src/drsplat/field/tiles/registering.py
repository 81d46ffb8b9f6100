"""`register` of a scene that is cut into tiles: the same method, by tasks that leave files.

    view  -> its columns of W          onto the tiles that it may see
    tiles -> their rows of W           from the columns of all views
    tiles -> their codes               of their rows of W, when a field is made of the registration
    rows  -> a field                   as of any other scene

W, its masks and their embeddings stay in files, which are mapped: memory holds the tiles of a view, the weights of a
run of tiles, and the codes of all rows.
"""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.arrays import Float32, UInt32
from ...formats.tensors import map_tensors, write_tensors
from ...formats.tiles import Tiles
from ...scene.masks.features import ViewFeatures
from ...scene.views import View
from ..codes import Track, untracked
from ..evidence.aggregation import Sampling
from ..evidence.columns import ColumnMaker, part_name
from ..evidence.evidence import Evidence
from ..registration import (
    Registration,
    check_one_size,
    encoder_of,
    masks_of,
    provenance_of,
    warn_of_missing,
    with_features,
)
from .aggregating import EMBEDDINGS_FILE
from .coding import TileCoder
from .launching import ONE_PROCESS, Launcher, followed
from .seeing import Gallery, with_tiles
from .store import Shared, Store, store_of
from .transposing import RowMaker, filed, joined_rows, runs_of


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
    ends: UInt32[np.ndarray, " t"]

    def __call__(self, task: tuple[View, str | ViewFeatures]) -> ViewReport:
        view, given = task
        features = self.features[given] if isinstance(given, str) else given
        name = part_name(view.name)
        self.store.bring(name)
        columns, is_new = replace(self.maker, folder=self.store.folder).load_or_compute(view, features)
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
    evidence = Evidence(joined_rows(runs, store, sum(widths)), masks, embeddings)
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


def _embeddings(store: Store, columns: Sequence[str], count: int, dim: int) -> Float32[np.ndarray, "m d"]:
    """Return the embeddings of all masks, mapped from a file."""
    parts = (map_tensors(store.bring(embeddings_file(Path(name)).name))[0]["embeddings"] for name in columns)
    return filed(store.folder / EMBEDDINGS_FILE, np.float32, (count, dim), parts)
