"""How well the boxes of objects fit, with and without leaving strays out, and those of thin things by name.

    python benchmarks/study_boxes.py world/scenes/room_6 ... [--masks graph true] [--kept FOLDER]

Objects are found without words, as `drsplat objects` does. The box of the object most like a true thing, by the IoU of
their Gaussians, is compared with the true box; a thing without an object of IoU 0.3 is not counted. Things are those
with 40 Gaussians that can be seen. --kept: where `study_objects.py` keeps the weights and the truth of rooms.

The numbers of the rule were chosen on table_1, table_3, room_5 and room_7.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.bench_boxes import LEAST, SOLID, fit, true_box
from benchmarks.study_objects import Room, ours, room_of
from benchmarks.suite.masks import MASKS
from drsplat import Gaussians, _native, read_views
from drsplat.kernels.boxes import MAX_STRAY_SHARE, MIN_TAIL_SPARSENESS, OUTLIER_SHARE
from drsplat.scene.boxes import Box, solid, upward

LEAST_ALIKE = 0.3
THIN = ("knife", "fork", "spoon", "book", "plate", "pan", "carrot", "candle", "bottle", "picture")


@dataclass(frozen=True, eq=False)
class Case:
    """A true thing and the object most like it. alike: the IoU of their Gaussians."""

    room: str
    name: str
    gaussians: Gaussians
    ids: np.ndarray
    alike: float
    up: np.ndarray
    truth: Box


def cases(folder: Path, masks: str, kept: Path) -> Iterator[Case]:
    """Yield the things of one room that are an object."""
    room, up = room_of(folder, masks, kept), upward(read_views(folder))
    labels = ours(room)
    for thing in json.loads((folder / "truth.json").read_text(encoding="utf-8"))["objects"]:
        if np.count_nonzero(room.gaussians.opacities[room.owners == thing["id"]] >= SOLID) < LEAST:
            continue
        rows, alike = most_alike(room, labels, thing["id"])
        if alike >= LEAST_ALIKE:
            ids = solid(room.gaussians, room.ids[rows])
            yield Case(folder.name, thing["name"], room.gaussians, ids, alike, up, true_box(thing["box"]))


def most_alike(room: Room, labels: np.ndarray, thing: int) -> tuple[np.ndarray, float]:
    """Return the rows of the object most like a true thing, and the IoU of their Gaussians."""
    true = room.owners[room.ids] == thing
    best: tuple[np.ndarray, float] = (np.zeros(0, np.int64), 0.0)
    for label in np.unique(labels[true & (labels >= 0)]):
        own = labels == label
        alike = float((own & true).sum() / (own | true).sum())
        best = max(best, (np.flatnonzero(own), alike), key=lambda pair: pair[1])
    return best


def box_by(case: Case, strays: float) -> Box:
    """Return the box of a case where tails of up to `strays` of the mass may be left out."""
    part = case.gaussians
    arrays = part.means, part.quats, part.scales, part.opacities
    sets = np.array([0, len(case.ids)]), np.ascontiguousarray(case.ids, np.int64)
    center, axes, extent = _native.boxes(*arrays, *sets, case.up, OUTLIER_SHARE, strays, MIN_TAIL_SPARSENESS, 1)
    return Box(np.asarray(center)[0] + part.origin, np.asarray(axes)[0], np.asarray(extent)[0])


Way = Callable[[Case], Box]
WAYS: dict[str, Way] = {
    "all Gaussians": partial(box_by, strays=0.0),
    "without outliers": partial(box_by, strays=MAX_STRAY_SHARE),
}


def print_table(known: dict[str, list[Case]]) -> None:
    """Print a row for each kind of masks and rule; known: cases by kind of masks."""
    print("| masks | box | IoU, mean | median | Acc@0.25 | Acc@0.5 | IoU, thin things |\n|---|---|--:|--:|--:|--:|--:|")
    for masks, of_kind in known.items():
        thin = np.array([case.name in THIN for case in of_kind])
        for name, way in WAYS.items():
            ious = np.array([fit(way(case), case.truth).iou for case in of_kind])
            shares = " | ".join(f"{(ious >= least).mean():.0%}" for least in (0.25, 0.5))
            middle = f"{ious.mean():.3f} | {np.median(ious):.3f}"
            print(f"| {masks} ({len(ious)}) | {name} | {middle} | {shares} | {ious[thin].mean():.3f} ({thin.sum()}) |")


def print_thin(known: dict[str, list[Case]]) -> None:
    """Print a row for each thin thing, with sides in metres, longest first."""
    print(
        "\n| masks | thing | Gaussians, IoU | true sides | "
        + " | ".join(WAYS)
        + " | IoU |\n|---|---|--:|---|---|---|---|"
    )
    for masks, of_kind in known.items():
        for case in sorted((case for case in of_kind if case.name in THIN), key=lambda case: THIN.index(case.name)):
            boxes = [way(case) for way in WAYS.values()]
            sides = " | ".join(sides_of(box) for box in (case.truth, *boxes))
            ious = " -> ".join(f"{fit(box, case.truth).iou:.2f}" for box in boxes)
            print(f"| {masks} | {case.room}, {case.name} | {case.alike:.2f} | {sides} | {ious} |")


def sides_of(box: Box) -> str:
    """Return the full lengths of a box, longest first."""
    return " x ".join(f"{side:.3f}" for side in sorted(box.extent, reverse=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--masks", nargs="+", choices=MASKS, default=["graph", "true"])
    parser.add_argument("--kept", type=Path, default=Path("kept"))
    arguments = parser.parse_args()
    known = {
        kind: [case for folder in arguments.scenes for case in cases(folder, kind, arguments.kept)]
        for kind in arguments.masks
    }
    print_table(known)
    print_thin(known)


if __name__ == "__main__":
    main()
