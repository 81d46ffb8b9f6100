"""Words with genuine CLIP vectors, and pictures of them: genuine centroids, or vectors drawn like genuine pictures.

`Clip`: the published codebook of an encoder has genuine centroids of pictures, and there are 40 text vectors of the
same space. A mask's embedding is one of the centroids that fit its word better than the other words, moved as far as
residual codes do ("clean": the best centroid, cosine 0.98 with it; "rough": one of three, 0.94).

`Names`: genuine text vectors of the 1,203 names of LVIS and of 25 genuine pictures, whole photos. Pictures of names are
*drawn*: the mean picture, the centred vector of the name as strong as the best name of one of the 25, and noise in all
directions. Their cosines with all names, and with the best, are those that were measured of the 25; nothing else is
known to be.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from benchmarks.drawn_embeddings import unit
from drsplat import EncoderIdentity
from drsplat.base.arrays import Embeddings, Indices
from drsplat.field.codes import read_faiss_codebook
from drsplat.formats.vocabulary import VocabularyEncoder

NEGATIVES = ("object", "things", "stuff", "texture")
KINDS = {"clean": (1, 0.5, 0.004), "rough": (3, 1.0, -0.004)}  # pictures of a word, noise, least margin of centroids
FITS_NONE = 0.25  # of the centroids: those whose best word fits least
ALIKE = 0.5  # cosine of two texts, seen from the mean text: they mean about the same
OF_MASKS = 0.5  # share of a picture's variance that differs from mask to mask of a thing
OF_NAMES, OF_NOTHING = 24, 64  # words that things may be called, and pictures of no word, in a trial of names


@dataclass(frozen=True, eq=False)
class Pictures:
    """What masks may show. vectors: a row for each. of_word: rows by word. of_nothing: rows that fit no word.
    of_anything: rows of masks that show nothing in particular. noise: of single masks, by generator and count.
    """

    vectors: Float32[np.ndarray, "p D"]
    of_word: Mapping[int, Int64[np.ndarray, " c"]]
    of_nothing: Indices
    of_anything: Int64[np.ndarray, " a"]
    noise: Callable[[np.random.Generator, int], np.ndarray]


class Vocabulary:
    """words: plain nouns. texts: their unit vectors."""

    words: list[str]
    texts: Embeddings

    @cached_property
    def encoder(self) -> VocabularyEncoder:
        return VocabularyEncoder(EncoderIdentity("published", 512), self.words, self.texts)

    def pictures(self, kind: str, words: range, rng: np.random.Generator) -> Pictures:
        """Return what masks may show in a trial whose things are called by some of `words`. kind: of KINDS."""
        raise NotImplementedError

    def like(self, words: Sequence[int]) -> set[int]:
        """Return all words that mean about the same as some of `words`."""
        centred = unit(self.texts - self.texts.mean(0))
        return set(np.flatnonzero((centred @ centred[list(words)].T > ALIKE).any(1)).tolist())

    def shown_by(self, rows: np.ndarray, pictures: Pictures) -> set[int]:
        """Return the words that some pictures fit best, each word's mean cosine taken off."""
        scores = pictures.vectors @ self.texts.T
        return set((scores - scores.mean(0))[rows].argmax(1).tolist())


class Clip(Vocabulary):
    """negatives: vectors of words that mean nothing in particular. centroids: of genuine pictures.

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

    def pictures(self, kind: str, words: range, rng: np.random.Generator) -> Pictures:
        """Return all centroids, and those of the words that some centroid shows. Draws nothing."""
        count, noise, least = KINDS[kind]
        good = [word for word in words if self.margins[:, word].max() > least]
        scores = self.centroids @ self.texts.T
        best = (scores - scores.mean(0)).max(1)
        nothing = np.argsort(best)[: int(FITS_NONE * len(best))]
        return Pictures(
            self.centroids,
            {word: np.argsort(-self.margins[:, word])[:count] for word in good},
            nothing,
            nothing,
            lambda rng, count: noise * self.noise(rng, count),
        )

    def noise(self, rng: np.random.Generator, count: int) -> np.ndarray:
        parts = self.codes.shape[0]
        return self.codes[np.arange(parts), rng.integers(0, 256, (count, parts))].reshape(count, -1)


class Names(Vocabulary):
    """folder: lvis_names.json, lvis_texts.npy and photos25.npy, vectors of one space."""

    def __init__(self, folder: Path) -> None:
        self.words = [name.replace("_", " ") for name in json.loads((folder / "lvis_names.json").read_text())]
        self.texts = unit(np.load(folder / "lvis_texts.npy").astype(np.float64))
        self.photos = unit(np.load(folder / "photos25.npy").astype(np.float64))
        self.mean = self.photos.mean(0)
        left = (self.photos - self.mean) @ (self.texts - self.texts.mean(0)).T
        left -= left.mean(1, keepdims=True)
        self.spread = float(left.std() * np.sqrt(len(left) / (len(left) - 1)))  # of cosines, about both means
        self.fits = np.sort(left.max(1))  # how far each picture's best name stands out

    @cached_property
    def directions(self) -> Embeddings:
        """Per name its centred vector, as long as it has to be for a cosine of one more with the name."""
        centred = self.texts - self.texts.mean(0)
        return np.asarray(centred / (centred**2).sum(1, keepdims=True), np.float32)

    def drawn(self, names: np.ndarray, rng: np.random.Generator) -> Float32[np.ndarray, "p D"]:
        """Return a picture for each name, of nothing for a name below 0; with what differs from thing to thing."""
        fits = rng.choice(self.fits, len(names)) * (names >= 0)
        return self.mean + fits[:, None] * self.directions[names] + self._noise(rng, len(names), 1 - OF_MASKS)

    def pictures(self, kind: str, words: range, rng: np.random.Generator) -> Pictures:
        """Draw pictures of 24 names, none like another; of nothing; and of anything, each of any name."""
        chosen: list[int] = []
        for word in rng.permutation(np.asarray(words)).tolist():
            if len(chosen) < OF_NAMES and not self.like([word]) & set(chosen):
                chosen.append(word)
        each = KINDS[kind][0]
        names = np.concatenate(
            [np.repeat(chosen, each), np.full(OF_NOTHING, -1), rng.integers(0, len(self.words), 512)]
        )
        rows = np.arange(len(names))
        own = {word: rows[at * each : (at + 1) * each] for at, word in enumerate(chosen)}
        nothing, anything = np.split(rows[len(chosen) * each :], [OF_NOTHING])
        vectors = self.drawn(names, rng)
        return Pictures(vectors, own, nothing, anything, self.noise_of_masks)

    def noise_of_masks(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return what differs from mask to mask of one thing."""
        return self._noise(rng, count, OF_MASKS)

    def _noise(self, rng: np.random.Generator, count: int, share: float) -> np.ndarray:
        """Return rows of which cosines with names, and their mean over all names, have that share of the measured
        variance."""
        common = self.texts.mean(0)
        length = np.sqrt(((self.texts - common) ** 2).sum(1).mean())
        noise = rng.standard_normal((count, len(common))) * self.spread / length
        along = noise @ common / (common @ common)
        along *= 1 - (self.photos @ common).std() * length / (self.spread * np.linalg.norm(common))
        return np.asarray(np.sqrt(share) * (noise - along[:, None] * common), np.float32)
