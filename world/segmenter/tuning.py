"""Learn the rule of `graph`: python -m world.segmenter.tuning SCENE... --output rule.safetensors

The rule merges the photos of made scenes; every pair that it meets on the way, with whether both regions show the same
thing, is learned from together with all pairs of earlier rounds. The threshold is then the one of the best mean IoU. A
rule that trusts the network alone is worse on photos that are unlike the made ones: --blind learns one from colours and
shapes, and --beside takes the mean of what a rule says and the learned one.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64
from safetensors.numpy import save_file

from drsplat.kernels.photo_regions import AREA, RegionGraph, lab_colors, region_graph
from drsplat.photos.models.graph.segmenter import (
    GraphSettings,
    MergeRule,
    Tensors,
    look,
    merged,
    read_rule,
    shipped_network,
    small_regions,
    working_image,
)

from .network import both, first_rule, learn_rule, padded
from .scenes import Photo, photos, with_smaller
from .scores import score, shared_pixels

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests/support"))

from twins.photo_features import OF_NETWORK
from twins.photo_merging import Likelihood, Merging, likelihood

KEPT = 0.06  # of the pairs that are met whose smaller region has USUAL_AREA pixels
USUAL_AREA, MOST_AREA = 300, 5000
STEPS = 150
LAST = 0.2  # likelihood at which walks end
THRESHOLDS = (0.3, 0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8)


@dataclass(frozen=True, eq=False)
class Case:
    """A photo's regions. shown: pixels of each region that show each thing."""

    photo: Photo
    graph: RegionGraph
    shown: Int64[np.ndarray, "n k"]


def case(photo: Photo, network: Tensors) -> Case:
    image = working_image(photo.image)
    lab = lab_colors(image)
    labels = small_regions(lab)
    shown = shared_pixels(labels, photo.truth, len(photo.is_object))
    return Case(photo, region_graph(labels, lab, look(image, network)), shown)


class Watched(Merging):
    """Notes pairs that are scored, whether they belong together, and how much that matters."""

    def __init__(self, case: Case, likelihood: Likelihood, rng: np.random.Generator) -> None:
        self.shown, self._objects, self._rng = case.shown.copy(), case.photo.is_object, rng
        self.features_met: list[np.ndarray] = []
        self.together: list[np.ndarray] = []
        self.weights: list[np.ndarray] = []
        super().__init__(case.graph, likelihood)

    def _features(self, ends: np.ndarray, rows: np.ndarray) -> np.ndarray:
        found = super()._features(ends, rows)
        self._note(ends, found)
        return found

    def _note(self, ends: np.ndarray, found: np.ndarray) -> None:
        """Larger regions are noted more often, because more pixels depend on them."""
        smaller = np.minimum(self.sums[ends, AREA].min(0), MOST_AREA)
        kept = self._rng.random(len(found)) < KEPT * np.sqrt(smaller / USUAL_AREA)
        main_a, main_b = self.shown[ends[:, kept]].argmax(-1)
        self.features_met.append(found[kept])
        self.together.append(main_a == main_b)
        self.weights.append(np.where(self._objects[main_a] | self._objects[main_b], 1.0, 0.4))

    def _union(self, a: int, b: int) -> None:
        self.shown[a] += self.shown[b]
        self.shown[b] = 0
        super()._union(a, b)


def by_color(features: Float64[np.ndarray, "e f"]) -> Float64[np.ndarray, " e"]:
    """The rule to begin with."""
    return np.exp(-(features[:, 0] ** 2 + features[:, 6] ** 2) / 20)


def mean_score(cases: Sequence[Case], rule: MergeRule) -> Float64[np.ndarray, " 4"]:
    """Mean IoU of things, of structures, masks per photo, purity, over all photos."""
    found = []
    for one in cases:
        owner = merged(one.graph, rule, GraphSettings())
        shown = np.zeros((owner.max() + 1, one.shown.shape[1]), np.int64)
        np.add.at(shown, owner, one.shown)
        found.append(score(shown, one.photo.is_object))
    best = np.concatenate([s.best for s in found])
    objects = np.concatenate([s.is_object for s in found])
    others = [np.mean([s.masks for s in found]), np.mean([s.purity for s in found])]
    return np.array([best[objects].mean(), best[~objects].mean(), *others])


def learned(
    cases: Sequence[Case],
    held_out: Sequence[Case],
    rounds: int,
    hidden: int,
    *,
    steps: int = STEPS,
    blind: bool = False,
) -> MergeRule:
    """blind: what the network sees is left out."""
    met: list[tuple[np.ndarray, ...]] = []
    own: MergeRule | None = None
    judge: Likelihood = by_color
    for turn in range(rounds):
        start = time.monotonic()
        met += [pairs_met(one, judge, np.random.default_rng(1000 * turn + i)) for i, one in enumerate(cases)]
        features, together, weights = map(np.concatenate, zip(*met, strict=True))
        known = features[:, :-OF_NETWORK] if blind else features
        own = learn_rule(own or first_rule(known, hidden), known, together, weights, steps)
        rule = padded(own, features.shape[1])
        judge = partial(likelihood, rule)
        scores = [np.round(mean_score(some, rule), 3) for some in (cases[::8], held_out)]
        print(f"round {turn}: {len(features)} pairs, {time.monotonic() - start:.0f} s", *scores, flush=True)
    return rule


def pairs_met(case: Case, likelihood: Likelihood, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Features, whether they belong together, and weights of pairs met until most is wrong."""
    watched = Watched(case, likelihood, rng)
    watched.merge_above(LAST)
    return tuple(map(np.concatenate, (watched.features_met, watched.together, watched.weights)))


def best_threshold(cases: Sequence[Case], rule: MergeRule) -> MergeRule:
    tried = [replace(rule, threshold=np.array([t])) for t in THRESHOLDS]
    scores = [mean_score(cases, r) for r in tried]
    for t, s in zip(THRESHOLDS, scores, strict=True):
        print(f"threshold {t}:", np.round(s, 3), flush=True)
    return tried[int(np.argmax([s[0] for s in scores]))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    parser.add_argument("--held-out", type=Path, nargs="+", required=True, metavar="SCENE", help="for the threshold")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--hidden", type=int, default=32)
    parser.add_argument("--each", type=int, default=1, metavar="N", help="every Nth photo (default: 1)")
    parser.add_argument("--blind", action="store_true", help="without what the network sees")
    parser.add_argument("--beside", type=Path, metavar="RULE", help="a rule that has as much to say as the learned one")
    arguments = parser.parse_args()
    network, _ = shipped_network()
    cases, held_out = (
        [case(photo, network) for photo in with_smaller(photos(scenes, arguments.each))]
        for scenes in (arguments.scenes, arguments.held_out)
    )
    rule = learned(cases, held_out, arguments.rounds, arguments.hidden, blind=arguments.blind)
    if arguments.beside:
        rule = both(read_rule(arguments.beside.read_bytes()), rule)
    save_rule(best_threshold(held_out, rule), arguments.output)


def save_rule(rule: MergeRule, path: Path) -> None:
    """As `drsplat.photos.models.graph.segmenter.shipped_rule` reads it."""
    save_file({name: array.astype(np.float32) for name, array in vars(rule).items()}, path)


if __name__ == "__main__":
    main()
