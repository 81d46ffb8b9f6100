"""Answers whose truth is known: the things of a place called by words, their masks given pictures of these.

A trial gives words of a vocabulary (`suite/vocabularies.py`) to 4 to 12 things of a place, the largest among them in
every second trial, and to its other things the same words again, or nothing that has a name: what has none shows a
picture that fits no word of the whole list. Of a share of the masks the picture is another thing's, or one that has
nothing to do with any. A word is absent if it was given to nothing, and no picture of a thing fits it best: what looks
like a desk to the encoder is rightly found as a desk, whatever the trial calls it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64

from benchmarks.drawn_embeddings import unit
from drsplat import EncoderIdentity, Gaussians, LanguageField, Scene
from drsplat.field.codes.code import Code
from drsplat.field.objects.finding import find_objects
from drsplat.scene.encoders import Encoder

from .places import Place
from .vocabularies import OF_NOTHING, Names, Pictures, Vocabulary

LEAST = 120  # Gaussians of what is asked for
MOST_ABSENT = 40  # words asked for in one trial


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


def field_of(place: Place, encoder: EncoderIdentity) -> LanguageField:
    """With objects, its features as they are."""
    evidence, gaussians = place.evidence, place.gaussians
    ids = np.flatnonzero(np.diff(evidence.weights.indptr))
    seen = evidence.rows(ids)
    rows = np.concatenate([unit(seen.weights[at : at + 8192] @ seen.embeddings) for at in range(0, len(ids), 8192)])
    scene = gaussians.fingerprint
    field = LanguageField(ids.astype(np.uint32), Means(rows), encoder, scene, len(gaussians), seen)  # type: ignore[abstract]
    return replace(field, objects=find_objects(field, gaussians, views=place.cameras))


def trial(
    place: Place,
    words: Vocabulary,
    kind: str,
    wrong: float,
    seed: int,
    field_of: Callable[[Place, EncoderIdentity], LanguageField] = field_of,
    least: int = LEAST,
) -> Trial:
    """Return a trial of half of the words: the first, third ... with an even seed, else the others.

    field_of: makes the field of a place with the drawn embeddings. least: rows of what is asked for.
    """
    rng = np.random.default_rng(seed)
    callable_words = range(seed % 2, len(words.words), 2)
    pictures = words.pictures(kind, callable_words, rng)
    good = rng.permutation(sorted(pictures.of_word))
    names = list(rng.permutation(sorted(place.things)))
    names.sort(key=lambda name: -np.isin(place.labels, place.things[name]).sum() if seed % 2 else 0)
    named = min(int(rng.integers(4, 13)), len(good) - 2, len(names))
    meaning: dict[int, int] = {}
    shown: dict[int, np.ndarray] = {}
    for number, name in enumerate(names):
        word = int(good[number if number < named else rng.integers(0, named)])
        nameless = number >= named and rng.random() < 0.25 * (seed % 2)
        for thing in place.things[name]:
            meaning[thing] = -1 if nameless else word
            shown[thing] = rng.choice(pictures.of_nothing, 1) if nameless else pictures.of_word[word]
    for thing in place.nameless:
        shown[thing] = rng.choice(pictures.of_nothing, 1)
    masks = _pictures_of_masks(place, shown, pictures, wrong, rng)
    embeddings = unit(pictures.vectors[masks] + pictures.noise(rng, len(masks)))
    field = field_of(replace(place, evidence=place.evidence_of(embeddings)), words.encoder.identity)
    labels = place.labels[field.gaussian_ids]
    truth = np.array([meaning.get(label, -1) for label in labels.tolist()])
    mass = place.mass[field.gaussian_ids]
    given = sorted(set(meaning.values()) - {-1})
    present = {words.words[word]: truth == word for word in given if ((truth == word) & (mass > 0)).sum() >= least}
    named_pictures = np.unique(np.concatenate([shown[thing] for thing, word in meaning.items() if word >= 0]))
    rivals = words.shown_by(named_pictures, pictures) | words.like(given)
    absent = [words.words[word] for word in callable_words if word not in given and word not in rivals]
    name = f"{place.name}, {kind}, {wrong:.0%} wrong, {seed}"
    return Trial(name, field, place.gaussians, words.encoder, present, absent[:MOST_ABSENT], mass)


def called(place: Place, words: Names, names: Mapping[str, str], seed: int = 0) -> LanguageField:
    """Return the field of a place whose things are called as said, each mask with a drawn picture of its thing's name.

    names: a word of `words` by thing; masks of anything else show what has no name.
    """
    rng = np.random.default_rng(seed)
    numbers = [words.words.index(name) for name in names.values()]
    vectors = words.drawn(np.array([*numbers, *[-1] * OF_NOTHING]), rng)
    row = {thing: at for at, name in enumerate(names) for thing in place.things[name]}
    rows = [row.get(owner, len(numbers) + int(rng.integers(OF_NOTHING))) for owner in place.owners.tolist()]
    own = unit(vectors[rows] + words.noise_of_masks(rng, len(rows)))
    return field_of(replace(place, evidence=place.evidence_of(own)), words.encoder.identity)


def _pictures_of_masks(
    place: Place, shown: Mapping[int, np.ndarray], pictures: Pictures, wrong: float, rng: np.random.Generator
) -> np.ndarray:
    """Return the picture of each mask: of `wrong` of them another thing's, or one that has nothing to do with it."""
    anything = rng.choice(pictures.of_anything, len(place.owners))
    others = rng.choice(np.concatenate(list(shown.values())), len(place.owners))
    right = np.array([rng.choice(shown[o]) if o in shown else anything[k] for k, o in enumerate(place.owners)])
    swapped = np.where(rng.random(len(right)) < 0.5, others, anything)
    return np.where(rng.random(len(right)) < wrong, swapped, right)
