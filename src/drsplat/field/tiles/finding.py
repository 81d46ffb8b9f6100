"""`objects` of a scene in tiles: what `field.objects.finding` does, by tasks that leave files.

    block -> its nodes                 of its rows of W, which this process gathers when a task is given away
    view  -> the borders of pieces     onto the tiles that it may see

Held are the rows and nodes of a block, and some bytes of each Gaussian; shapes and W are maps of files.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.arrays import Arrays, Ids
from ...base.contents import pieces as pieces_of_bytes
from ...errors import InputError
from ...formats.tensors import map_tensors, read_tensors, write_tensors
from ...formats.tiles import Tiles
from ...kernels import MergeRule, default_isa
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .. import LanguageField
from ..codes import Track, untracked
from ..evidence.columns import is_finished, part_name
from ..forest import Objects
from ..objects.block_nodes import BlockNodes, BlockRows, nodes_of
from ..objects.borders import Borders, ViewBorders, borders_in, of_all_views
from ..objects.describing import describe
from ..objects.finding import Division, cameras_of, pieces_of, seen_by, tree_of, with_pieces_joined
from .launching import ONE_PROCESS, Launcher, followed
from .seeing import Gallery, with_tiles
from .store import Shared, Store, make_once, store_of
from .transposing import filed

OBJECTS_FOLDER = "objects"
ROW_SHAPES: dict[str, tuple[int, ...]] = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": ()}  # of a row


def find_objects(
    field: LanguageField,
    tiles: Tiles,
    *,
    parts: str,
    views: Sequence[View] | None = None,
    launcher: Launcher = ONE_PROCESS,
    threads: int = 0,
    track: Track = untracked,
) -> Objects:
    """Find the things of a scene in tiles; the bits are those of `field.objects.finding.find_objects`.

    parts: as of `register_tiles`. threads: of each worker. track: shows progress.

    Raises: as the other, and as `Launcher.results`.
    """
    field.check_scene(tiles)
    if field.evidence is None:
        raise InputError("objects are found in the evidence, and this field was saved without: register again")
    store, cameras = store_of(parts), cameras_of(field) if views is None else views
    scene = mapped(tiles, store.folder / OBJECTS_FOLDER)
    ids = field.gaussian_ids
    work = TileBlocks(store, launcher, threads, track)
    found = tree_of(field.evidence, np.asarray(scene.means[ids]), work, threads=threads)
    tree, seen = found.tree, seen_by(found, cameras)
    if seen:
        pieces = pieces_of(tree, ids, len(tiles))
        tree = with_pieces_joined(tree, _borders(work, tiles, seen, pieces))
    return describe(field, scene, tree, threads=threads)


def mapped(tiles: Tiles, folder: Path) -> Gaussians:
    """Return the shapes of all Gaussians, mapped from files, without colours."""
    folder.mkdir(parents=True, exist_ok=True)
    means, quats, scales, opacities = (
        filed(
            folder / f"{name}.npy", np.float32, (len(tiles), *shape),
            (getattr(tiles.shapes(tile), name) for tile in tiles.tiles),
        )
        for name, shape in ROW_SHAPES.items()
    )  # fmt: skip
    colours = np.broadcast_to(np.zeros((1, 1, 3), np.float32), (len(tiles), 1, 3))
    return Gaussians(means, quats, scales, opacities, colours, origin=tiles.origin, antialiased=tiles.antialiased)


class _BlockName(NamedTuple):
    """Files of a block. key: of all that decides its nodes."""

    key: str

    @property
    def rows(self) -> str:
        return f"{OBJECTS_FOLDER}/{self.key}.rows.safetensors"

    @property
    def nodes(self) -> str:
        return f"{OBJECTS_FOLDER}/{self.key}.nodes.safetensors"


@dataclass(frozen=True, eq=False)
class BlockTask:
    """Finds the nodes of a block."""

    store: Store
    thresholds: tuple[float, ...]
    rule: MergeRule
    threads: int

    def __call__(self, task: tuple[int, _BlockName]) -> tuple[int, _BlockName]:
        """Find the nodes of a block if they are not there yet; its rows go once they are."""
        number, name = task
        make_once(self.store, name.nodes, name.key, lambda: self._nodes(name))
        self.store.bring(name.rows).unlink(missing_ok=True)
        return number, name

    def _nodes(self, name: _BlockName) -> Arrays:
        block = BlockRows(**read_tensors(self.store.bring(name.rows))[0])
        return nodes_of(block, self.thresholds, self.rule, self.threads)._asdict()


@dataclass(frozen=True, eq=False)
class _Gathered(Sequence[tuple[int, _BlockName]]):
    """Tasks whose rows are gathered when they are given away, where their nodes are not there yet."""

    store: Store
    division: Division

    def __len__(self) -> int:
        return len(self.division.blocks)

    def __getitem__(self, number: int) -> tuple[int, _BlockName]:  # type: ignore[override]
        rows = self.division.rows(self.division.blocks[number])
        name = _BlockName(_key_of(rows, self.division))
        if not is_finished(self.store.bring(name.nodes), {"key": name.key}):
            path = self.store.folder / name.rows
            path.parent.mkdir(parents=True, exist_ok=True)
            write_tensors(path, rows._asdict(), {"key": name.key}, overwrite=True)
            self.store.send(name.rows)
        return number, name


def _key_of(rows: BlockRows, division: Division) -> str:
    digest = hashlib.blake2b(f"{division.thresholds} {division.rule} {default_isa()}".encode(), digest_size=16)
    for array in rows:
        for piece in pieces_of_bytes(array):
            digest.update(piece)
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class TileBlocks:
    """A `Work` that lets a launcher work."""

    store: Store
    launcher: Launcher
    threads: int
    track: Track

    def __call__(self, division: Division) -> list[BlockNodes]:
        """Return the nodes of all blocks, mapped from files."""
        task = BlockTask(self.store, division.thresholds, division.rule, self.threads)
        results = self.launcher.results(task, _Gathered(self.store, division))
        names = [f"block {number}" for number in range(len(division.blocks))]
        done = dict(followed(results, self.track, names, "finding objects"))
        files = (self.store.bring(done[number].nodes) for number in range(len(names)))
        return [BlockNodes(**map_tensors(file)[0]) for file in files]


@dataclass(frozen=True, eq=False)
class BorderTask:
    """Finds the borders that a view shows.

    pieces: file of the piece of each Gaussian. key: of all that decides what is found.
    """

    gallery: Gallery
    store: Store
    pieces: str
    key: str
    threads: int

    def __call__(self, view: View) -> str:
        """Find them if they are not there yet; return the name of their file."""
        name = f"{OBJECTS_FOLDER}/{part_name(view.name).replace('.columns.', f'.{self.key}.borders.')}"
        make_once(self.store, name, self.key, lambda: self._borders(view))
        return name

    def _borders(self, view: View) -> Arrays:
        seen = self.gallery.visible_splats(view)
        pieces = np.load(self.store.bring(self.pieces), mmap_mode="r")
        of_seen = np.asarray(pieces if seen.rows is None else pieces[seen.rows])
        return borders_in(seen.splats, view, of_seen, threads=self.threads)._asdict()


def _borders(work: TileBlocks, tiles: Tiles, views: Sequence[View], pieces: Ids) -> Borders:
    """Return the borders of pieces in all views, a task for each."""
    digest = hashlib.blake2b(f"{tiles.digest} {default_isa()}".encode(), digest_size=16)
    for piece in pieces_of_bytes(pieces):
        digest.update(piece)
    key = digest.hexdigest()
    name = f"{OBJECTS_FOLDER}/{key}.pieces.npy"
    store = work.store
    filed(store.folder / name, np.int32, pieces.shape, [pieces])
    store.send(name)
    gallery = Gallery(tiles, store=None if isinstance(store, Shared) else with_tiles(store, tiles))
    task, names = BorderTask(gallery, store, name, key, work.threads), [view.name for view in views]
    made = followed(work.launcher.results(task, views), work.track, names, "looking at borders")
    return of_all_views(_read(store, made), int(pieces.max(initial=-1)) + 1)


def _read(store: Store, names: Iterable[str]) -> Iterable[ViewBorders]:
    for name in names:
        yield ViewBorders(**map_tensors(store.bring(name))[0])
