"""Words to scores, with words that are not meant; clicks to queries."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from drsplat import Gaussians, LanguageField, View, WordEncoder
from drsplat.errors import MismatchError
from drsplat.kernels import splat_arrays, topk_contributions
from drsplat.query import Answer, Query, Scene
from drsplat.query.search import NEGATIVES, UNSELECTED_COSINE, embed_query, split_negation, text_negatives, without
from drsplat.scene.encoders import EncoderIdentity
from fields import ToyEncoder, toy_field
from refusing import refused


def relevancy_of(scene: Scene, text: str) -> Answer:
    return scene.ask(Query(text, relevancy=True))


def test_an_answer_is_the_fields_own_scores_and_relevancy():
    field, encoder = toy_field(), ToyEncoder()
    answer = relevancy_of(Scene(field, encoder=encoder), "a red apple")
    vector = embed_query(encoder, field, "a red apple")
    assert_array_equal(answer.scores, field.scores(vector))
    expected = field.relevancy(vector, encoder.encode_texts(NEGATIVES))
    assert_array_equal(answer.values, expected)
    assert (answer.measure, answer.threshold, answer.rule) == ("relevancy", 0.5, "default")
    assert answer.values.min() < 0.5 < answer.values.max()


def test_the_negatives_are_those_of_lerf():
    assert NEGATIVES == ("object", "things", "stuff", "texture")


def test_negatives_are_embedded_once():
    encoder = ToyEncoder()
    plain = toy_field()
    field = plain.with_negatives(encoder.encode_texts(NEGATIVES), NEGATIVES)
    expected = relevancy_of(Scene(plain, encoder=encoder), "sofa").values
    encoder.asked, scene = 0, Scene(field, encoder=encoder)
    assert_array_equal(relevancy_of(scene, "sofa").values, expected)
    assert encoder.asked == 1
    scene.ask(Query("sofa", negatives=("wall",)))
    assert encoder.asked == 3
    assert text_negatives(field, encoder) is field.negatives


def test_another_encoder_and_no_negatives_are_refused():
    field, other = toy_field(), ToyEncoder(EncoderIdentity("other", 32))
    with pytest.raises(MismatchError, match="written with toy"):
        embed_query(other, field, "sofa")
    with pytest.raises(MismatchError, match="written with toy"):
        Scene(field, encoder=other).ask("sofa")
    with refused("at least one negative"):
        Scene(field, encoder=ToyEncoder()).ask(Query("sofa", negatives=()))


@pytest.mark.parametrize(
    ("text", "wanted", "unwanted"),
    [
        ("mug", "mug", ()),
        ("mug, not red", "mug", ("red",)),
        ("mug , NOT red", "mug", ("red",)),
        ("mug but not red", "mug", ("red",)),
        ("mug, but not red", "mug", ("red",)),
        ("a mug, not red, not blue", "a mug", ("red", "blue")),
        ("red, white and blue", "red, white and blue", ()),
        ("not red", "not red", ()),
        ("knotted rope, nothing else", "knotted rope, nothing else", ()),
    ],
)
def test_a_text_says_what_is_not_meant(text, wanted, unwanted):
    assert split_negation(text) == (wanted, unwanted)


@pytest.mark.parametrize("text", [", not red", "mug, not ", "mug, not red, not "])
def test_a_negation_of_nothing_is_refused(text):
    with refused("mug, not red"):
        split_negation(text)


WORDS = ("red", "blue", "mug", "plate", "wooden", "old")


@settings(derandomize=True)
@given(st.sets(st.sampled_from(WORDS)), st.sampled_from(WORDS[:2]), st.sets(st.sampled_from(WORDS[2:]), min_size=1))
def test_a_thing_is_left_out_exactly_if_the_unwanted_word_is_true_of_it(more, unwanted, wanted):
    """With texts as sums of words: s(n p) > s(p) where n is among a thing's words, as sqrt(p + 1) > sqrt(p)."""
    encoder, said_of_it = WordEncoder(), wanted | more
    query = " ".join(sorted(wanted))
    feature = encoder.encode_texts([" ".join(sorted(said_of_it))])[0]
    scores = np.float32([feature @ encoder.encode_texts([query])[0]])
    rivals = np.float32([feature @ encoder.encode_texts([f"{unwanted} {query}"])[0]])
    left_out = without(scores, rivals)[0] == UNSELECTED_COSINE
    assert left_out == (unwanted in said_of_it)


def test_queries_leave_out_what_is_not_meant():
    field, encoder = toy_field(), ToyEncoder()
    scene = Scene(field, encoder=encoder)
    plain, answer = scene.ask("apple"), scene.ask("apple, not red, not old")
    rivals = [field.scores(encoder.encode_texts([text])[0]) for text in ("red apple", "old apple")]
    gone = np.maximum(*rivals) >= plain.scores
    assert 0 < gone.sum() < len(gone)
    assert_array_equal(answer.scores, np.where(gone, np.float32(-1), plain.scores))
    assert (answer.values[gone] == answer.lowest).all()
    assert_array_equal(answer.values[~gone], plain.values[~gone])


def feature_at(field: LanguageField, gaussians: Gaussians, view: View, xy: tuple[float, float]) -> np.ndarray:
    return Scene(field, gaussians, [view]).feature_of((view.name, *xy))


@pytest.fixture(scope="module")
def clicked(story) -> tuple[LanguageField, Gaussians, View]:
    return story.field, story.gaussians, story.views[4]


def test_a_click_is_the_feature_of_the_heaviest_gaussian_there(clicked):
    field, gaussians, view = clicked
    top = topk_contributions(splat_arrays(gaussians), view, 1)
    rng, seen = np.random.default_rng(0), 0
    for column, row in zip(rng.integers(0, 320, 12), rng.integers(0, 240, 12), strict=True):
        heaviest = int(top.ids[row, column, 0])
        at = int(np.searchsorted(field.gaussian_ids, heaviest))
        if heaviest < 0 or field.gaussian_ids[at] != heaviest:
            continue
        feature = feature_at(field, gaussians, view, (column + 0.99, float(row)))
        assert_array_equal(feature, field.feature(np.array([at]))[0])
        seen += 1
    assert seen > 5


def test_a_click_passes_over_gaussians_without_feature(clicked):
    field, gaussians, view = clicked
    top = topk_contributions(splat_arrays(gaussians), view, 2)
    row, column = np.argwhere((top.ids >= 0).all(-1) & np.isin(top.ids, field.gaussian_ids).all(-1))[0]
    first, second = (int(one) for one in top.ids[row, column])
    kept = field.gaussian_ids != first
    fewer = replace(
        field,
        gaussian_ids=field.gaussian_ids[kept],
        code=field.code.rows(np.flatnonzero(kept)),
        evidence=None,
        negatives=None,
    )
    feature = feature_at(fewer, gaussians, view, (float(column), float(row)))
    at = int(np.searchsorted(fewer.gaussian_ids, second))
    assert_array_equal(feature, fewer.feature(np.array([at]))[0])


def test_clicks_at_nothing_and_outside_are_refused(clicked):
    field, gaussians, view = clicked
    for xy in ((-0.1, 5.0), (320.0, 5.0), (5.0, 240.0)):
        with refused("outside of view"):
            feature_at(field, gaussians, view, xy)
    away = view.cam_from_world.copy()
    away[:3] = np.diag([1, -1, -1]) @ away[:3]  # about-turn
    with refused("click elsewhere"):
        feature_at(field, gaussians, replace(view, cam_from_world=away), (5.0, 5.0))
    with pytest.raises(MismatchError, match="belongs to a scene"):
        feature_at(field, gaussians.subset(np.arange(10)), view, (5.0, 5.0))


def test_weights_at_pixels_are_those_of_the_kernel(clicked):
    field, gaussians, view = clicked
    scene = Scene(field, gaussians, [view])
    whole = topk_contributions(splat_arrays(gaussians), view, 5)
    pixels = np.random.default_rng(0).integers(0, (view.width, view.height), (200, 2))
    pixels = np.concatenate([pixels, pixels[:3]])  # the same again
    x, y = pixels.T
    found = scene.weights_at(view.name, pixels + 0.5, 5)
    assert_array_equal(found.weights, whole.weights[y, x])
    apart = np.diff(whole.weights[y, x], axis=1, prepend=2, append=-1) != 0
    alone = apart[:, :-1] & apart[:, 1:]  # equal weights have no order
    assert alone.mean() > 0.5
    assert_array_equal(found.gaussian_ids[alone], whole.ids[y, x][alone])
    assert (found.gaussian_ids < 0).any()
    assert (scene.weights_at(view, pixels, 1).weights[:, 0] == found.weights[:, 0]).all()
    assert scene.weights_at(view, [], 3).weights.shape == (0, 3)
    for wrong, said in (([(-1.0, 2.0)], "outside of view"), ([(1.0, np.nan)], "two finite numbers")):
        with refused(said):
            scene.weights_at(view, wrong)
    with refused("positive"):
        scene.weights_at(view, [(1.0, 1.0)], 0)
