"""Whether "on" and "next to" are right, of the true things of made rooms: how they lie is known by their boxes.

    python benchmarks/study_contact.py ROOM...

ROOM: a folder of world/scenes. A thing is on a table, shelf, sofa, chair, stool, box, basket or pot whose true box it
stands in, seen from above, no higher than 3 cm above it and 5 cm or more above the floor; on the floor or rug, lower.
Asked are all pairs of which that is true, and those that are nearer than their boxes' diagonals and of which it is not.
Two things are next to each other if their boxes share a tenth of the lower one's heights, neither stands on the
other, and the boxes are no further apart, seen from above, than the mean of their longest sides; pairs of which that
depends on which way a box is turned are not asked. The numbers of `rests_on` were chosen on table_1, table_3, room_7
and three rooms that were made for it.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.places import true_things
from benchmarks.suite.scenes import read_scene
from benchmarks.suite.tables import markdown
from drsplat import Match
from drsplat.kernels.boxes import box_of
from drsplat.query.relations import lies_next_to, stands_on
from drsplat.scene.boxes import up_of

NEXT_TO = "next to things"
EDGE_POINTS = 24  # of a side of a box
SUPPORTS = {"table", "sofa", "shelf", "chair", "stool", "box", "basket", "pot"}
FLAT = {"floor", "rug"}
LEAST, LOW, OVER = 40, 0.05, 0.03  # Gaussians; metres above the floor, and above a support's box


def pairs(folder: Path) -> Iterator[tuple[str, bool, bool]]:
    """Yield of each pair the kind of its support, whether the one is on it, and whether we say so."""
    made = read_scene(folder)
    labels, up = true_things(made)[0], up_of(made.views)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    known, matches = {}, {}
    for one in (*truth["objects"], *truth["structures"]):
        ids = np.flatnonzero(labels == one["id"])
        if len(ids) >= LEAST:
            known[one["id"]] = one
            matches[one["id"]] = Match(*box_of(made.gaussians, ids, up), 1.0, ids, object_id=one["id"])
    for number, one in known.items():
        for other_number, other in known.items():
            if number == other_number or "position" not in one:
                continue
            true = is_true(one, other)
            thing, support = matches[number], matches[other_number]
            reach = (np.linalg.norm(thing.extent) + np.linalg.norm(support.extent)) / 2
            if true or np.linalg.norm(thing.center - support.center) <= reach:
                kind = other["name"] if "box" not in other else "things"
                said = "floor and rug" if kind in FLAT else kind
                yield said, true, stands_on(made.gaussians, thing, support, up)
            beside = is_next_to(one, other) if number < other_number else None
            if beside is not None:
                yield NEXT_TO, beside, lies_next_to(made.gaussians, matches[number], matches[other_number], up)


def is_next_to(one: dict[str, Any], other: dict[str, Any]) -> bool | None:
    """Return whether two things are next to each other by their boxes; None where that is not asked."""
    if "box" not in one or "box" not in other or is_true(one, other) or is_true(other, one):
        return None
    boxes = one["box"], other["box"]
    (low, high), (foot, head) = ((box["center"][2] - box["size"][2] / 2, box["center"][2] + box["size"][2] / 2)
                                 for box in boxes)  # fmt: skip
    if min(high, head) - max(low, foot) < 0.1 * min(high - low, head - foot):
        return None
    reach = sum(max(box["size"]) for box in boxes) / 2
    near = {
        bool(np.linalg.norm(sides[0][:, None] - sides[1], axis=2).min() <= reach)
        for sides in ([_sides(box, way) for box in boxes] for way in (1, -1))
    }
    return near.pop() if len(near) == 1 else None


def _sides(box: dict[str, Any], way: int) -> np.ndarray:
    """Return points of the sides of a box, seen from above. way: which way its degrees turn."""
    along = np.linspace(-0.5, 0.5, EDGE_POINTS)
    across = np.repeat([-0.5, 0.5], EDGE_POINTS)
    points = np.concatenate([np.c_[np.tile(along, 2), across], np.c_[across, np.tile(along, 2)]]) * box["size"][:2]
    a = way * np.radians(box["degrees"])
    return np.asarray(points @ [[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] + box["center"][:2])


def is_true(one: dict[str, Any], other: dict[str, Any]) -> bool:
    height = one["position"][2]
    if "box" not in other:
        return other["name"] in FLAT and height < LOW
    box = other["box"]
    angle, offset = np.radians(box["degrees"]), np.subtract(one["position"][:2], box["center"][:2])
    turns = (np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in (angle, -angle))
    within = any((np.abs(turn @ offset) <= np.array(box["size"][:2]) / 2).all() for turn in turns)
    low = box["center"][2] - box["size"][2] / 2
    return bool(other["name"] in SUPPORTS and height > LOW and within and low < height <= low + box["size"][2] + OVER)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", type=Path)
    print(describe())
    counts: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(4, int))
    for folder in parser.parse_args().rooms:
        for kind, true, said in pairs(folder):
            counts[kind] += [true, true and said, not true, not true and said]
    titles = ("on", "true", "said", "false", "said")
    print(markdown(titles, [(kind, *map(str, row)) for kind, row in counts.items()]))


if __name__ == "__main__":
    main()
