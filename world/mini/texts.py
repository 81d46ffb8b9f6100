"""What can be said of a thing, truly or not."""

import numpy as np
from jaxtyping import Float32

from drsplat.photos.models.mini.lexicon import (
    ANYTHING,
    COLORS,
    GROUPS,
    MATERIALS,
    NAMES,
    PAINTS,
    STRUCTURES,
    STUFFS,
    TONES,
    fits,
)

from ..truth import Label

Text = tuple[str, ...]  # words


def bank(size: int, rng: np.random.Generator) -> list[Text]:
    """Random texts: a noun, at times with a colour, a material or both; or these alone."""
    nouns = [tuple(name.split()) for name in NAMES]
    nouns += [(word,) for word in (*GROUPS, *STRUCTURES)]
    paints = [*PAINTS, *TONES]
    stuffs = [*MATERIALS, *STUFFS]
    texts = []
    for _ in range(size):
        kind = rng.random()
        noun = nouns[rng.integers(len(NAMES) if rng.random() < 0.6 else len(nouns))]
        words: list[str] = []
        if kind >= 0.88 or (kind < 0.75 and rng.random() < 0.45):
            words.append(str(rng.choice(paints)))
        if 0.75 <= kind < 0.88 or rng.random() < 0.1:
            words.append(str(rng.choice(stuffs)))
        words += noun if kind < 0.75 else [str(rng.choice(ANYTHING))] if rng.random() < 0.6 else []
        texts.append(tuple(words))
    return texts


def said_of(label: Label, rng: np.random.Generator) -> Text:
    """A true text of a thing."""
    name, color, material = label
    nouns: list[Text] = [tuple(name.split())] * 3
    nouns += [(word,) for word, meant in GROUPS.items() if name in meant]
    words: list[str] = []
    if color and rng.random() < 0.5:
        tones = [PAINTS[COLORS.index(color)]] * 3 + [tone for tone, meant in TONES.items() if meant == color]
        words.append(str(rng.choice(tones)))
    if rng.random() < 0.15 and material in MATERIALS:
        words.append(material)
    if rng.random() < 0.85 or not words:
        words += nouns[rng.integers(len(nouns))]
    elif rng.random() < 0.5:
        words.append(str(rng.choice(ANYTHING)))
    return tuple(words)


def truth(labels: list[Label], texts: list[Text]) -> Float32[np.ndarray, "n t"]:
    """1 where every word of a text fits a thing, 0 where one does not, NaN where nobody knows."""
    words = sorted({word for text in texts for word in text})
    column = {word: i for i, word in enumerate(words)}
    value = {True: 1.0, False: 0.0, None: np.nan}
    known = np.array([[value[fits(word, *label)] for word in words] for label in labels], np.float32)
    return np.stack([_all(known[:, [column[word] for word in text]]) for text in texts], axis=1)


def _all(known: Float32[np.ndarray, "n w"]) -> Float32[np.ndarray, " n"]:
    return np.where((known == 0).any(1), np.float32(0), known.min(1))  # the least of any NaN is NaN
