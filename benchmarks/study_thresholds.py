"""Which rule cuts the answers of CLIP-like encoders: genuine text vectors against genuine image-side centroids.

    python benchmarks/study_thresholds.py SCENE... --clip FOLDER [--aggregators mean trusted] [--json OUT.json]

SCENE: packed rooms of world/scenes. FOLDER: the published codebook (pq_index.faiss) and text vectors of its
encoder (text_vectors.json); neither is part of the project, and without them nothing can be said.

Masks are those of the segmenter `graph`, each of the thing that most of its pixels show. A trial gives
words to 4 to 12 things of a room, the largest among them, and to the other things the same words again or
nothing that has a name. A mask's embedding is one of the centroids that fit its word better than the other
words, moved as far as residual codes do ("clean": the best centroid, cosine 0.98 with it; "rough": one of three,
0.94). Of 0, 20 and 40 % of the masks it is another thing's or any centroid. Words that were given to
nothing are absent; all 40 are the list. IoU is over Gaussians, by the weight that the photos give them; an
absent word is found where 40 Gaussians of 50,000 are selected. --words first|second|all: which of
them things are called and are asked for. The numbers of the rule were chosen with all of them, on four other rooms.
"""

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.aggregators import MEASURED
from benchmarks.suite.masks import MASKS
from benchmarks.suite.scenes import BenchScene, read_scene
from benchmarks.suite.vocabularies import KINDS, Clip, unit
from drsplat import Gaussians, ViewFeatures, load_image, register
from drsplat.field.evidence.evidence import Evidence
from drsplat.query.contrast import CLEAR_MARGIN, SURE, Contrast, _contrast, certainty_of, own_level, relevancy_threshold
from drsplat.query.thresholds import PEAK_ROWS, automatic_threshold
from drsplat.scene.masks.masks import LEVELS
from drsplat.scene.masks.selection import mask_maps

ROWS, OF = 12_000, 50_000  # Gaussians looked at, and of a scene
PEAK_HERE = round(PEAK_ROWS * ROWS / OF)
WRONG = (0.0, 0.2, 0.4)


@dataclass(frozen=True, eq=False)
class Room:
    """evidence: of masks of no meaning; owners: the thing of each mask. labels, mass: per Gaussian."""

    gaussians: Gaussians
    evidence: Evidence
    owners: np.ndarray
    labels: np.ndarray
    mass: np.ndarray
    things: dict[str, list[int]]


def registered(scene: BenchScene, kind: str) -> tuple[Evidence, np.ndarray]:
    features, owners = {}, []
    for view in sorted(scene.views, key=lambda view: view.name):
        maps = mask_maps(MASKS[kind](scene, view, load_image(view)))
        ids, truth = maps.mask_ids[LEVELS.index("large")], scene.ids(view)
        embeddings = np.eye(1, 4, dtype=np.float32).repeat(len(maps.masks), 0)
        features[view.name] = ViewFeatures(ids, embeddings)
        for number in range(len(maps.masks)):
            seen = np.bincount(truth[ids == number] + 1, minlength=1)
            owners.append(int(seen.argmax()) - 1)
    return register(scene.gaussians, scene.views, features).evidence, np.array(owners)


def true_things(scene: BenchScene) -> tuple[np.ndarray, np.ndarray]:
    """Per Gaussian the number of its thing, -1 for none, and the weight that photos give it."""
    exact, own = registered(scene, "true")
    known = np.flatnonzero(own >= 0)
    of_thing = csr_array((np.ones(len(known), np.float32), (known, own[known])), shape=(len(own), own.max() + 1))
    votes = (exact.weights @ of_thing).toarray()
    return np.where(votes.any(1), votes.argmax(1), -1), votes.sum(1)


def room_of(folder: Path) -> Room:
    scene = read_scene(folder)
    truth = json.loads((folder / "truth.json").read_text())
    labels, mass = true_things(scene)
    count = len(labels)
    rows = np.sort(np.random.default_rng(5).choice(count, min(ROWS, count), replace=False))
    evidence, owners = registered(scene, "graph")
    things: dict[str, list[int]] = defaultdict(list)
    for thing in (*truth["objects"], *truth["structures"]):
        things[thing["name"]].append(thing["id"])
    few = scene.gaussians.subset(rows)
    return Room(few, evidence.rows(rows), owners, labels[rows], mass[rows], things)


@dataclass(frozen=True, eq=False)
class Features:
    """As much of a field as a list of words is scored on."""

    rows: np.ndarray
    evidence: Evidence

    def __len__(self) -> int:
        return len(self.rows)

    def scores(self, queries: np.ndarray, threads: int = 0) -> np.ndarray:
        return queries @ self.rows.T


@dataclass(frozen=True, eq=False)
class Trial:
    features: Features
    truth: np.ndarray  # per row a word, -1 for what has no name
    mass: np.ndarray
    present: list[int]
    absent: list[int]


class Trying(NamedTuple):
    """What trials have in common. how: an aggregator; kind: of KINDS; words: that things may be called."""

    room: Room
    clip: Clip
    how: str
    kind: str
    words: range


def trial(trying: Trying, wrong: float, seed: int) -> Trial:
    room, clip, how, kind, words = trying
    rng, (count, noise, least) = np.random.default_rng(seed), KINDS[kind]
    good = rng.permutation([word for word in words if clip.margins[:, word].max() > least])
    names = list(rng.permutation(sorted(room.things)))
    names.sort(key=lambda name: -np.isin(room.labels, room.things[name]).sum() if seed % 2 else 0)
    named = min(int(rng.integers(4, 13)), len(good) - 2, len(names))
    meaning: dict[int, int] = {}
    pictures: dict[int, np.ndarray] = {}
    for number, name in enumerate(names):
        word = int(good[number if number < named else rng.integers(0, named)])
        nameless = number >= named and rng.random() < 0.25 * (seed % 2)
        centroids = np.argsort(-clip.margins[:, word])[:count]
        for thing in room.things[name]:
            meaning[thing] = -1 if nameless else word
            pictures[thing] = rng.integers(0, len(clip.centroids), 1) if nameless else centroids
    anything = rng.integers(0, len(clip.centroids), len(room.owners))
    others = rng.choice(np.concatenate(list(pictures.values())), len(room.owners))
    chosen = np.array([rng.choice(pictures[o]) if o in pictures else anything[k] for k, o in enumerate(room.owners)])
    chosen = np.where(
        rng.random(len(chosen)) < wrong, np.where(rng.random(len(chosen)) < 0.5, others, anything), chosen
    )
    moved = clip.centroids[chosen] + noise * clip.noise(rng, len(chosen))
    evidence = replace(room.evidence, embeddings=unit(moved))
    made = MEASURED[how](evidence, room.gaussians)
    rows = made.features(0, len(evidence))
    known = np.flatnonzero(rows.any(1))
    truth = np.array([meaning.get(label, -1) for label in room.labels])[known]
    given = set(meaning.values()) - {-1}
    present = [word for word in sorted(given) if (truth == word).sum() >= 3 * PEAK_HERE]
    absent = [word for word in words if word not in given]
    return Trial(Features(rows[known], evidence), truth, room.mass[known], present, absent)


def selections(case: Trial, clip: Clip, known: Contrast, word: int) -> Iterator[tuple[str, np.ndarray]]:
    """By rule, which rows it selects."""
    query, texts = clip.texts[word], clip.texts
    cosines = case.features.scores(query)
    negatives = case.features.scores(clip.negatives).max(0)
    others = case.features.scores(np.delete(texts, word, 0))
    yield "cosine 0.5", cosines > 0.5
    yield "relevancy 0.5", cosines > negatives
    yield "relevancy 0.6", cosines > negatives + np.log(1.5) / 10
    yield "0.6 of the peak", cosines > automatic_threshold(cosines, peak=PEAK_HERE)
    yield "best of the list", cosines > others.max(0)
    yield "z > 2 over the list", cosines > others.mean(0) + 2 * others.std(0)
    values = known.relevancy(query, cosines)
    assert values is not None
    yield "list, levels halved", values > 0.5
    yield "list, a clear peak", values > relevancy_threshold(values, PEAK_HERE)
    sure = certainty_of(values, PEAK_HERE, CLEAR_MARGIN) == SURE
    yield "the rule", sure & (values > own_level(values, PEAK_HERE))


Results = dict[str, dict[str, list[float]]]


def study(trying: Trying, seeds: int) -> dict[str, Results]:
    clip = trying.clip
    found: dict[str, Results] = {}
    for wrong in WRONG:
        results: Results = defaultdict(lambda: defaultdict(list))
        for seed in range(seeds):
            case = trial(trying, wrong, seed)
            known = _contrast(case.features, clip.texts, 0)  # type: ignore[arg-type]
            for word in (*case.present, *case.absent):
                meant = case.truth == word
                for rule, selected in selections(case, clip, known, word):
                    enough = selected.sum() >= PEAK_HERE
                    if word in case.absent:
                        results[rule]["found"].append(float(enough))
                        continue
                    either = case.mass[selected | meant].sum()
                    iou = case.mass[selected & meant].sum() / either if enough else 0.0
                    results[rule]["iou"].append(float(iou))
        found[f"{wrong:.0%}"] = results
    return found


def interval(values: list[float]) -> tuple[float, float]:
    """Mean, and half of a 95 % interval over queries."""
    return float(np.mean(values)), float(1.96 * np.std(values) / np.sqrt(len(values)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--clip", type=Path, required=True)
    parser.add_argument("--aggregators", nargs="+", choices=MEASURED, default=["mean"])
    parser.add_argument("--words", choices=("first", "second", "all"), default="second")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if not (arguments.clip / "text_vectors.json").is_file():
        sys.exit(f"{arguments.clip}: no text_vectors.json and pq_index.faiss there: nothing is studied")
    clip, rooms = Clip(arguments.clip), [room_of(folder) for folder in arguments.scenes]
    chosen = {"first": (0, 2), "second": (1, 2), "all": (0, 1)}[arguments.words]
    words = range(chosen[0], len(clip.words), chosen[1])
    document: dict[str, Any] = {}
    for how in arguments.aggregators:
        for kind in KINDS:
            parts = [study(Trying(room, clip, how, kind, words), arguments.seeds) for room in rooms]
            document[f"{how}, {kind}"] = table(f"{how}, {kind}", parts)
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1))


def table(title: str, parts: list[dict[str, Results]]) -> dict[str, Any]:
    """Print and return IoU and share of absent words found, by rule and share of wrong masks."""
    shares = [*parts[0], "mean"]
    print(f"\n| {title} | " + " | ".join(f"{share} wrong" for share in shares) + " |")
    print("|---" * (len(shares) + 1) + "|")
    document: dict[str, Any] = {}
    for rule in next(iter(parts[0].values())):
        cells = {}
        for share in shares:
            picked = [p[s][rule] for p in parts for s in (p if share == "mean" else [share])]
            measures = ("iou", "found")
            cells[share] = {m: interval([v for one in picked for v in one[m]]) for m in measures}
        said = (f"{c['iou'][0]:.3f} ± {c['iou'][1]:.3f}, {c['found'][0]:.0%}" for c in cells.values())
        print(f"| {rule} | " + " | ".join(said) + " |", flush=True)
        document[rule] = cells
    return document


if __name__ == "__main__":
    main()
