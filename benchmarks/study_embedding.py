"""How many photos, points and crops answers need: each saving alone, and all of them, beside none.

    python benchmarks/study_embedding.py PLACE... --clip FOLDER --kept FOLDER [--seeds 4] [--shares 0.35 0.5]

PLACE: a packed room of world/scenes, of which a simulated SAM (`suite/simulated_sam.py`) makes the masks; or
CAPTURE=SCENE, a capture with the scene that was trained on it, with masks of whole things and those of `graph`. Words
and embeddings are drawn as in `suite/trials.py`, a fifth of them wrong. "grid": 1,024 points a photo; "rounds": coarse
to fine. "evenly": photos evenly spaced by name. Columns: photos, points a photo, embedded crops; without any word, by
weight in photos whose truth is known, the mean IoU over true things of the best part, thing or group with each, and of
the Gaussians whose masks show most of it; with words (not where --seeds is 0) the IoU of the plain field and with
objects, present words that find nothing and absent ones that find something. After IoUs of words, half of a 95 %
interval over words.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import CAPTURE, Draws, kind_of, place_of, record_of
from benchmarks.suite.masks import GRID, ROUNDS, simulated_sam
from benchmarks.suite.places import Place
from benchmarks.suite.simulated_sam import SimulatedSam
from benchmarks.suite.trials import LEAST, trial
from benchmarks.suite.vocabularies import Clip
from drsplat import View, load_image
from drsplat.embedding.shared_crops import share_crops
from drsplat.embedding.view_choice import choose_views
from drsplat.evidence.evidence import Evidence
from drsplat.objects.choosing import Tree
from drsplat.objects.finding import find_tree

WRONG = 20  # percent
SETTINGS = {"grid": GRID, "rounds": ROUNDS}


def ways(given: str, kept: Path, shares: list[float]) -> Iterator[tuple[str, Place]]:
    """Yield the place with all photos and crops, then with each saving, and with all."""
    kinds = ("sam", "graph") if kind_of(given) == CAPTURE else ("grid", "rounds")
    for kind in kinds:
        place = place_of(given, kind, kept)
        yield f"{kind}, all photos, all crops", place
        yield f"{kind}, crops of objects", _sharing(place)
        chosen = [view.name for view in choose_views(place.gaussians, _cameras(place)).views]
        few = replace(place, photos=set(chosen))
        yield f"{kind}, photos that show enough", few
        yield f"{kind}, as many evenly", replace(place, photos=_evenly(place, len(chosen)))
        yield f"{kind}, photos that show enough, crops of objects", _sharing(few)
        for share in shares:
            most = round(share * len(place.evidence.masks.view_names))
            best = choose_views(place.gaussians, _cameras(place), enough=1.0, most=most)
            yield f"{kind}, {share:.0%} of the photos", replace(place, photos={view.name for view in best.views})
            yield f"{kind}, {share:.0%} evenly", replace(place, photos=_evenly(place, most))


def _cameras(place: Place) -> list[View]:
    """Return the cameras of the photos with masks, by name."""
    by_name = {view.name: view for view in place.cameras}
    return [by_name[name] for name in place.evidence.masks.view_names]


def _evenly(place: Place, count: int) -> set[str]:
    names = sorted(place.evidence.masks.view_names)
    return {names[number] for number in np.linspace(0, len(names) - 1, count).round().astype(int)}


def _sharing(place: Place) -> Place:
    """Return the place whose masks share the crops of objects, which are found without any embedding."""
    evidence = place.evidence_of(np.ones((len(place.owners), 1), np.float32))
    return replace(place, crops=share_crops(evidence, place.gaussians, place.cameras))


def points_of(given: str, kind: str) -> str:
    """Return how many points a photo is asked, of every fourth photo."""
    if kind not in SETTINGS:
        return "-"
    sam = simulated_sam(Path(given).resolve(), SETTINGS[kind])
    predictor = sam.predictor
    assert isinstance(predictor, SimulatedSam)
    if SETTINGS[kind].first_points_per_side is None:
        return str(SETTINGS[kind].points_per_side ** 2)
    before, some = predictor.asked, predictor.views[::4]
    for view in some:
        sam.segment(load_image(view))
    return f"{(predictor.asked - before) / len(some):.0f}"


def fits(place: Place, evidence: Evidence) -> tuple[float, float]:
    """Return the mean IoU of true things with the best node of the objects, and with what masks say of Gaussians."""
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    seen = evidence.rows(ids)
    tree = find_tree(seen, place.gaussians, ids.astype(np.uint32), place.cameras)
    mass, labels, said = place.mass[ids], place.labels[ids], _said(place, seen)
    of_nodes, by_masks = [], []
    for numbers in place.things.values():
        whole = np.isin(place.labels, numbers)
        total = place.mass[whole].sum()
        if whole.sum() < LEAST or not total:
            continue
        inside = mass * np.isin(labels, numbers)
        of_nodes.append(_ious(_sums(tree, inside), _sums(tree, mass), total).max())
        chosen = np.isin(said, numbers)
        by_masks.append(float(_ious(inside[chosen].sum(), mass[chosen].sum(), total)))
    return float(np.mean(of_nodes)), float(np.mean(by_masks))


def _sums(tree: Tree, values: np.ndarray) -> np.ndarray:
    """Return the sum over the rows of each node, those of the nodes below it included."""
    placed = tree.node_of >= 0
    sums = np.bincount(tree.node_of[placed], values[placed], len(tree.parents))
    for node, parent in enumerate(tree.parents):  # a parent comes after its children
        if parent >= 0:
            sums[parent] += sums[node]
    return sums


def _ious(shared: np.ndarray, chosen: np.ndarray, whole: float) -> np.ndarray:
    return np.asarray(shared / (chosen + whole - shared))


def _said(place: Place, seen: Evidence) -> np.ndarray:
    """Return the thing that has most of the weight of each row in masks that show mostly it."""
    number = {name: i for i, name in enumerate(place.evidence.masks.view_names)}
    views = [number[name] for name in seen.masks.view_names]
    owners = np.concatenate([place.owners[place.evidence.masks.views == view] for view in views])
    (known,) = np.nonzero(owners >= 0)
    of_thing = csr_array((np.ones(len(known)), (known, owners[known])), shape=(len(owners), int(owners.max()) + 1))
    votes = (seen.weights @ of_thing).toarray()
    return np.where(votes.any(1), votes.argmax(1), -1)


def row(given: str, way: str, place: Place, points: str, clip: Clip, draws: Draws) -> str:
    evidence = place.evidence_of(np.ones((len(place.owners), 1), np.float32))
    crops = len(evidence.masks) if place.crops is None else len(place.crops.chosen)
    name = Path(given.partition("=")[0]).resolve().name
    of_nodes, by_masks = fits(place, evidence)
    counts = f"{len(evidence.masks.view_names)} | {points} | {crops} | {of_nodes:.3f} | {by_masks:.3f}"
    return f"| {name}: {way} | {counts} | {_of_words(place, clip, draws)} |"


def _of_words(place: Place, clip: Clip, draws: Draws) -> str:
    """Return the columns of words."""
    if not draws.seeds:
        return "- | - | - | -"
    seeds = [(share / 100, seed) for share in draws.wrong for seed in range(draws.seeds)]
    record = record_of(trial(place, clip, "rough", share, seed) for share, seed in seeds)
    means = " | ".join(_interval(record[name]) for name in ("plain", "objects"))
    return f"{means} | {record['missed']['objects']:.0%} | {record['found']['objects']:.0%}"


def _interval(values: list[float]) -> str:
    return f"{np.mean(values):.3f} ± {1.96 * np.std(values) / np.sqrt(len(values)):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--shares", type=float, nargs="*", default=[])
    arguments = parser.parse_args()
    clip, draws = Clip(arguments.clip), Draws((WRONG,), arguments.seeds)
    columns = "photos | points | crops | objects fit | masks fit | plain | objects | missed | absent found"
    print(f"| place: masks, way | {columns} |\n" + "|---" * 10 + "|")
    for given in arguments.places:
        kinds = ("sam", "graph") if kind_of(given) == CAPTURE else tuple(SETTINGS)
        points = {kind: points_of(given, kind) for kind in kinds}
        for way, place in ways(given, arguments.kept, arguments.shares):
            print(row(given, way, place, points[way.partition(",")[0]], clip, draws), flush=True)


if __name__ == "__main__":
    main()
