"""How often "on" is right between the things of a room: by contact of Gaussians, and by boxes as it was before.

    python benchmarks/study_relations.py world/scenes/room_6 ... [--masks graph true] [--kept FOLDER]

A true thing is on another where its foot is within the other's box as seen from above, higher than the other's foot and
at most a centimetre above its top. Asked of all ordered pairs of true things, each as the object most like it (IoU of
Gaussians of 0.3 or more). --kept: where `study_objects.py` keeps the weights and the truth of rooms.
"""

import argparse
import json
import sys
from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.bench_boxes import true_box
from benchmarks.study_boxes import LEAST_ALIKE, most_alike
from benchmarks.study_objects import ours, room_of
from benchmarks.suite.masks import MASKS
from drsplat import Gaussians, read_views
from drsplat.query.relations import rests_on
from drsplat.scene.boxes import solid, upward

Rule = Callable[[Gaussians, np.ndarray, np.ndarray, np.ndarray], bool]


def by_boxes(gaussians: Gaussians, thing: np.ndarray, support: np.ndarray, up: np.ndarray) -> bool:
    """Return what the former rule said: the foot in the upper half of the support, the middle over it."""
    above, below = (gaussians.positions[solid(gaussians, ids)] for ids in (thing, support))
    low, top = np.quantile(below @ up, (0.02, 0.98))
    foot, head = np.quantile(above @ up, (0.02, 0.98))
    if foot < (low + top) / 2 or foot - top > 0.5 * max(head - foot, 1e-9):
        return False
    flat = np.eye(3) - np.outer(up, up)
    size = float(np.linalg.norm(np.ptp(below @ flat, axis=0)))
    return bool(cKDTree(below @ flat).query(above.mean(0) @ flat)[0] <= 0.05 * size)


RULES: dict[str, Rule] = {"boxes (before)": by_boxes, "contact": rests_on}


def is_on(thing: dict[str, Any], other: dict[str, Any]) -> bool:
    """Return whether one true thing is on another."""
    (own, support), foot = (true_box(each["box"]) for each in (thing, other)), thing["position"][2]
    inside = (np.abs((own.center - support.center) @ support.axes.T) <= support.extent / 2)[:2].all()
    low, top = support.center[2] + support.extent[2] / 2 * np.array([-1, 1])
    return bool(inside and low + 0.005 < foot <= top + 0.01)


def answers(folder: Path, masks: str, kept: Path) -> list[tuple[str, bool, list[bool]]]:
    """Return the name of each pair, whether it is true, and what each rule says."""
    room, up = room_of(folder, masks, kept), upward(read_views(folder))
    labels, things = ours(room), json.loads((folder / "truth.json").read_text(encoding="utf-8"))["objects"]
    found = {}
    for thing in things:
        rows, alike = most_alike(room, labels, thing["id"])
        if alike >= LEAST_ALIKE:
            found[thing["id"]] = room.ids[rows]
    pairs = [pair for pair in permutations(things, 2) if all(each["id"] in found for each in pair)]
    return [
        (
            f"{folder.name}: {thing['category']} on {other['category']}",
            is_on(thing, other),
            [rule(room.gaussians, found[thing["id"]], found[other["id"]], up) for rule in RULES.values()],
        )
        for thing, other in pairs
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--masks", nargs="+", choices=MASKS, default=["graph", "true"])
    parser.add_argument("--kept", type=Path, default=Path("kept"))
    arguments = parser.parse_args()
    faults = []
    print("| masks | rule | precision | recall | right, of true, of reported |\n|---|---|--:|--:|---|")
    for masks in arguments.masks:
        known = [answer for folder in arguments.scenes for answer in answers(folder, masks, arguments.kept)]
        true = np.array([truth for _, truth, _ in known])
        for number, rule in enumerate(RULES):
            said = np.array([says[number] for _, _, says in known])
            right = int((true & said).sum())
            shares = f"{right / max(said.sum(), 1):.2f} | {right / max(true.sum(), 1):.2f}"
            print(f"| {masks} | {rule} | {shares} | {right} of {true.sum()}, of {said.sum()} |")
        faults += [(masks, name, truth) for name, truth, says in known if says[-1] != truth]
    print("\nWrong by contact:")
    for masks, name, truth in faults:
        print(f"- {masks}, {'missed' if truth else 'invented'}: {name}")


if __name__ == "__main__":
    main()
