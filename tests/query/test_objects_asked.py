"""Queries of a field with objects: whole things, labels, points, and fields without objects as before."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from drsplat import Answer, Query, Scene
from drsplat.field.forest import PART
from drsplat.field.labels import LabelFile
from drsplat.query.linking import join_to_held
from drsplat.query.wholes import by_object, for_comparing, highest_share
from drsplat.query.wholes import with_objects as of_objects
from known_objects import CENTERS, EACH, TEST, with_objects


@pytest.fixture(scope="module")
def scene() -> Scene:
    field, gaussians = with_objects()
    return Scene(field, gaussians)


def axis(number: int) -> np.ndarray:
    return np.eye(8, dtype=np.float32)[number]


def slow_by_object(values: np.ndarray, things: np.ndarray) -> np.ndarray:
    """Of each thing the value that a quarter of its rows reach, counted up."""
    result = values.copy()
    for number in range(things.max(initial=-1) + 1):
        mine = np.sort(values[things == number])[::-1]
        if len(mine):
            result[things == number] = mine[-(-len(mine) // 4) - 1]
    return result


@given(
    arrays(np.float32, st.integers(0, 60), elements=st.floats(-1, 1, width=32)),
    st.integers(0, 5),
    st.integers(0, 2**32 - 1),
)
def test_a_thing_has_the_value_that_a_quarter_of_its_rows_reach(values, count, seed):
    things = default_rng(seed).integers(-1, count, len(values)).astype(np.int32)
    whole = highest_share(values, things)
    assert_array_equal(whole, slow_by_object(values, things))
    assert_array_equal(highest_share(whole, things), whole)
    for threshold in (-0.5, 0.0, 0.3):
        selected = values > threshold
        for number in range(count):
            mine = things == number
            is_meant = 4 * np.count_nonzero(selected[mine]) >= np.count_nonzero(mine)
            assert_array_equal(whole[mine] > threshold, is_meant)


@given(
    arrays(np.float32, st.integers(0, 30), elements=st.floats(-1, 1, width=32)),
    st.integers(0, 5),
    st.integers(0, 2**32 - 1),
)
def test_a_row_that_stands_for_several_counts_as_these(values, count, seed):
    rng = default_rng(seed)
    things, counts = rng.integers(-1, count, len(values)).astype(np.int32), rng.integers(1, 9, len(values))
    whole = highest_share(values, things, counts)
    expected = slow_by_object(np.repeat(values, counts), np.repeat(things, counts))
    assert_array_equal(np.repeat(whole, counts), expected)


def test_a_row_of_an_object_has_the_mean_of_its_own_value_and_the_objects(scene):
    field = scene.field
    values = default_rng(0).random(len(field), np.float32)
    things, pieces = field.objects.thing_of(), field.objects.piece_of()
    spoken = slow_by_object(values, things)
    in_piece = pieces >= 0
    spoken[in_piece] = np.maximum(spoken, slow_by_object(values, pieces))[in_piece]
    expected = (values + spoken) / 2
    assert_array_equal(by_object(field, values), expected)


def test_a_piece_that_fits_better_than_its_thing_speaks_for_its_rows():
    """Closed form: a quarter of thing 0 reaches 0.3, and of its piece 0.4; loose rows keep their own."""
    values = np.float32([0.1, 0.2, 0.3, 0.4, 0.1, 0.8, 0.8, 0.5])
    things = np.int32([0, 0, 0, 0, 0, 1, 1, -1])
    pieces = np.int32([-1, -1, 1, 1, 1, -1, -1, -1])
    got = of_objects(values, things, pieces)
    expected = [(0.1 + 0.3) / 2, (0.2 + 0.3) / 2, (0.3 + 0.4) / 2, (0.4 + 0.4) / 2, (0.1 + 0.4) / 2, 0.8, 0.8, 0.5]
    assert_allclose(got, expected, rtol=1e-6)
    assert (got >= of_objects(values, things, np.full(8, -1, np.int32))).all()


def test_pieces_are_right_below_their_thing(scene):
    """A part of a part counts for the piece that holds it; rows of no part are in none."""
    objects = scene.field.objects
    pieces, things = objects.piece_of(), objects.thing_of()
    for row in range(0, len(pieces), 7):
        node, way = int(objects.node_of[row]), []
        while node >= 0:
            way.append(node)
            node = int(objects.parents[node])
        parts = [node for node in way if objects.levels[node] == PART]
        assert pieces[row] == (parts[-1] if parts and things[row] >= 0 else -1)


def test_parts_of_a_thing_of_nothing_else_choose_their_classes_for_themselves(scene):
    """Box 0 is its two halves; once some rows are in no half, it has one mean."""
    objects = scene.field.objects
    thing, (one, other) = objects.things[0], np.flatnonzero(objects.parents == objects.things[0])
    values = np.arange(len(scene.field), dtype=np.float32)
    halves = [objects.node_of == node for node in (one, other)]
    got = for_comparing(scene.field, values)
    for half in halves:
        assert_allclose(got[half], values[half].mean(), rtol=1e-6)
    node_of = objects.node_of.copy()
    node_of[:100] = thing
    whole = replace(scene.field, objects=replace(objects, node_of=node_of))
    assert (whole.objects.single_of()[:EACH] == thing).all()
    assert_allclose(for_comparing(whole, values)[:EACH], values[:EACH].mean(), rtol=1e-6)
    assert_array_equal(for_comparing(replace(scene.field, objects=None), values), values)


class Fixed:
    """An encoder with a threshold, of these texts alone."""

    threshold = 0.3

    def __init__(self, **vectors: np.ndarray) -> None:
        self.identity = TEST
        self.vectors = {text: vector / np.linalg.norm(vector) for text, vector in vectors.items()}

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        return np.stack([self.vectors[text.replace(" ", "_")] for text in texts]).astype(np.float32)


def test_a_thing_that_fits_best_hides_no_other(scene):
    """Box 0 reaches seven tenths of what box 1 does: more than the plain field's cut, which objects do not raise."""
    found = Scene(scene.field, scene.gaussians, encoder=Fixed(either=0.7 * axis(0) + axis(1))).locate("either")
    assert sorted(match.object_id for match in found) == [0, 1]


def test_an_answer_is_whole_things_and_matches_say_which(scene):
    (match,) = scene.locate(Query(vector=axis(1)))
    assert match.object_id == 1
    assert_array_equal(match.gaussian_ids, np.arange(EACH, 2 * EACH))
    assert_allclose(match.center, CENTERS[1], atol=0.1)


def test_two_things_that_touch_are_two_places():
    field, gaussians = with_objects()
    close = gaussians.means.copy()
    close[EACH : 2 * EACH, 0] -= 0.75
    near = replace(gaussians, means=close)
    field = replace(field, scene=near.fingerprint)
    values = (field.objects.thing_of() < 2).astype(np.float32)
    found = Scene(field, near).locate(Answer.of(field, values, 0.5))
    assert sorted(match.object_id for match in found) == [0, 1]
    assert [match.sure for match in found] == [True, False]  # counted as parts of one
    loose = replace(field, objects=None)
    assert len(Scene(loose, near).locate(Answer.of(loose, values, 0.5))) == 1


def test_a_point_finds_the_thing_that_is_there(scene):
    answer = scene.ask(Query(point=CENTERS[0]))
    assert answer.rule == "object"
    assert_array_equal(answer.gaussian_ids, np.arange(EACH))
    (match,) = scene.locate(answer)
    assert match.object_id == 0
    assert match.support
    alike = scene.ask(Query(point=CENTERS[0], threshold=0.9))
    assert alike.rule == "given"


def test_a_label_is_exactly_what_was_named(tmp_path):
    field, gaussians = with_objects()
    named = Scene(field, gaussians, labels=LabelFile.beside(tmp_path / "known.field"))
    named.label(field.objects.thing(2), "Grandmother's chest")
    answer = named.ask("grandmother's CHEST")
    assert answer.rule == "label"
    assert_array_equal(answer.gaussian_ids, field.gaussian_ids[field.objects.rows(4)])
    (match,) = named.locate(answer)
    assert (match.object_id, match.label) == (2, "Grandmother's chest")
    with pytest.raises(ds.DrSplatError):  # any other text needs an encoder
        named.ask("chest")


def test_what_is_excluded_is_excluded_in_whole_things(scene):
    """ "a" is box 0, "b a" fits box 1 as well."""
    asked = Scene(scene.field, scene.gaussians, encoder=Fixed(a=axis(0) + axis(1), b_a=axis(1)))
    assert len(asked.locate("a")) == 2
    (left,) = asked.locate("a, not b")
    assert left.object_id == 0


class Axes:
    """Texts are numbers of axes, between which they lie."""

    identity = TEST

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        sums = np.stack([sum(map(axis, map(int, text.split()))) for text in texts])
        return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True), np.float32)


def test_nothing_is_found_where_words_of_the_list_fit_every_gaussian_better(scene):
    """All relevancies are below 0.5, which is not to say that the best of them stands out."""
    listed = scene.field.with_contrast(np.stack([axis(k) for k in range(4)]), ("0", "1", "2", "3"))
    asked = Scene(listed, scene.gaussians, encoder=Axes())
    answer = asked.ask("0 7")
    assert answer.rule == "list"
    assert answer.values.max() < 0.5
    assert not len(answer.gaussian_ids)
    assert not asked.locate("0 7")


def test_loose_gaussians_at_an_object_are_its_border():
    """Of two loose places one lies about object 3, the other by itself."""
    rng = default_rng(0)
    thing, border, away = rng.normal(size=(300, 3)), 1.2 * rng.normal(size=(40, 3)), rng.normal(size=(40, 3)) + 40
    points = np.concatenate([thing, border, away])
    places = np.repeat([3, -1, -2], [300, 40, 40])
    loose, held = np.flatnonzero(places < 0), np.flatnonzero(places >= 0)
    join_to_held(places, points, loose, held, None)
    assert np.unique(places[:340]).tolist() == [3]
    assert np.unique(places[340:]).tolist() == [-2]
