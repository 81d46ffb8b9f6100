"""The word encoder: similarity is the share of words in common."""

import numpy as np
import pytest

from drsplat import WordEncoder
from drsplat.errors import InputError
from drsplat.photos.models.words import DIM, SYNONYM_COSINE, words_of


def cosine(a: str, b: str) -> float:
    one, other = WordEncoder().encode_texts([a, b])
    return float(one @ other)


def test_vectors_are_unit_and_of_the_identity_s_dimension():
    vectors = WordEncoder().encode_texts(["red mug", "mug", "a very old wooden table"])
    assert vectors.shape == (3, DIM) == (3, WordEncoder.identity.dim)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6)


def test_cosine_is_the_share_of_words_in_common():
    # random directions in 512 dimensions are at cosine 0 +- 0.044
    assert cosine("red mug", "blue mug") == pytest.approx(0.5, abs=0.15)
    assert cosine("red mug", "mug") == pytest.approx(np.sqrt(0.5), abs=0.15)
    assert abs(cosine("red mug", "elephant")) < 0.2


def test_synonyms_are_near():
    assert cosine("couch", "sofa") == pytest.approx(SYNONYM_COSINE, abs=1e-6)


def test_case_plural_order_and_small_words_make_no_difference():
    assert cosine("The red MUGS", "mug, red") == pytest.approx(1, abs=1e-6)
    assert words_of("something made of glass") == ["made", "glass"]


def test_a_vector_is_the_same_everywhere():
    """Pins the hash, the generator and its normal deviates: fields on disk depend on them."""
    first = WordEncoder().encode_texts(["mug"])[0, :4]
    pinned = [0.05199506, 0.0332781, -0.12046916, 0.02720361]
    np.testing.assert_allclose(first, pinned, atol=1e-7)


@pytest.mark.parametrize("text", ["", "the", "?!"])
def test_a_text_without_words_is_refused(text):
    with pytest.raises(InputError, match="name an object"):
        WordEncoder().encode_texts([text])
