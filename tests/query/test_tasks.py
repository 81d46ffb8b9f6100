"""Selection, localization and segmentation on scenes where the answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from drsplat.errors import MismatchError
from drsplat.field import LanguageField, build_field
from drsplat.field.codes import Codebook
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.query import Answer, Match
from drsplat.query.tasks import NO_CLASS, locate, rank, segment, sure_matches, whole_of
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.gaussians import Gaussians
from refusing import refused


def boxes_scene(
    centers: list[tuple[float, float, float]], size=(0.4, 0.2, 0.1), turn: Rotation | None = None, seed: int = 0
) -> tuple[Gaussians, np.ndarray]:
    """Filled boxes of 500 Gaussians each, at `centers`, and their labels."""
    rng = default_rng(seed)
    local = (rng.random((len(centers), 500, 3)) - 0.5) * size
    turned = local if turn is None else turn.apply(local.reshape(-1, 3)).reshape(local.shape)
    points = (turned + np.array(centers)[:, None]).reshape(-1, 3)
    n = len(points)
    quats = np.tile(np.float32([1, 0, 0, 0]), (n, 1))
    scales = np.full((n, 3), 0.002, np.float32)
    scene = Gaussians(
        points.astype(np.float32), quats, scales, np.full(n, 0.8, np.float32), np.zeros((n, 1, 3), np.float32)
    )
    return scene, np.repeat(np.arange(len(centers)), 500)


def field_of(scene: Gaussians, labels: np.ndarray):
    """A field in which every Gaussian has exactly the embedding of its label."""
    count = int(labels.max()) + 1
    weights = csr_array(
        (np.ones(len(scene), np.float32), labels.astype(np.int32), np.arange(len(scene) + 1)), shape=(len(scene), count)
    )
    masks = MaskIds(("a.png",), np.zeros(count, np.int32), np.arange(count, dtype=np.int32))
    embeddings = np.eye(count, 8, dtype=np.float32)
    return build_field(Evidence(weights, masks, embeddings), scene.fingerprint, EncoderIdentity("test", 8))


def unit(label: int) -> np.ndarray:
    return np.eye(8, dtype=np.float32)[label]


def test_select_is_strictly_above_the_threshold():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    scores = field.scores(unit(1))
    assert np.array_equal(Answer.of(field, scores, 0.5).gaussian_ids, np.flatnonzero(labels == 1))
    assert len(Answer.of(field, scores, float(scores.max())).gaussian_ids) == 0
    with refused("expected 1000 values"):
        Answer.of(field, scores[1:], 0.5)


@pytest.mark.parametrize("turn", [None, Rotation.from_euler("xyz", [20, -35, 50], degrees=True)])
def test_locate_finds_a_turned_box(turn):
    scene, labels = boxes_scene([(0, 0, 0), (3, 1, 2)], turn=turn)
    field = field_of(scene, labels)
    found = locate(Answer.of(field, field.scores(unit(1)), 0.5), scene)
    assert len(found) == 1
    thing = found[0]
    assert_allclose(thing.center, (3, 1, 2), atol=0.03)
    assert_allclose(thing.extent, (0.4, 0.2, 0.1), rtol=0.08)
    expected = np.eye(3) if turn is None else turn.as_matrix().T
    assert (np.abs((thing.axes * expected).sum(1)) > 0.98).all()
    assert np.linalg.det(thing.axes) == pytest.approx(1)
    assert thing.score == pytest.approx(1, abs=1e-4)
    assert np.array_equal(np.sort(thing.gaussian_ids), np.flatnonzero(labels == 1))


def test_things_apart_are_counted_apart_and_together_when_linked():
    scene, labels = boxes_scene([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    field = field_of(scene, np.zeros_like(labels))
    scores = field.scores(unit(0))
    assert len(locate(Answer.of(field, scores, 0.5), scene)) == 3
    assert len(locate(Answer.of(field, scores, 0.5), scene, link_distance=0.9)) == 1


def test_nothing_found_is_an_answer_and_crumbs_are_left_out():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    assert locate(Answer.of(field, field.scores(unit(5)), 0.5), scene) == []
    few = np.where(np.arange(len(scene)) < 6, 1, 0).astype(np.float32)
    assert locate(Answer.of(field, few, 0.5), scene) == []
    assert len(locate(Answer.of(field, few, 0.5), scene, min_gaussians=3, link_distance=10.0)) == 1


def test_locate_moves_with_the_scene():
    turn, shift = Rotation.from_euler("xyz", [10, 80, -30], degrees=True), np.array([5.0, -2, 1])
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    points = (turn.apply(scene.means) + shift).astype(np.float32)
    moved = Gaussians(points, scene.quats, scene.scales, scene.opacities, scene.sh)

    def of(gaussians):
        field = field_of(gaussians, labels)
        return Answer.of(field, field.scores(unit(0)), 0.5)

    a = locate(of(scene), scene)[0]
    b = locate(of(moved), moved)[0]
    assert_allclose(b.center, turn.apply(a.center) + shift, atol=1e-3)
    assert_allclose(b.extent, a.extent, atol=1e-3)


def test_another_scene_is_refused():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    other, _ = boxes_scene([(0, 0, 0), (2, 0, 0)], seed=1)
    with pytest.raises(MismatchError, match="in another order"):
        locate(Answer.of(field, field.scores(unit(0)), 0.5), other)


def test_what_can_be_seen_through_is_no_thing():
    """40 solid Gaussians are a thing, 500 faint ones in the air are none."""
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    opacities = np.where(labels == 1, 0.09, 0.8).astype(np.float32)
    hazy = Gaussians(scene.means, scene.quats, scene.scales, opacities, scene.sh)
    field = field_of(hazy, labels)
    assert locate(Answer.of(field, field.scores(unit(1)), 0.5), hazy) == []
    opacities[np.flatnonzero(labels == 1)[:40]] = 0.1
    some = Gaussians(scene.means, scene.quats, scene.scales, opacities, scene.sh)
    assert len(locate(Answer.of(field, field.scores(unit(1)), 0.5), some, min_gaussians=40)) == 1
    assert locate(Answer.of(field, field.scores(unit(1)), 0.5), some, min_gaussians=41) == []


classes = st.integers(1, 5).flatmap(
    lambda count: st.lists(st.lists(st.integers(-4, 4), min_size=count, max_size=count), min_size=1, max_size=12)
)


CODEBOOK = Codebook(default_rng(0).standard_normal((8, 256, 1)).astype(np.float32), None, EncoderIdentity("test", 8))


def class_scores(table: list[list[int]]) -> tuple[LanguageField, np.ndarray]:
    """A field of as many rows, in a scene where every third Gaussian has no feature; scores (C, R)."""
    rows = len(table)
    ids = np.flatnonzero(np.arange(2 * rows) % 3 != 2)[:rows]
    weights = np.zeros((int(ids[-1]) + 2, 1), np.float32)
    weights[ids] = 1
    masks = MaskIds(("a.png",), np.zeros(1, np.int32), np.zeros(1, np.int32))
    evidence = Evidence(csr_array(weights), masks, np.eye(1, 8, dtype=np.float32))
    field = build_field(evidence, "any", EncoderIdentity("test", 8), CODEBOOK)
    return field, np.ascontiguousarray(np.array(table, np.float32).T / 4)


@settings(derandomize=True)
@given(classes, st.integers(-5, 4))
def test_segment_is_the_argmax_of_those_that_compete(table, quarters):
    """Against a loop over Gaussians and classes."""
    field, scores = class_scores(table)
    count = len(scores)
    limits = [quarters / 4 + 0.25 * (c % 2) for c in range(count)]
    labels = segment(field, scores, limits)
    expected = np.full(field.num_gaussians, NO_CLASS)
    for row, gaussian in enumerate(field.gaussian_ids):
        best = -np.inf
        for c in range(count):
            if scores[c, row] > limits[c] and scores[c, row] > best:
                expected[gaussian], best = c, scores[c, row]
    assert_array_equal(labels, expected)


def test_segment_without_threshold_labels_all_that_have_a_feature():
    field, scores = class_scores([[-4, -3], [2, 2], [0, 1]])
    labels = segment(field, iter(scores))
    assert labels[field.gaussian_ids].tolist() == [1, 0, 1]
    assert (np.delete(labels, field.gaussian_ids) == NO_CLASS).all()
    assert (segment(field, []) == NO_CLASS).all()


def test_segment_refuses_what_does_not_fit():
    field, scores = class_scores([[1, 2], [2, 1], [0, 0]])
    with refused("expected 3 scores"):
        segment(field, [scores[0][:2]])
    for limits in ([0.0], [0.0] * 3):
        with refused("thresholds for 2 classes"):
            segment(field, scores, limits)


def places(*things: tuple[int, float]) -> tuple[Gaussians, Answer]:
    """Things of so many Gaussians and such a value each, two units apart."""
    rng = default_rng(0)
    labels = np.repeat(np.arange(len(things)), [count for count, _ in things])
    points = rng.uniform(-0.1, 0.1, (len(labels), 3)) + np.array([2.0, 0, 0]) * labels[:, None]
    quats = np.tile(np.float32([1, 0, 0, 0]), (len(labels), 1))
    scales, opacities = np.full((len(labels), 3), 0.01, np.float32), np.full(len(labels), 0.5, np.float32)
    sh = np.zeros((len(labels), 1, 3), np.float32)
    scene = Gaussians(points.astype(np.float32), quats, scales, opacities, sh)
    field = field_of(scene, labels)
    return scene, Answer.of(field, np.float32([value for _, value in things])[labels], -1.0)


def test_a_splinter_does_not_come_before_the_thing_that_it_is_of():
    scene, answer = places((60, 0.966), (4000, 0.88), (120, 0.93))
    matches = locate(answer, scene, link_distance=0.5)
    assert [len(match) for match in matches] == [4000, 120, 60]
    ranks = [0.88 * 2000**0.1, 0.93 * 60**0.1, 0.966 * 30**0.1]
    assert_allclose([rank(match, scene) for match in matches], ranks, rtol=1e-5)


def test_a_large_thing_that_fits_clearly_worse_does_not_come_first():
    scene, answer = places((4000, 0.55), (100, 0.9))
    assert [len(match) for match in locate(answer, scene, link_distance=0.5)] == [100, 4000]
    scene, answer = places((4000, -0.5), (100, -0.4), (60, 0.01))
    assert [len(match) for match in locate(answer, scene, link_distance=0.5)] == [60, 100, 4000]


def test_sure_are_the_best_and_those_nearly_as_good():
    scene, answer = places((60, 0.966), (4000, 0.88), (3000, 0.8), (4000, 0.7))
    matches = locate(answer, scene, link_distance=0.5)
    assert [len(match) for match in sure_matches(matches, scene)] == [4000, 3000]
    scene, answer = places((200, -0.5), (100, -0.4))
    assert [len(match) for match in sure_matches(locate(answer, scene, link_distance=0.5), scene)] == [100]
    assert sure_matches([], scene) == []


def test_parts_that_touch_are_counted_once():
    """Foot and shade of a lamp, what lies on it by chance and fits less, a second lamp, and a scrap of that."""
    centers = [(0.0, 0, 0), (0.0, 0, 0.1), (0.4, 0, 0), (3.0, 0, 0), (3.4, 0, 0)]
    scene, labels = boxes_scene(centers)
    field = field_of(scene, labels)
    values = np.float32([0.9, 0.85, 0.6, 0.92, 0.88])[labels]
    one = locate(Answer.of(field, values, 0.5), scene)
    assert len(one) == 2
    matches = [
        replace(one[0], gaussian_ids=np.flatnonzero(labels == k), score=float(values[labels == k][0]))
        for k in (3, 0, 1, 4, 2)
    ]
    matches = [
        replace(match, center=np.array(centers[k]), extent=np.array([0.4, 0.2, 0.1]))
        for match, k in zip(matches, (3, 0, 1, 4, 2), strict=True)
    ]
    assert whole_of(matches, [True] * 3 + [False] * 2, scene) == [0, 1, 1, 0, -1]
    assert whole_of(matches[:1], [True], scene) == [0]
    assert whole_of([], [], scene) == []


def test_two_parts_that_a_third_holds_together_are_one():
    """Both sides of a box, and the lid between them, which fits least; a second box stands apart."""
    centers = [(0.0, 0, 0), (0.8, 0, 0), (0.4, 0, 0), (3.0, 0, 0)]
    scene, labels = boxes_scene(centers)
    scores = (0.9, 0.9, 0.85, 0.9)
    box = np.array([0.4, 0.2, 0.1])
    matches = [
        Match(np.array(center), np.eye(3), box, score, np.flatnonzero(labels == k))
        for k, (center, score) in enumerate(zip(centers, scores, strict=True))
    ]
    assert whole_of(matches[:2], [True] * 2, scene) == [0, 1]
    assert whole_of([*matches[:2], matches[3], matches[2]], [True] * 3 + [False], scene) == [0, 0, 2, 0]
