"""How many photos, points and crops answers need: each saving beside all photos, 1,024 points and all crops.

    python benchmarks/study_embedding.py PLACE... --clip FOLDER --kept FOLDER [--seeds 30] [--photos | --draws 5]

PLACE: a packed room of world/scenes, or CAPTURE=SCENE, a capture with the scene that was trained on it. Masks are of a
simulated SAM (`suite/simulated_sam.py`): "nested32" and "grid32" are asked 1,024 points a photo, of which the second
drops masks that lie in others, as LangSplat does; "rounds" are asked coarse to fine. Words and embeddings are drawn as
in `suite/trials.py`, a fifth of them wrong; objects are found once for a way (`suite/paired.py`). --photos: ways to
choose photos alone, half and three quarters of them: "evenly" by name, "chosen" as `embed --views N` does. --draws: so
many draws of all that the simulated SAM gets wrong, each way beside all points of its own draw.

Columns: photos, points a photo, embedded crops; without any word, the mean IoU over true things of the best part, thing
or group with each; the IoU of words, its mean difference over the same words of the same draws to the first way, with
half of a 95 % interval over words; present words that find nothing and absent ones that find something. Rows of "all"
pool the places.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import CAPTURE, kind_of, place_of
from benchmarks.suite.masks import ASKING, simulated_sam
from benchmarks.suite.paired import Answers, Way, differences, interval, way_of
from benchmarks.suite.places import Place, capture_sam
from benchmarks.suite.simulated_sam import SimulatedSam
from benchmarks.suite.trials import LEAST
from benchmarks.suite.vocabularies import Clip
from drsplat import View, load_image
from drsplat.field.objects.choosing import Tree
from drsplat.photos.embedding.objects_first import share_crops
from drsplat.photos.embedding.view_choice import choose_views
from drsplat.photos.models.point_masks import PointSegmenter

WRONG = 0.2
SHARES = 0.5, 0.75


class Row(NamedTuple):
    """A way's numbers. differences: of the IoU of words to the first way's."""

    photos: int
    crops: int
    fit: float
    answers: Answers
    differences: np.ndarray


def savings(given: str, kept: Path) -> Iterator[tuple[str, Place]]:
    """Yield the place with all photos, points and crops, then with savings."""
    for kind in ("nested32", "grid32", "rounds"):
        place = place_of(given, kind, kept)
        yield f"{kind}, all photos, all crops", place
    yield "rounds, all photos, crops of objects", _sharing(place)
    chosen = [view.name for view in choose_views(place.gaussians, cameras(place)).views]
    yield "rounds, photos that show enough, crops of objects", _sharing(replace(place, photos=set(chosen)))
    yield "rounds, as many evenly, crops of objects", _sharing(replace(place, photos=evenly(place, len(chosen))))


def choices(given: str, kept: Path) -> Iterator[tuple[str, Place]]:
    """Yield the place with all photos, then with some of them."""
    place = place_of(given, "rounds", kept)
    yield "rounds, all photos, all crops", place
    for share in SHARES:
        most = round(share * len(place.evidence.masks.view_names))
        best = choose_views(place.gaussians, cameras(place), enough=1.0, most=most)
        yield f"rounds, {share:.0%} evenly", replace(place, photos=evenly(place, most))
        yield f"rounds, {share:.0%} chosen", replace(place, photos={view.name for view in best.views})


def drawn(given: str, kept: Path, draw: int) -> Iterator[tuple[str, Place]]:
    """Yield the place with masks of a draw of the simulated SAM: of all points, in rounds, and with all savings."""
    for way in ("nested32", "rounds"):
        place = place_of(given, f"{way}.{draw}" if draw else way, kept)
        yield f"{way}, all photos, all crops", place
    yield "rounds, all photos, crops of objects", _sharing(place)
    chosen = {view.name for view in choose_views(place.gaussians, cameras(place)).views}
    yield "rounds, photos that show enough, all crops", replace(place, photos=chosen)
    yield "rounds, photos that show enough, crops of objects", _sharing(replace(place, photos=chosen))


def cameras(place: Place) -> list[View]:
    """Return the cameras of the photos with masks, by name."""
    by_name = {view.name: view for view in place.cameras}
    return [by_name[name] for name in place.evidence.masks.view_names]


def evenly(place: Place, count: int) -> set[str]:
    names = sorted(place.evidence.masks.view_names)
    return {names[number] for number in np.linspace(0, len(names) - 1, count).round().astype(int)}


def _sharing(place: Place) -> Place:
    """Return the place whose masks share the crops of objects, which are found without any embedding."""
    evidence = place.evidence_of(np.ones((len(place.owners), 1), np.float32))
    return replace(place, crops=share_crops(evidence, place.gaussians, place.cameras))


def points_of(given: str, place: Place, kind: str) -> float:
    """Return how many points a photo is asked, in rounds of every fourth photo."""
    if ASKING[kind].first_points_per_side is None:
        return ASKING[kind].points_per_side ** 2
    if kind_of(given) == CAPTURE:
        sam = PointSegmenter(capture_sam(place), ASKING[kind])
    else:
        sam = simulated_sam(Path(given).resolve(), kind)
    predictor = sam.predictor
    assert isinstance(predictor, SimulatedSam)
    before, some = predictor.asked, cameras(place)[::4]
    for view in some:
        sam.segment(load_image(view))
    return (predictor.asked - before) / len(some)


def fit(way: Way) -> float:
    """Return the mean IoU of true things with the best node of the objects."""
    place, tree = way.place, way.tree
    mass, labels, best = place.mass[way.ids], place.labels[way.ids], []
    for numbers in place.things.values():
        whole = np.isin(place.labels, numbers)
        total = place.mass[whole].sum()
        if whole.sum() >= LEAST and total:
            inside, chosen = sums(tree, mass * np.isin(labels, numbers)), sums(tree, mass)
            best.append((inside / (chosen + total - inside)).max())
    return float(np.mean(best))


def sums(tree: Tree, values: np.ndarray) -> np.ndarray:
    """Return the sum over the rows of each node, those of the nodes below it included."""
    placed = tree.node_of >= 0
    totals = np.bincount(tree.node_of[placed], values[placed], len(tree.parents))
    for node, parent in enumerate(tree.parents):  # a parent comes after its children
        if parent >= 0:
            totals[parent] += totals[node]
    return totals


def measured(place: Place, clip: Clip, seeds: int, first: Answers | None) -> Row:
    way = way_of(place)
    answers = way.answers(clip, WRONG, range(seeds))
    crops = len(way.seen.masks) if place.crops is None else len(place.crops.chosen)
    differing = differences(answers, answers if first is None else first)
    return Row(len(way.seen.masks.view_names), crops, fit(way), answers, differing)


def line(name: str, points: float, rows: list[Row]) -> str:
    """Return a line of the table: means of places, and of the words of all of them."""
    differing = np.concatenate([row.differences for row in rows])
    asked = [one for row in rows for one in row.answers.present.values()]
    counts = " | ".join(f"{np.mean(numbers):.0f}" for numbers in ([row.photos for row in rows], points))
    crops, fits = np.mean([row.crops for row in rows]), np.mean([row.fit for row in rows])
    iou, missed = (np.mean(numbers) for numbers in zip(*asked, strict=True))
    found = np.mean([found for row in rows for found in row.answers.absent.values()])
    return (
        f"| {name} | {counts} | {crops:.0f} | {fits:.3f} | {iou:.3f} | {differing.mean():+.3f} ± "
        f"{interval(differing):.3f} | {missed:.0%} | {found:.0%} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--photos", action="store_true")
    parser.add_argument("--draws", type=int, default=0)
    arguments = parser.parse_args()
    clip = Clip(arguments.clip)
    columns = "photos | points | crops | objects fit | words | difference | missed | absent found"
    print(f"| place: way | {columns} |\n" + "|---" * 9 + "|")
    pooled, points = defaultdict(list), defaultdict(list)
    compared = [partial(drawn, draw=draw) for draw in range(arguments.draws)]
    for given, ways in product(arguments.places, compared or [choices if arguments.photos else savings]):
        first = None
        for name, place in ways(given, arguments.kept):
            row = measured(place, clip, arguments.seeds, first)
            first = first or row.answers
            pooled[name].append(row)
            points[name].append(points_of(given, place, name.partition(",")[0]))
            print(line(f"{place.name.partition(',')[0]}: {name}", points[name][-1], [row]), flush=True)
    for name, rows in pooled.items():
        print(line(f"all: {name}", np.mean(points[name]), rows))


if __name__ == "__main__":
    main()
