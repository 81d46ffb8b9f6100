"""Encoder that knows words and no images: for the demo, for tests, for trying things out.

Every word has a fixed random direction. A text is the sum of its words, so that texts are similar by the share of words
that they have in common: "red mug" is at cosine 0.5 of "blue mug", at 0.71 of "mug" and near 0 of "elephant". Photos
need the embeddings of an image-text model such as CLIP.
"""

import hashlib
import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ...base.arrays import Doubles, Embeddings
from ...errors import InputError
from ...scene.encoders import EncoderIdentity

DIM = 512
VERSION = 1
SYNONYM_COSINE = 0.95
SYNONYMS = {
    "bear": "teddy", "carpet": "rug", "couch": "sofa", "cup": "mug", "kitten": "cat", "pillow": "cushion",
    "picture": "painting", "wood": "wooden",
}  # fmt: skip
"""Words at a cosine of SYNONYM_COSINE to each other."""

IGNORED = frozenset({
    "a", "an", "and", "any", "anything", "in", "is", "it", "of", "on", "one", "some", "something", "that", "the", "to",
    "where", "with",
})  # fmt: skip


class WordEncoder:
    """Encoder of texts to unit vectors, the same on every machine.

    threshold: cosine above which an object matches the words of a query: more than one of two words must be right.
    """

    identity = EncoderIdentity(
        "drsplat-words",
        DIM,
        hashlib.blake2b(repr((VERSION, SYNONYM_COSINE, sorted(SYNONYMS.items()))).encode(), digest_size=8).hexdigest(),
    )
    threshold = 0.6

    def encode_texts(self, texts: Sequence[str]) -> Embeddings:
        """Return unit vectors of the texts; case, plural s and words like "the" make no difference.

        Raises: InputError: a text without any word.
        """
        totals = []
        for text in texts:
            words = words_of(text)
            if not words:
                raise InputError(f"{text!r} has no word to look for: name an object, e.g. 'red mug'")
            totals.append(np.sum([_word_vector(word) for word in words], axis=0))
        return np.stack([total / np.linalg.norm(total) for total in totals]).astype(np.float32)


def words_of(text: str) -> list[str]:
    """Return the words that count, in singular: "The red mugs" gives red, mug."""
    words = re.findall(r"\w+", text.lower())
    return [re.sub(r"^(\w{2,}[^\Ws])s$", r"\1", word) for word in words if word not in IGNORED]


@lru_cache(maxsize=4096)
def _word_vector(word: str) -> Doubles:
    own = _random_direction(word)
    if word not in SYNONYMS:
        return own
    near = _random_direction(SYNONYMS[word])
    own = own - (own @ near) * near
    own /= np.linalg.norm(own)
    return SYNONYM_COSINE * near + np.sqrt(1 - SYNONYM_COSINE**2) * own


def _random_direction(word: str) -> Doubles:
    key = int.from_bytes(hashlib.blake2b(f"{VERSION} {word}".encode(), digest_size=16).digest(), "little")
    vector = np.random.Generator(np.random.Philox(key=key)).standard_normal(DIM)
    return vector / np.linalg.norm(vector)
