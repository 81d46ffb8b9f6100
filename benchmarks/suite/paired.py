"""The same words of the same draws asked in several ways of looking at a place: what differs is the way alone.

Where `trials` finds objects with the embeddings of each draw, here masks alone say what belongs together, once for a
way, and one in five Gaussians is asked. A draw is so cheap that hundreds of them tell ways apart.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int64

from benchmarks.drawn_embeddings import unit
from drsplat import EncoderIdentity, LanguageField
from drsplat.field.evidence.evidence import Evidence
from drsplat.field.forest import Objects
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from drsplat.field.objects.finding import find_tree
from drsplat.query.defaults import MIN_GAUSSIANS

from .places import Place
from .trials import LEAST, Means, trial
from .vocabularies import Vocabulary

EVERY = 5
"""One Gaussian in so many is asked."""


class Asked(NamedTuple):
    """IoU of a word that something is called by, and whether it finds nothing."""

    iou: float
    missed: bool


class Answers(NamedTuple):
    """By seed and word: what was asked of things that are there, and whether absent words find something."""

    present: Mapping[tuple[int, str], Asked]
    absent: Mapping[tuple[int, str], bool]


@dataclass(frozen=True, eq=False)
class Way:
    """A place as it is looked at. seen: the evidence of the Gaussians that photos show, ids."""

    place: Place
    seen: Evidence
    ids: Int64[np.ndarray, " r"]
    tree: Tree

    def answers(self, words: Vocabulary, wrong: float, seeds: Iterable[int]) -> Answers:
        """Ask the words of a trial for each seed. wrong: share of the masks."""
        present, absent = {}, {}
        for seed in seeds:
            case = trial(self.place, words, "rough", wrong, seed, field_of=self._field, least=LEAST // EVERY)
            scene = case.scene(objects=True)
            for text, meant in case.present.items():
                answer = scene.ask(text)
                selected = answer.values > answer.threshold
                present[seed, text] = Asked(case.iou(selected, meant), not _finds(selected))
            for text in case.absent:
                answer = scene.ask(text)
                absent[seed, text] = _finds(answer.values > answer.threshold)
        return Answers(present, absent)

    def _field(self, place: Place, encoder: EncoderIdentity) -> LanguageField:
        """Return the field of some Gaussians with the embeddings of a draw."""
        rows = self._some(replace(self.seen, embeddings=place.evidence.embeddings))
        features = Means(unit(rows.weights @ rows.embeddings))  # type: ignore[abstract]
        scene = place.gaussians
        return LanguageField(
            self._some_ids, features, encoder, scene.fingerprint, len(scene), rows,
            objects=replace(self._objects, descriptors=np.empty((0, encoder.dim), np.float32)),
        )  # fmt: skip

    def _some(self, evidence: Evidence) -> Evidence:
        return evidence.rows(np.arange(0, len(self.ids), EVERY))

    @cached_property
    def _some_ids(self) -> np.ndarray:
        return self.ids[::EVERY].astype(np.uint32)

    @cached_property
    def _objects(self) -> Objects:
        """The objects without descriptors, which no answer in whole objects looks at."""
        scene = self.place.gaussians
        ones: Float32[np.ndarray, "r 1"] = np.ones((len(self.ids), 1), np.float32)
        identity = EncoderIdentity("none", 1)
        field = LanguageField(
            self.ids.astype(np.uint32),
            Means(ones),
            identity,
            scene.fingerprint,
            len(scene),
            self.seen,  # type: ignore[abstract]
        )
        objects = describe(field, scene, self.tree)
        nothing = np.zeros(objects.num_nodes + 1, np.int64)
        none = np.empty((0, 1), np.float32)
        return replace(objects, node_of=objects.node_of[::EVERY], descriptor_starts=nothing, descriptors=none)


def way_of(place: Place) -> Way:
    """Return a place whose objects are found."""
    evidence = place.evidence_of(np.ones((len(place.owners), 1), np.float32))
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    seen = evidence.rows(ids)
    return Way(place, seen, ids, find_tree(seen, place.gaussians, ids.astype(np.uint32), place.cameras))


def differences(some: Answers, others: Answers) -> np.ndarray:
    """Return by how much the IoU of each word differs that both were asked."""
    return np.array([some.present[key].iou - others.present[key].iou for key in others.present if key in some.present])


def interval(values: np.ndarray) -> float:
    """Return half of a 95 % interval of the mean."""
    return float(1.96 * np.std(values) / np.sqrt(max(len(values), 1)))


def _finds(selected: np.ndarray) -> bool:
    return bool(selected.sum() * EVERY >= MIN_GAUSSIANS)
