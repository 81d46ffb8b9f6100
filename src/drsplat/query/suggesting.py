"""Words that find something in a scene: to begin with, and in place of a query that has no match."""

from collections.abc import Sequence

import numpy as np

from ..base.arrays import Embedding
from ..errors import DrSplatError
from ..photos.models.mini.lexicon import NAMES, STRUCTURES
from .answer import Answer
from .naming import own_vocabulary
from .scene import Scene

SAMPLED_GAUSSIANS = 4096
LARGE_SHARE = 0.05  # of the sample: walls and tables, which nobody asks for first
MAX_WORDS_TRIED = 24
MAX_WORDS_INSTEAD = 3


def words_of(scene: Scene) -> tuple[str, ...]:
    """Return the encoder's own words, or those of a household for one that takes any."""
    return own_vocabulary(scene.encoder, scene.field) or (*NAMES, *STRUCTURES)


def suggestions(
    scene: Scene, words: Sequence[str] | None = None, most: int = 4, near: Embedding | None = None
) -> list[str]:
    """Return up to `most` words that find something: the most frequent of a sample first, large ones last.

    words: to choose from; None takes the encoder's own. near: the vector of a query whose nearest words come first.
    Nothing where no encoder is known.
    """
    try:
        found = (
            word
            for word in _likely(scene, words or words_of(scene), near)
            if any(match.sure for match in scene.locate(word, top=1))
        )
        return [word for word, _ in zip(found, range(most), strict=False)]
    except DrSplatError:
        return []


def words_instead(scene: Scene, answer: Answer, words: Sequence[str] | None = None) -> list[str]:
    """Return the words nearest to a query that has no match which do have one. words: as of `suggestions`."""
    if answer.vector is None:
        return []
    kept = scene.field.contrast
    return suggestions(scene, words or (None if kept is None else kept.texts), MAX_WORDS_INSTEAD, answer.vector)


def missed_text(answer: Answer, words: Sequence[str] = ()) -> str:
    """Say how near a query without a match came to one; "" where nothing was measured. words: that match here."""
    best = float(answer.values.max(initial=answer.lowest))
    below = f", below the threshold of {answer.threshold:.2f}" if round(best, 2) < round(answer.threshold, 2) else ""
    near = f"The best place has a {answer.measure} of {best:.2f}{below}." if best > answer.lowest else ""
    return f"{near} Words that match here: {', '.join(words)}.".strip() if words else near


def _likely(scene: Scene, words: Sequence[str], near: Embedding | None) -> list[str]:
    rows = len(scene.field)
    if not rows:
        return []
    chosen = np.sort(np.random.default_rng(0).permutation(rows)[:SAMPLED_GAUSSIANS])
    vectors = np.asarray(scene.encoder.encode_texts(words), np.float32)
    best = (scene.field.feature(chosen) @ vectors.T).argmax(1)
    share = np.bincount(best, minlength=len(words)) / len(chosen)
    order = np.lexsort((-share, share > LARGE_SHARE) if near is None else (-vectors @ near,))
    return [words[at] for at in order if share[at]][:MAX_WORDS_TRIED]
