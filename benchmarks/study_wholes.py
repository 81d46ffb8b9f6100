"""What an edit takes of a thing of which single Gaussians were selected: in made rooms, and in real captures.

python benchmarks/study_wholes.py FOLDER... [CAPTURE=SCENE...] [--shares SHARE...] [--clip FOLDER --kept FOLDER]

Places and columns are those of study_loose_parts.py. A thing of a room is asked for by its name, one of a capture by a
click into its middle in each photo, both with objects="never"; of several matches the one that has most of the thing
counts. Each selection becomes what an edit takes, with objects taken whole of which it has each share and more.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.study_loose_parts import LEAST_PIXELS, _left_and_taken, _pixels, clicks_in, true_owners, views_of
from benchmarks.suite.vocabularies import Clip
from drsplat import Query, Scene, View, open_scene
from drsplat.authoring.editing.resolving import completed
from drsplat.errors import InputError

LEAST = 0.1  # of a thing's Gaussians that a selection has: less is no selection of it
Numbers = tuple[float, ...]
Measure = Callable[[np.ndarray], Numbers]
Row = tuple[str, np.ndarray, list[Numbers]]  # thing, Gaussians, numbers of each share


def in_room(folder: Path, shares: list[float]) -> Iterator[Row]:
    scene = open_scene(folder)
    truth, names = true_owners(folder, scene.gaussians.positions)
    for number, name in enumerate(names):
        own = truth == number
        views = views_of(scene)
        shown = [(view, pixels) for view in views if (pixels := _pixels(folder, view, number)).sum() >= LEAST_PIXELS]
        ids = selected(scene, Query(text=name, objects="never"), own) if shown and own.any() else np.zeros(0, int)
        if own[ids].sum() >= LEAST * max(1, own.sum()):
            measure = partial(left_and_taken, scene, own, truth >= 0, shown)
            yield name, ids, measured(scene, ids, shares, measure)


def left_and_taken(
    scene: Scene, own: np.ndarray, known: np.ndarray, shown: list[tuple[View, np.ndarray]], rows: np.ndarray
) -> Numbers:
    return _left_and_taken(scene, rows, own, known, shown)


def in_capture(capture: str, shares: list[float], clip: Clip, kept: Path) -> Iterator[Row]:
    for one in clicks_in(capture, clip, kept):
        own = np.zeros(len(one.scene.gaussians), bool)
        own[one.scene.ask(Query(click=one.click)).gaussian_ids] = True
        ids = selected(one.scene, Query(click=one.click, objects="never"), own)
        if len(ids):
            yield one.thing, ids, measured(one.scene, ids, shares, one.measured)


def selected(scene: Scene, query: Query, own: np.ndarray) -> np.ndarray:
    """Return the match with most of a thing, no Gaussians where there is none."""
    try:
        matches = scene.locate(query)
    except InputError:
        matches = []
    return max((match.gaussian_ids for match in matches), key=lambda ids: own[ids].sum(), default=np.zeros(0, int))


def measured(scene: Scene, ids: np.ndarray, shares: list[float], measure: Measure) -> list[Numbers]:
    """Measure what an edit takes, with objects taken whole from each share on; the same ones once."""
    owners, made = scene.object_ids().astype(np.int64), dict[bytes, Numbers]()
    owned, inside = owners >= 0, np.isin(np.arange(len(owners)), ids)
    selected_of = np.bincount(owners[owned & inside], minlength=len(scene.agreed)) / np.bincount(owners[owned])
    keys = [(selected_of >= share).tobytes() for share in shares]
    for share, key in zip(shares, keys, strict=True):
        if key not in made:
            rows = np.flatnonzero(inside | owned & (selected_of >= share)[owners])
            made[key] = measure(completed(scene.gaussians, rows, owners, scene.agreed))
    return [made[key] for key in keys]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--shares", nargs="+", type=float, default=[0.95, 0.75, 0.5, 0.35, 0.2])
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--kept", type=Path)
    given = parser.parse_args()
    for place in given.places:
        name = Path(place.partition("=")[0]).name
        is_capture = "=" in place
        rows = (
            in_capture(place, given.shares, Clip(given.clip), given.kept)
            if is_capture
            else in_room(Path(place), given.shares)
        )
        numbers = []
        for thing, ids, every in rows:
            numbers.append(every)
            cells = " | ".join(" ".join(f"{x:.3f}" for x in way) for way in every)
            print(f"| {name} | {thing} | {len(ids):,} | {cells} |", flush=True)
        for share, means in zip(given.shares, np.mean(numbers, axis=0), strict=True):
            left, taken, *others = means
            print(f"{name}, {len(numbers)} selections: from {share:g} on left {left:.4f}, taken {taken:.4f}", end="")
            print("".join(f", iou {one:.4f}" for one in others), flush=True)


if __name__ == "__main__":
    main()
