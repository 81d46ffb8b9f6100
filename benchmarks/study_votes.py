"""What the votes of photos are worth: lists of objects before and after pieces are joined that photos outline as one.

    python benchmarks/study_votes.py ROOM... CAPTURE=SCENE... --kept FOLDER [--masks whole] [--pictures FOLDER]
    python benchmarks/study_votes.py ROOM... CAPTURE=SCENE... --kept FOLDER --surfaces

ROOM: one of world/scenes. CAPTURE: a real capture with outlines (`tests/support/*_outlines.json`) or labels, and the
scene that was trained on it. --masks whole: true masks of rooms, and simulated ones of whole things for captures;
without it the built-in segmenter's. Masks have no meaning here: W alone decides.

P: share of the listed objects that are a thing (IoU above 0.5, each thing once); of captures only few things are
outlined, so that P of two rows may be compared, and says little by itself. R: share of the things that are listed.
IoU: mean over things of that with the best object, listed or not. Rows leave out, one at a time, what a vote is made
of: the strength of outlines, the frame of photos, and that pieces may be stronger than the whole. FOLDER keeps what is
registered; pictures show the joined things, their pieces in colours.

--surfaces: which listed objects are said to be surfaces, by what most of their Gaussians are. Right are SURFACES. The
last column has the listed objects of 500 Gaussians or more that are surfaces, by what they are, and in brackets those
that are said to be. "-" is what nobody outlined.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.outlines import outlines_path
from benchmarks.suite.places import Place, capture, room
from benchmarks.suite.tables import markdown
from drsplat import read_views
from drsplat.base.system import peak_memory_bytes
from drsplat.drawing.pictures import contact_sheet, write_picture
from drsplat.field.evidence.evidence import Evidence
from drsplat.field.forest import THING
from drsplat.field.objects import voting
from drsplat.field.objects.agreed import agreed
from drsplat.field.objects.choosing import Tree, _owners
from drsplat.field.objects.describing import MIN_SHOWN_SHARE, node_weights
from drsplat.field.objects.finding import find_tree
from drsplat.field.objects.surfaces import surfaces
from drsplat.kernels import render_channels, splat_arrays
from drsplat.photos.embedding.voting import _Electorate
from drsplat.scene.parted import middle

LEVEL = 0.5  # of IoU, from which on an object is a thing
VOID = 0.5  # of an object's Gaussians: with fewer in known photos it counts neither way
COLORS = np.random.default_rng(7).integers(40, 256, (64, 3))


SURFACES = ("wall", "floor", "rug", "table", "quilt", "lawn", "island")
MANY = 500  # Gaussians of an object that is more than a leg of a table


class Found(NamedTuple):
    precision: float
    recall: float
    listed: int
    best: float


class Listing(NamedTuple):
    """ids: Gaussians of each object. listed: those that people are shown."""

    ids: list[np.ndarray]
    listed: np.ndarray


class Rows:
    """As much of a field as photos need to vote. ids: ascending Gaussians of its rows."""

    aggregator = SimpleNamespace(sampling=None)

    def __init__(self, ids: np.ndarray) -> None:
        self.ids = ids

    def __len__(self) -> int:
        return len(self.ids)

    def rows_of(self, some: np.ndarray) -> np.ndarray:
        rows = np.minimum(np.searchsorted(self.ids, some), len(self.ids) - 1)
        return np.where(self.ids[rows] == some, rows, -1)


def listing(tree: Tree, evidence: Evidence, ids: np.ndarray) -> Listing:
    things = np.flatnonzero(tree.levels == THING)
    owner = np.append(_owners(tree.parents, tree.levels == THING), -1)[tree.node_of]
    weights, views = node_weights(evidence, tree)[things], evidence.masks.views
    shown = np.stack([weights[:, views == view].sum(axis=1) for view in range(len(evidence.masks.view_names))], 1)
    photos = (shown > MIN_SHOWN_SHARE * shown.max(1, keepdims=True)).sum(1)
    return Listing([ids[owner == thing] for thing in things], agreed(tree.sure[things], photos))


def compared(place: Place, found: Listing) -> Found:
    """By the weight of Gaussians in the photos whose truth is known."""
    known = (place.labels >= 0) & (place.mass > 0)
    mass, numbers = place.mass * known, sorted(number for some in place.things.values() for number in some)
    sizes = np.bincount(place.labels[known], mass[known], minlength=max(numbers) + 1)[numbers]
    ious = np.zeros((len(found.ids), len(numbers)))
    void = np.zeros(len(found.ids), bool)
    for number, ids in enumerate(found.ids):
        own = ids[known[ids]]
        void[number] = len(own) < VOID * len(ids)
        shared = np.bincount(place.labels[own], mass[own], minlength=max(numbers) + 1)[numbers]
        ious[number] = shared / np.maximum(mass[ids].sum() + sizes - shared, 1e-9)
    counted = found.listed & ~void
    right = len(set(ious[counted].argmax(1)[ious[counted].max(1) >= LEVEL]))
    return Found(right / max(counted.sum(), 1), right / len(numbers), int(found.listed.sum()), ious.max(0).mean())


def surface_row(place: Place) -> tuple[str, ...]:
    ids = np.flatnonzero(np.diff(place.evidence.weights.indptr))
    evidence = place.evidence.rows(ids)
    found = listing(find_tree(evidence, place.gaussians, ids.astype(np.uint32), place.cameras), evidence, ids)
    names = {number: name for name, numbers in place.things.items() for number in numbers}
    called = [names.get(int(np.bincount(place.labels[some] + 1).argmax()) - 1, "-") for some in found.ids]
    object_of = np.full(len(place.gaussians), -1, np.int32)
    for number, some in enumerate(found.ids):
        object_of[some] = number
    low, high = middle(place.gaussians, (0.01, 0.99))
    size = float(np.linalg.norm(high - low))
    flat = np.array(surfaces(object_of, len(found.ids), place.gaussians, size)) & found.listed
    said = Counter(name for name, is_flat in zip(called, flat, strict=True) if is_flat)
    large = found.listed & np.array([len(some) >= MANY for some in found.ids])
    there = Counter(name for name, counts in zip(called, large, strict=True) if counts and name in SURFACES)
    both = Counter(name for name, counts in zip(called, large & flat, strict=True) if counts)
    known = sum(said.values()) - said["-"]
    return (
        place.name, str(sum(said.values())), f"{sum(said[name] for name in SURFACES)} of {known}",
        ", ".join(f"{count} {name}" for name, count in said.most_common()),
        ", ".join(f"{count} {name} ({both[name]})" for name, count in there.most_common()),
    )  # fmt: skip


def flat(votes: list[voting.Vote]) -> list[voting.Vote]:
    """Every outline as strong as any other."""
    return [vote._replace(tree=replace(vote.tree, strengths=0.8 * vote.tree.lengths)) for vote in votes]


@contextmanager
def set_to(**values: float) -> Iterator[None]:
    before = {name: getattr(voting, name) for name in values}
    try:
        for name, value in values.items():
            setattr(voting, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(voting, name, value)


def measured(place: Place, folder: Path, kept: Path, pictures: Path | None) -> tuple[Mapping[str, Found], str]:
    ids = np.flatnonzero(np.diff(place.evidence.weights.indptr))
    evidence = place.evidence.rows(ids)
    started = time.perf_counter()
    tree = find_tree(evidence, place.gaussians, ids.astype(np.uint32), place.cameras)
    finding = time.perf_counter() - started
    by_name = {view.name: view for view in read_views(folder)}
    views = [by_name[name] for name in evidence.masks.view_names]
    electorate = _Electorate(Rows(ids), place.gaussians, views, kept / f"{folder.name}.votes", 0)
    started = time.perf_counter()
    electorate.look(lambda some, _: some)
    looking = time.perf_counter() - started
    votes = list(electorate.votes())
    started = time.perf_counter()
    voted = voting.with_voted(tree, lambda: votes)
    seconds = f"{len(views)} photos: {looking:.1f} s of looking, {time.perf_counter() - started:.1f} of voting, "
    trees = {"today": tree, "voted": voted, "outlines alike": voting.with_voted(tree, lambda: flat(votes))}
    with set_to(MAX_FRAMED=1.0):
        trees["frames ignored"] = voting.with_voted(tree, lambda: votes)
    with set_to(LARGE_SHARE=1.1):
        trees["stronger pieces joined"] = voting.with_voted(tree, lambda: votes)
    if pictures:
        draw(place, ids, tree, voted, pictures / f"{place.name.replace(', ', '_')}.jpg")
    found = {name: compared(place, listing(some, evidence, ids)) for name, some in trees.items()}
    return found, seconds + f"{finding:.1f} of finding the pieces"


def draw(place: Place, ids: np.ndarray, before: Tree, after: Tree, path: Path) -> None:
    """Each joined thing in the photo that shows most of it, its pieces in colours."""
    number = np.append(_owners(before.parents, before.levels == THING), -1)[before.node_of]
    whole = np.append(_owners(after.parents, after.levels == THING), -1)[after.node_of]
    joined = [thing for thing in np.unique(whole[whole >= 0]) if len(np.unique(number[whole == thing])) > 1]
    splats, tiles = splat_arrays(place.gaussians), []
    for thing in joined:
        pieces = np.zeros(len(place.gaussians), np.int32)
        _, pieces[ids[whole == thing]] = np.unique(number[whole == thing], return_inverse=True)
        pieces[ids[whole == thing]] += 1
        colors = np.where(pieces[:, None] > 0, COLORS[pieces % len(COLORS)] / 255, 0.15).astype(np.float32)
        values = np.concatenate([colors, (pieces > 0)[:, None]], 1).astype(np.float32)
        shown = [render_channels(splats, replace(view, distortion=None), values) for view in place.cameras]
        best = max(shown, key=lambda one: float(one.channels[..., 3].sum()))
        tiles.append(np.uint8(255 * np.clip(best.channels[..., :3], 0, 1)))
    if tiles:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_picture(path, contact_sheet(tiles, 4), overwrite=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+", metavar="ROOM or CAPTURE=SCENE")
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--masks", choices=("graph", "whole"), default="graph")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--surfaces", action="store_true")
    arguments = parser.parse_args()
    print(describe())
    results: dict[str, Mapping[str, Found]] = {}
    flat_rows = []
    for given in arguments.places:
        folder, _, scene = given.partition("=")
        path = Path(folder).resolve()
        if scene:
            outlined = outlines_path(path.name)
            kind = "sam" if arguments.masks == "whole" else "graph"
            place = capture(path, Path(scene), outlined if outlined.exists() else None, kind, arguments.kept)
        else:
            place = room(path, "true" if arguments.masks == "whole" else "graph", arguments.kept)
        if arguments.surfaces:
            flat_rows.append(surface_row(place))
            continue
        results[place.name], seconds = measured(place, path, arguments.kept, arguments.pictures)
        print(f"{place.name}: {seconds}")
    if flat_rows:
        print(markdown(("place", "surfaces", "right, of known", "what they are", "surfaces there (said)"), flat_rows))
        return
    names = list(next(iter(results.values())))
    rows = []
    for name, found in {**results, "mean": {n: mean([one[n] for one in results.values()]) for n in names}}.items():
        cells = (f"{one.precision:.2f}, {one.recall:.2f} ({one.listed:.0f}); {one.best:.3f}" for one in found.values())
        rows.append((name, *cells))
    print("\nP, R of the listed (their number); mean IoU of the best\n")
    print(markdown(("", *names), rows))
    print(f"\npeak memory {peak_memory_bytes() / 2**20:.0f} MiB")


def mean(found: list[Found]) -> Found:
    precision, recall, listed, best = np.mean(found, axis=0).tolist()
    return Found(precision, recall, round(listed), best)


if __name__ == "__main__":
    main()
