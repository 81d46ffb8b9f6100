"""Words to scores."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drsplat.encoders import EncoderIdentity
from drsplat.errors import InputError, MismatchError
from drsplat.search import NEGATIVES, embed_query, query, text_negatives
from fields import ToyEncoder, toy_field


def test_an_answer_is_the_fields_own_scores_and_relevancy() -> None:
    field, encoder = toy_field(), ToyEncoder()
    answer = query(field, encoder, "a red apple")
    vector = embed_query(encoder, field, "a red apple")
    assert_array_equal(answer.scores, field.scores(vector))
    expected = field.relevancy(vector, encoder.encode_texts(NEGATIVES))
    assert_array_equal(answer.relevancy, expected)
    assert answer.relevancy.min() < 0.5 < answer.relevancy.max()


def test_the_negatives_are_those_of_lerf() -> None:
    assert NEGATIVES == ("object", "things", "stuff", "texture")


def test_negatives_are_embedded_once() -> None:
    encoder = ToyEncoder()
    plain = toy_field()
    field = plain.with_negatives(encoder.encode_texts(NEGATIVES), NEGATIVES)
    expected = query(plain, encoder, "sofa")
    encoder.asked = 0
    assert_array_equal(query(field, encoder, "sofa").relevancy, expected.relevancy)
    assert encoder.asked == 1
    query(field, encoder, "sofa", ("wall",))
    assert encoder.asked == 3
    assert text_negatives(field, encoder) is field.negatives


def test_another_encoder_and_no_negatives_are_refused() -> None:
    field, other = toy_field(), ToyEncoder(EncoderIdentity("other", 32))
    for ask in (query, embed_query):
        arguments = (field, other) if ask is query else (other, field)
        with pytest.raises(MismatchError, match="written with toy"):
            ask(*arguments, "sofa")  # type: ignore[operator]
    with pytest.raises(InputError, match="at least one negative"):
        query(field, ToyEncoder(), "sofa", ())


def test_query_vectors_are_float32_of_the_fields_dimension() -> None:
    vector = embed_query(ToyEncoder(), toy_field(), "sofa")
    assert (vector.shape, vector.dtype) == ((32,), np.float32)
