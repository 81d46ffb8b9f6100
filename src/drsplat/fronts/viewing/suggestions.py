"""Suggestions of queries: words that a scene answers."""

from collections.abc import Sequence

import numpy as np

from ...errors import DrSplatError
from ...query import Scene
from .naming import words_of

SAMPLED_GAUSSIANS = 4096
LARGE_SHARE = 0.05  # of the sample: walls and tables, which nobody asks for first
MAX_WORDS_TRIED = 24


def suggestions(scene: Scene, words: Sequence[str] | None = None, most: int = 4) -> list[str]:
    """Return up to `most` words that find something: the most frequent of a sample first, large ones last.

    words: to choose from; None takes the encoder's own. Nothing where no encoder is known.
    """
    try:
        found = (word for word in _likely(scene, words or words_of(scene)) if _finds(scene, word))
        return [word for word, _ in zip(found, range(most), strict=False)]
    except DrSplatError:
        return []


def _likely(scene: Scene, words: Sequence[str]) -> list[str]:
    rows = len(scene.field)
    if not rows:
        return []
    chosen = np.sort(np.random.default_rng(0).permutation(rows)[:SAMPLED_GAUSSIANS])
    vectors = np.asarray(scene.encoder.encode_texts(words), np.float32)
    best = (scene.field.feature(chosen) @ vectors.T).argmax(axis=1)
    share = np.bincount(best, minlength=len(words)) / len(chosen)
    order = np.lexsort((-share, share > LARGE_SHARE))
    return [words[at] for at in order if share[at]][:MAX_WORDS_TRIED]


def _finds(scene: Scene, word: str) -> bool:
    return any(match.sure for match in scene.locate(word, top=1))
