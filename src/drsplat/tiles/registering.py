"""`register` of a scene that is cut into tiles: the same method, by tasks that leave files.

    view  -> its columns of W          onto the tiles that it may see
    tiles -> their rows of W           from the columns of all views
    rows  -> features, codes, a field  as of any other scene

W, its masks and their embeddings stay in files, which are mapped: memory holds the tiles of a view, the weights of a
run of tiles, and some tens of bytes a Gaussian for its code.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float32

from ..codes import Track, untracked
from ..evidence.aggregation import Sampling
from ..evidence.columns import ColumnMaker, part_name
from ..evidence.evidence import Evidence
from ..formats.tensors import map_tensors, write_tensors
from ..formats.tiles import Tiles
from ..masks.features import ViewFeatures
from ..registration import Registration, check_one_size, encoder_of, masks_of, views_with_features
from ..scene.boxes import up_of
from ..scene.views import View
from .launching import HERE, Launcher
from .seeing import Gallery
from .transposing import RowMaker, joined_rows, runs_of

T = TypeVar("T")


class Made(NamedTuple):
    """What a view's task says of its files. is_new: whether it was computed now."""

    view_name: str
    num_masks: int
    dim: int
    num_weights: int
    key: str
    is_new: bool


@dataclass(frozen=True, eq=False)
class ColumnTask:
    """Registers a view: leaves its columns and its masks' embeddings in `folder`."""

    maker: ColumnMaker
    features: Mapping[str, ViewFeatures]

    def __call__(self, view_and_key: tuple[View, str]) -> Made:
        view, key = view_and_key
        features = self.features[key]
        columns, digest, is_new = self.maker.made(view, features)
        write_tensors(embeddings_file(columns.path), {"embeddings": features.embeddings}, overwrite=True)
        count, dim = features.embeddings.shape
        return Made(view.name, count, dim, len(columns.triples().weights), digest, is_new)


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
    parts: Path,
    launcher: Launcher = HERE,
    threads: int = 0,
    track: Track = untracked,
    tell: Callable[[Work], None] = lambda _: None,
) -> Registration:
    """As `registration.register`, equal to the bit, in the memory of a few tiles.

    parts: folder of the finished work, which every worker sees; the registration's arrays are maps of files there, so
    it has to stay until a field is saved. launcher: who works; features have to be picklable for other processes.
    threads: of each worker. tell: is told how much was done.

    Raises: as there, and as `Launcher.results`.
    """
    chosen = views_with_features(views, features)
    gallery = Gallery(tiles, sampling.near)
    maker = ColumnMaker(gallery, parts, sampling, threads)
    told = launcher.results(ColumnTask(maker, features), chosen)
    made = sorted(_followed(told, track, [view.name for view, _ in chosen], "registering views"))
    check_one_size({one.dim: one.view_name for one in made})
    files = [parts / part_name(one.view_name) for one in made]
    widths = [one.num_masks for one in made]
    runs = runs_of(tiles.tiles, sum(one.num_weights for one in made))
    rows = RowMaker(files, widths, parts / "rows", _key(tiles, made))
    new_rows = list(_followed(launcher.results(rows, runs), track, [run[0].name for run in runs], "gathering rows"))
    embeddings = _embeddings(files, sum(widths), made[0].dim, parts)
    masks = masks_of([one.view_name for one in made], widths)
    evidence = Evidence(joined_rows(runs, parts / "rows", sum(widths)), masks, embeddings)
    new = sum(one.is_new for one in made)
    tell(Work(new, len(made) - new, sum(new_rows), len(runs) - sum(new_rows)))
    return Registration(
        evidence, tiles.fingerprint, encoder_of(features, made[0].dim), replace(sampling, near=gallery.near),
        up_of([view for view, _ in chosen]),
    )  # fmt: skip


def _followed(results: Iterable[T], track: Track, items: Sequence[str], description: str) -> Iterator[T]:
    """Results as they come, each with a step of the progress."""
    for result, _ in zip(results, track(items, description), strict=True):
        yield result


def _key(tiles: Tiles, made: Sequence[Made]) -> str:
    told = repr([(one.view_name, one.num_masks, one.key) for one in made])
    return hashlib.blake2b(f"{tiles.digest} {told}".encode(), digest_size=16).hexdigest()


def _embeddings(files: Sequence[Path], count: int, dim: int, parts: Path) -> Float32[np.ndarray, "m d"]:
    """Of all masks, in a file that is mapped."""
    path = parts / "embeddings.npy"
    if not count:
        return np.empty((0, dim), np.float32)
    whole = np.lib.format.open_memmap(path, "w+", np.dtype(np.float32), (count, dim))
    at = 0
    for file in files:
        part = map_tensors(embeddings_file(file))[0]["embeddings"]
        whole[at : at + len(part)] = part
        at += len(part)
    return whole
