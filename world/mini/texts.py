"""What can be said of a thing, truly or not."""

import numpy as np
from jaxtyping import Bool

from drsplat.mini.lexicon import ANYTHING, COLORS, GROUPS, MATERIALS, NAMES, STUFFS, TONES, fits

Label = tuple[str, str, str]  # name, colour, material
Text = tuple[str, ...]  # words


def bank(size: int, rng: np.random.Generator) -> list[Text]:
    """Random texts: a noun, at times with a colour, a material or both; or these alone."""
    nouns = [tuple(name.split()) for name in NAMES]
    nouns += [(word,) for word in GROUPS]
    paints = [*COLORS, *TONES]
    stuffs = [*MATERIALS, *STUFFS]
    texts = []
    for _ in range(size):
        kind = rng.random()
        noun = nouns[rng.integers(37 if rng.random() < 0.6 else len(nouns))]
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
    if rng.random() < 0.5:
        tones = [color] * 3 + [tone for tone, meant in TONES.items() if meant == color]
        words.append(str(rng.choice(tones)))
    if rng.random() < 0.15 and material in MATERIALS:
        words.append(material)
    if rng.random() < 0.85 or not words:
        words += nouns[rng.integers(len(nouns))]
    elif rng.random() < 0.5:
        words.append(str(rng.choice(ANYTHING)))
    return tuple(words)


def truth(labels: list[Label], texts: list[Text]) -> Bool[np.ndarray, "n t"]:
    """Whether every word of a text fits a thing."""
    words = sorted({word for text in texts for word in text})
    column = {word: i for i, word in enumerate(words)}
    known = np.array([[fits(word, *label) for word in words] for label in labels])
    return np.stack([known[:, [column[word] for word in text]].all(1) for text in texts], axis=1)
