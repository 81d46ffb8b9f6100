"""What selection could be at best: the protocol of lerf-ovs with choices that know the truth.

    python benchmarks/study_bounds.py world/scenes/room_5 ... [--masks graph true] [--kept FOLDER]

A query's category is the truth's things of that name. Each row of the table is the mIoU of a choice for every query,
means over rooms: the default threshold on cosines of Gaussians and of objects (what is asked today); of both the
threshold that selects most of the Gaussians of the category and least others; the object, and the set of objects, that
does so; and the Gaussians of the category themselves, which the protocol does not give 100 either.
--kept: as of study_objects.py.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.study_objects import MINI, Room, ours, room_of
from benchmarks.suite.masks import MASKS
from benchmarks.suite.scenes import BenchScene, read_scene
from drsplat.evaluation import lerf_ovs, metrics
from drsplat.evaluation.predictions import FIXED
from drsplat.evaluation.scorers import Scorer
from drsplat.query.thresholds import default_threshold
from drsplat.query.wholes import with_objects

Selection = Callable[[str], np.ndarray]


@dataclass(frozen=True, eq=False)
class Asked:
    """A room's Gaussians that some photo shows: embeddings, objects (-1 for none) and true categories."""

    features: np.ndarray
    things: np.ndarray
    mine: Mapping[str, np.ndarray]

    def cosines(self, text: str) -> np.ndarray:
        return np.asarray(self.features @ MINI.encode_texts([text])[0], np.float32)

    def of_objects(self, text: str) -> np.ndarray:
        """As `drsplat select` has them, of things without parts."""
        return with_objects(self.cosines(text), self.things, np.full_like(self.things, -1))

    def by_default(self, values: Callable[[str], np.ndarray], text: str) -> np.ndarray:
        found = values(text)
        return np.asarray(found >= default_threshold(found, MINI.threshold))

    def by_best_threshold(self, values: Callable[[str], np.ndarray], text: str) -> np.ndarray:
        """That of the largest IoU, over Gaussians, with those of the category."""
        found, mine = values(text), self.mine[text]
        order = np.argsort(-found, kind="stable")
        hits = np.cumsum(mine[order])
        ious = hits / (np.arange(1, len(hits) + 1) + mine.sum() - hits)
        last = np.append(np.diff(found[order]) != 0, True)  # of equal values all or none
        return np.asarray(found >= found[order][np.where(last, ious, -1).argmax()])

    def objects(self, text: str, most: int) -> np.ndarray:
        """The set, of up to so many, of the largest IoU: the purest first, as long as the IoU grows."""
        numbers = self.things + 1
        sizes, hits = np.bincount(numbers), np.bincount(numbers, self.mine[text])
        wanted, total = hits[1:], sizes[1:]
        order = np.argsort(-wanted / np.maximum(total, 1), kind="stable") if most > 1 else np.arange(len(total))
        everything = self.mine[text].sum()
        if most == 1:
            best = (wanted / np.maximum(total + everything - wanted, 1)).argmax()
            return np.asarray(numbers == best + 1)
        hits, all_of_them = np.cumsum(wanted[order]), np.cumsum(total[order])
        ious = hits / np.maximum(all_of_them + everything - hits, 1)
        return np.isin(numbers, order[: ious.argmax() + 1] + 1)

    def selections(self) -> Mapping[str, Selection]:
        return {
            "Gaussians, default": partial(self.by_default, self.cosines),
            "objects, default": partial(self.by_default, self.of_objects),
            "Gaussians, best threshold": partial(self.by_best_threshold, self.cosines),
            "objects, best threshold": partial(self.by_best_threshold, self.of_objects),
            "best object": partial(self.objects, most=1),
            "best objects": partial(self.objects, most=len(self.things)),
            "true Gaussians": self.mine.__getitem__,
        }


def asked(room: Room, scene: BenchScene, categories: Mapping[int, str]) -> Asked:
    features = np.concatenate(
        [room.evidence.features(at, min(at + 4096, len(room.ids))) for at in range(0, len(room.ids), 4096)]
    )
    owners = room.owners[room.ids]
    mine = {
        text: np.isin(owners, [thing for thing, category in categories.items() if category == text])
        for text in scene.lerf.categories
    }
    return Asked(features, ours(room), mine)


def bounds(folder: Path, masks: str, kept: Path) -> Iterator[tuple[str, float]]:
    room, scene = room_of(folder, masks, kept), read_scene(folder)
    known = asked(room, scene, room.categories)
    for name, selection in known.selections().items():
        scorer = Scorer(name, len(room.gaussians), partial(dense, room, selection), 0.5, ())
        with TemporaryDirectory(prefix="drsplat-bounds-") as place:
            lerf_ovs.predict(scene.lerf, scene.gaussians, scorer, Path(place))
            yield name, lerf_ovs.score([scene.lerf], Path(place))["columns"][FIXED]["scene_macro"]["miou"]


def dense(room: Room, selection: Selection, text: str) -> np.ndarray:
    values = np.full(len(room.gaussians), np.nan, np.float32)
    values[room.ids] = selection(text)
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--masks", nargs="+", choices=MASKS, default=["graph", "true"])
    parser.add_argument("--kept", type=Path, default=Path("kept"))
    arguments = parser.parse_args()
    found: dict[str, dict[str, list[float]]] = {}
    for masks in arguments.masks:
        for folder in arguments.scenes:
            for name, miou in bounds(folder, masks, arguments.kept):
                found.setdefault(name, {}).setdefault(masks, []).append(100 * miou)
            print(f"{folder.name}, {masks}", file=sys.stderr, flush=True)
    print("| selected |", " | ".join(arguments.masks), "|")
    print("|---" + "|--:" * len(arguments.masks) + "|")
    for name, values in found.items():
        print(f"| {name} |", " | ".join(f"{metrics.mean(values[masks]):.1f}" for masks in arguments.masks), "|")


if __name__ == "__main__":
    main()
