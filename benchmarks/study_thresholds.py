"""One fixed threshold beside thresholds chosen for each query, by mIoU over Gaussians whose truth is known.

    python -m world.depth_scenes rooms/train_* --output scenes --encoder simulated-clip
    python benchmarks/study_thresholds.py scenes/* [--json OUT.json]
    python benchmarks/study_thresholds.py --furnished FOLDER     (makes `world.furnished` there)

A scene is a folder with scene.field, labels.npy (N integers: of each Gaussian the id of its thing, -1 for
unknown) and things.json (list of id, name, color; things without colour are structures). Queries: names of
things, "color name", structures, names of things that are not there, things in a colour that they do not
have, and clicks (the feature of a Gaussian of each thing). IoU is over Gaussians; fewer than 40 selected
count as none; where nothing is meant, none scores 1 and any other answer 0.

"tuned" is the best on the very queries that it is scored on, as papers report it; "held out" is tuned on
all other scenes. Confidence intervals are over scenes, 95 %, by bootstrap.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from world.simulated_clip import SimulatedClip

from drsplat import LanguageField, MiniEncoder, WordEncoder, load_field
from drsplat.errors import InputError
from drsplat.mini.lexicon import COLORS, NAMES
from drsplat.search import ABSENT, NEGATIVES, null_rises
from drsplat.thresholds import (
    automatic_threshold,
    mixture_threshold,
    otsu_threshold,
    threshold_above,
)

LEAST = 40  # Gaussians: fewer are specks
GRID = np.linspace(-0.2, 1, 121)
ENCODERS = {
    "simulated-clip": SimulatedClip,
    "drsplat-mini": MiniEncoder,
    "drsplat-words": WordEncoder,
}
FOUND, NOT_FOUND = ("name", "category", "structure"), ("absent", "wrong colour")


@dataclass(frozen=True)
class Query:
    """text, or the row of the field that is clicked. ids: of the things meant."""

    group: str
    text: str | int
    ids: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Curve:
    """IoU at any threshold, from the scores and the truth sorted once."""

    ordered: np.ndarray  # descending
    hits: np.ndarray
    wanted: int

    @classmethod
    def of(cls, scores: np.ndarray, truth: np.ndarray) -> "Curve":
        order = np.argsort(-scores, kind="stable")
        return cls(scores[order], np.cumsum(truth[order]), int(truth.sum()))

    def iou(self, threshold: float) -> float:
        count = int(np.searchsorted(-self.ordered, -threshold))
        if count < LEAST:
            return float(self.wanted == 0)
        hits = int(self.hits[count - 1])
        return hits / (count + self.wanted - hits)

    def best(self) -> float:
        if self.wanted == 0:
            return 1.0
        sizes = np.arange(1, len(self.hits) + 1)
        return float((self.hits / (sizes + self.wanted - self.hits)).max())


def queries_of(things: list[dict[str, Any]], seed: int = 0) -> list[Query]:
    """All names and categories, and ten of each kind that nothing answers."""
    rng, objects = np.random.default_rng(seed), [thing for thing in things if thing["color"]]
    meant: dict[tuple[str, str], list[int]] = defaultdict(list)
    for thing in things:
        meant["name" if thing["color"] else "structure", thing["name"]].append(thing["id"])
    for thing in objects:
        if thing["color"] != thing["name"]:
            meant["category", f"{thing['color']} {thing['name']}"].append(thing["id"])
    present = {thing["name"] for thing in objects}
    colored = {text for group, text in meant if group == "category"}
    wrong = sorted(
        {f"{color} {name}" for name in present - set(COLORS) for color in COLORS} - colored
    )
    absent = sorted(set(NAMES) - present)
    none = [("absent", text) for text in rng.permutation(absent)[:10]]
    none += [("wrong colour", text) for text in rng.permutation(wrong)[:10]]
    asked = [Query(group, text, tuple(ids)) for (group, text), ids in sorted(meant.items())]
    return asked + [Query(group, str(text), ()) for group, text in none]


def clicks_of(things: list[dict[str, Any]], labels: np.ndarray, seed: int = 0) -> list[Query]:
    """A random Gaussian of each thing."""
    rng, clicks = np.random.default_rng(seed), []
    for thing in things:
        rows = np.flatnonzero(labels == thing["id"])
        if thing["color"] and len(rows) >= LEAST:
            clicks.append(Query("click", int(rng.choice(rows)), (thing["id"],)))
    return clicks


@dataclass(frozen=True, eq=False)
class Scored:
    """One query's IoU by rule, and over GRID for cosine and relevancy margin."""

    group: str
    ious: dict[str, float]
    by_cosine: np.ndarray
    by_margin: np.ndarray


def score(
    field: LanguageField, encoder: Any, query: Query, labels: np.ndarray, nulls: dict[str, Any]
) -> Scored:
    """nulls: what is the same for all queries of the field."""
    click = isinstance(query.text, int)
    vector = (
        field.feature(np.array([query.text]))[0] if click else encoder.encode_texts([query.text])[0]
    )
    cosines, truth = field.scores(vector), np.isin(labels, query.ids)
    cosine, margin = Curve.of(cosines, truth), Curve.of(cosines - nulls["negatives"], truth)
    rises = None if click else nulls["rises"]
    nothing = float(cosines.max())
    there = automatic_threshold(cosines, rises) < nothing
    otsu, mixture = otsu_threshold(cosines), mixture_threshold(cosines)
    ious = {
        "fixed: default": cosine.iou(getattr(encoder, "threshold", 0.5)),
        "relevancy 0.5": margin.iou(0.0),
        "Otsu": cosine.iou(otsu),
        "mixture of two": cosine.iou(mixture),
        "Otsu, null": cosine.iou(otsu if there else nothing),
        "mixture, null": cosine.iou(mixture if there else nothing),
        "peak": cosine.iou(automatic_threshold(cosines)),
        "auto (peak, null)": cosine.iou(automatic_threshold(cosines, rises)),
        "own, raised": cosine.iou(threshold_above(cosines, getattr(encoder, "threshold", 0.5))),
        "auto, null of negatives": cosine.iou(
            automatic_threshold(cosines, None if click else nulls["negative rises"])
        ),
        "oracle per query": cosine.best(),
    }  # fmt: skip
    return Scored(
        query.group, ious, *(np.array([c.iou(t) for t in GRID]) for c in (cosine, margin))
    )


def null_of(field: LanguageField, encoder: Any) -> dict[str, Any]:
    of_negatives = null_rises(field, encoder, NEGATIVES)
    try:
        rises = null_rises(field, encoder, ABSENT)
    except InputError:  # knows few words
        rises = of_negatives
    negatives = field.score_negatives(encoder.encode_texts(NEGATIVES)).maxima
    return {"negatives": negatives, "rises": rises, "negative rises": of_negatives}


def scored_scene(folder: Path) -> list[Scored]:
    field = load_field(folder / "scene.field")
    things = json.loads((folder / "things.json").read_text())
    labels = np.load(folder / "labels.npy", allow_pickle=False)[field.gaussian_ids]
    return scored_field(field, things, labels)


def scored_field(
    field: LanguageField, things: list[dict[str, Any]], labels: np.ndarray
) -> list[Scored]:
    encoder = ENCODERS[field.encoder.name]()
    nulls, found = null_of(field, encoder), []
    for query in (*queries_of(things), *clicks_of(things, labels)):
        try:
            found.append(score(field, encoder, query, labels, nulls))
        except InputError:  # a word that the encoder was not taught
            continue
    return found


def scored_furnished(folder: Path) -> list[Scored]:
    """The furnished room; the floor, the walls, the window and the rug are its structures."""
    from world.furnished.story import tell

    room = tell(folder).room
    field, things = load_field(folder / "room.field"), []
    for index, full in enumerate(room.names):
        *first, name = full.split()
        still = name in ("floor", "wall", "window", "rug")
        things.append(
            {
                "id": index,
                "name": full if still else name,
                "color": "" if still else " ".join(first) or name,
            }
        )
    return scored_field(field, things, room.labels[field.gaussian_ids])


WORDS = (
    "name",
    "category",
    "structure",
    "absent",
)  # a fixed threshold is tuned for their mean; for clicks apart


def with_fixed(scenes: list[list[Scored]]) -> None:
    """Add the fixed thresholds, tuned on these queries and on those of the other scenes."""
    for name, curves in (("cosine", "by_cosine"), ("relevancy", "by_margin")):
        for groups in (WORDS, ("click",)):
            means = np.array([_objective(scene, curves, groups) for scene in scenes])
            tuned = int(means.mean(0).argmax())
            for index, scene in enumerate(scenes):
                others = np.delete(means, index, 0)
                held_out = int(others.mean(0).argmax()) if len(others) else tuned
                for one in scene:
                    if (one.group == "click") is ("click" in groups):
                        one.ious[f"fixed {name}: tuned"] = float(getattr(one, curves)[tuned])
                        one.ious[f"fixed {name}: held out"] = float(getattr(one, curves)[held_out])


def _objective(scene: list[Scored], curves: str, groups: tuple[str, ...]) -> np.ndarray:
    """Over GRID the mean of the groups' means."""
    of_group = defaultdict(list)
    for one in scene:
        if one.group in groups:
            of_group[one.group].append(getattr(one, curves))
    return np.mean([np.mean(group, 0) for group in of_group.values()], 0)


def table(scenes: list[list[Scored]]) -> dict[str, dict[str, list[float]]]:
    """rule -> group -> mean over scenes, and the ends of its interval."""
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(scenes), (2000, len(scenes)))
    result: dict[str, dict[str, list[float]]] = {}
    for rule in scenes[0][0].ious:
        result[rule] = {}
        for group in (*FOUND, *NOT_FOUND, "click"):
            means = [[one.ious[rule] for one in scene if one.group == group] for scene in scenes]
            values = np.array([np.mean(part) for part in means if part])
            if len(values):
                spread = values[draws % len(values)].mean(1)
                result[rule][group] = [float(values.mean()), *np.quantile(spread, (0.025, 0.975))]
    return result


def scenes_of(arguments: argparse.Namespace) -> Iterator[list[Scored]]:
    for folder in arguments.folders:
        yield scored_scene(folder)
    if arguments.furnished:
        yield scored_furnished(arguments.furnished)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--furnished", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    scenes = list(scenes_of(arguments))
    with_fixed(scenes)
    result = table(scenes)
    groups = list(next(iter(result.values())))
    print(
        f"{len(scenes)} scenes, {sum(map(len, scenes))} queries; mIoU, nothing found where nothing is meant"
    )
    print(f"{'rule':28}" + "".join(f"{group:>22}" for group in groups))
    for rule, cells in result.items():
        said = [f"{mean:.3f} ({low:.2f}-{high:.2f})" for mean, low, high in cells.values()]
        print(f"{rule:28}" + "".join(f"{cell:>22}" for cell in said))
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
