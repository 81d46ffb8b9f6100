"""Words for the things of a place: genuine CLIP vectors drawn for them.

The published codebook of an encoder has genuine centroids of pictures, and there are text vectors of the same space. A
trial gives words to 4 to 12 things of a place, the largest among them in every second trial, and to its other things
the same words again, or nothing that has a name. A mask's embedding is one of the centroids that fit its word better
than the other words, moved as far as residual codes do ("clean": the best centroid, cosine 0.98 with it; "rough": one
of three, 0.94). Of a share of the masks it is another thing's or any centroid. Words that were given to nothing are
absent.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from benchmarks.drawn_embeddings import unit
from drsplat import EncoderIdentity, Gaussians, LanguageField, Scene
from drsplat.codes import read_faiss_codebook
from drsplat.codes.code import Code
from drsplat.encoders import Encoder
from drsplat.evidence.evidence import Evidence
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.objects.finding import find_objects

from .places import Place

NEGATIVES = ("object", "things", "stuff", "texture")
KINDS = {"clean": (1, 0.5, 0.004), "rough": (3, 1.0, -0.004)}  # centroids, noise, least margin
LEAST = 120  # Gaussians of what is asked for


class Clip:
    """words: plain nouns; texts, negatives: their vectors; centroids: of pictures.

    folder: the published codebook (pq_index.faiss) and text vectors of its encoder (text_vectors.json).
    """

    def __init__(self, folder: Path) -> None:
        book = read_faiss_codebook(folder / "pq_index.faiss", EncoderIdentity("published", 512))
        assert book.coarse is not None
        self.centroids = unit(book.coarse[np.linalg.norm(book.coarse, axis=1) > 0.5])
        self.codes = book.centroids - book.centroids.mean(1, keepdims=True)
        known = json.loads((folder / "text_vectors.json").read_text())
        self.words = [word for word in known if word not in NEGATIVES]
        self.texts = unit(np.array([known[word] for word in self.words]))
        self.negatives = unit(np.array([known[word] for word in NEGATIVES]))
        scores = self.centroids @ self.texts.T
        best = [np.delete(scores, word, 1).max(1) for word in range(len(self.words))]
        self.margins = scores - np.stack(best, 1)

    @cached_property
    def encoder(self) -> VocabularyEncoder:
        return VocabularyEncoder(EncoderIdentity("published", 512), self.words, self.texts)

    def noise(self, rng: np.random.Generator, count: int) -> np.ndarray:
        parts = self.codes.shape[0]
        return self.codes[np.arange(parts), rng.integers(0, 256, (count, parts))].reshape(count, -1)


@dataclass(frozen=True, eq=False)
class Means(Code):
    """The mean embedding of each row as it is, without a code: as much of one as a query needs."""

    rows: Float32[np.ndarray, "r D"]
    kind = "exact"

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def dim(self) -> int:
        return self.rows.shape[1]

    def scores(self, queries: np.ndarray, *, threads: int = 0) -> np.ndarray:
        return np.asarray(queries @ self.rows.T)

    def decode(self, rows: np.ndarray) -> np.ndarray:
        return self.rows[rows]


@dataclass(frozen=True, eq=False)
class Trial:
    """present: by text, which rows of the field it means. mass: of each row in the score. absent: texts."""

    name: str
    field: LanguageField
    gaussians: Gaussians
    encoder: Encoder
    present: Mapping[str, Bool[np.ndarray, " r"]]
    absent: list[str]
    mass: Float64[np.ndarray, " r"]

    def scene(self, objects: bool) -> Scene:
        field = self.field if objects else replace(self.field, objects=None)
        return Scene(field, self.gaussians, encoder=self.encoder)

    def iou(self, selected: Bool[np.ndarray, " r"], meant: Bool[np.ndarray, " r"]) -> float:
        either = self.mass[selected | meant].sum()
        return float(self.mass[selected & meant].sum() / either) if either else 0.0


def trial(place: Place, clip: Clip, kind: str, wrong: float, seed: int, words: range) -> Trial:
    """words: of the list, those that things may be called by."""
    rng, (count, noise, least) = np.random.default_rng(seed), KINDS[kind]
    good = rng.permutation([word for word in words if clip.margins[:, word].max() > least])
    names = list(rng.permutation(sorted(place.things)))
    names.sort(key=lambda name: -np.isin(place.labels, place.things[name]).sum() if seed % 2 else 0)
    named = min(int(rng.integers(4, 13)), len(good) - 2, len(names))
    meaning: dict[int, int] = {}
    pictures: dict[int, np.ndarray] = {}
    for number, name in enumerate(names):
        word = int(good[number if number < named else rng.integers(0, named)])
        nameless = number >= named and rng.random() < 0.25 * (seed % 2)
        centroids = np.argsort(-clip.margins[:, word])[:count]
        for thing in place.things[name]:
            meaning[thing] = -1 if nameless else word
            pictures[thing] = rng.integers(0, len(clip.centroids), 1) if nameless else centroids
    for thing in place.nameless:
        pictures[thing] = rng.choice(_like_nothing(clip, [int(word) for word in good[:named]]), 1)
    anything = rng.integers(0, len(clip.centroids), len(place.owners))
    others = rng.choice(np.concatenate(list(pictures.values())), len(place.owners))
    chosen = np.array([rng.choice(pictures[o]) if o in pictures else anything[k] for k, o in enumerate(place.owners)])
    swapped = np.where(rng.random(len(chosen)) < 0.5, others, anything)
    chosen = np.where(rng.random(len(chosen)) < wrong, swapped, chosen)
    evidence = replace(place.evidence, embeddings=unit(clip.centroids[chosen] + noise * clip.noise(rng, len(chosen))))
    field = field_of(evidence, place.gaussians, clip.encoder.identity)
    labels = place.labels[field.gaussian_ids]
    truth = np.array([meaning.get(label, -1) for label in labels.tolist()])
    mass = place.mass[field.gaussian_ids]
    given = sorted(set(meaning.values()) - {-1})
    present = {clip.words[word]: truth == word for word in given if ((truth == word) & (mass > 0)).sum() >= LEAST}
    absent = [clip.words[word] for word in words if word not in given]
    name = f"{place.name}, {kind}, {wrong:.0%} wrong, {seed}"
    return Trial(name, field, place.gaussians, clip.encoder, present, absent, mass)


def field_of(evidence: Evidence, gaussians: Gaussians, encoder: EncoderIdentity) -> LanguageField:
    """With objects, its features as they are."""
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    seen = evidence.rows(ids)
    rows = np.concatenate([unit(seen.weights[at : at + 8192] @ seen.embeddings) for at in range(0, len(ids), 8192)])
    scene = gaussians.fingerprint
    field = LanguageField(ids.astype(np.uint32), Means(rows), encoder, scene, len(gaussians), seen)  # type: ignore[abstract]
    return replace(field, objects=find_objects(field, gaussians))


def _like_nothing(clip: Clip, words: list[int]) -> Int32[np.ndarray, " c"]:
    """The centroids that fit some words least: half of all."""
    best = (clip.centroids @ clip.texts[words].T).max(1)
    return np.argsort(best)[: len(best) // 2].astype(np.int32)
