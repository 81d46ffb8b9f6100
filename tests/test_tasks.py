"""Selection and localization on scenes where the answer is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drsplat.encoders import EncoderIdentity
from drsplat.errors import InputError, MismatchError
from drsplat.evidence import Evidence, Segments
from drsplat.field import build_field
from drsplat.gaussians import Gaussians
from drsplat.tasks import locate, select


def boxes_scene(
    centers: list[tuple[float, float, float]],
    size=(0.4, 0.2, 0.1),
    turn: Rotation | None = None,
    seed: int = 0,
) -> tuple[Gaussians, np.ndarray]:
    """Filled boxes of 500 Gaussians each, at `centers`, and their labels."""
    rng = np.random.default_rng(seed)
    local = (rng.random((len(centers), 500, 3)) - 0.5) * size
    turned = local if turn is None else turn.apply(local.reshape(-1, 3)).reshape(local.shape)
    points = (turned + np.array(centers)[:, None]).reshape(-1, 3)
    n = len(points)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    scales = np.full((n, 3), 0.01, np.float32)
    scene = Gaussians(
        points.astype(np.float32),
        quats,
        scales,
        np.full(n, 0.8, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    return scene, np.repeat(np.arange(len(centers)), 500)


def field_of(scene: Gaussians, labels: np.ndarray):
    """A field in which every Gaussian has exactly the embedding of its label."""
    from scipy.sparse import csr_array

    count = int(labels.max()) + 1
    weights = csr_array(
        (np.ones(len(scene), np.float32), labels.astype(np.int32), np.arange(len(scene) + 1)),
        shape=(len(scene), count),
    )
    segments = Segments(("a.png",), np.zeros(count, np.int32), np.arange(count, dtype=np.int32))
    embeddings = np.eye(count, 8, dtype=np.float32)
    return build_field(
        Evidence(weights, segments, embeddings), scene.fingerprint, EncoderIdentity("test", 8)
    )


def unit(label: int) -> np.ndarray:
    return np.eye(8, dtype=np.float32)[label]


def test_select_is_strictly_above_the_threshold():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    scores = field.scores(unit(1))
    assert np.array_equal(select(field, scores, 0.5), np.flatnonzero(labels == 1))
    assert len(select(field, scores, float(scores.max()))) == 0
    with pytest.raises(InputError, match="expected 1000 scores"):
        select(field, scores[1:], 0.5)


@pytest.mark.parametrize("turn", [None, Rotation.from_euler("xyz", [20, -35, 50], degrees=True)])
def test_locate_finds_a_turned_box(turn):
    scene, labels = boxes_scene([(0, 0, 0), (3, 1, 2)], turn=turn)
    field = field_of(scene, labels)
    found = locate(field, scene, field.scores(unit(1)), 0.5)
    assert len(found) == 1
    thing = found[0]
    np.testing.assert_allclose(thing.center, (3, 1, 2), atol=0.03)
    np.testing.assert_allclose(thing.extent, (0.4, 0.2, 0.1), rtol=0.12)
    expected = np.eye(3) if turn is None else turn.as_matrix().T
    assert (np.abs((thing.axes * expected).sum(1)) > 0.98).all()
    assert np.linalg.det(thing.axes) == pytest.approx(1)
    assert thing.score == pytest.approx(1, abs=1e-4)
    assert np.array_equal(np.sort(thing.gaussian_ids), np.flatnonzero(labels == 1))


def test_things_apart_are_counted_apart_and_together_when_linked():
    scene, labels = boxes_scene([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    field = field_of(scene, np.zeros_like(labels))
    scores = field.scores(unit(0))
    assert len(locate(field, scene, scores)) == 3
    assert len(locate(field, scene, scores, link_distance=0.9)) == 1


def test_the_best_score_comes_first():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    mixed = field.scores(unit(0) * 0.6 + unit(1) * 0.8)
    found = locate(field, scene, mixed, 0.3)
    assert [round(thing.score, 1) for thing in found] == [0.8, 0.6]
    np.testing.assert_allclose(found[0].center, (2, 0, 0), atol=0.03)


def test_nothing_found_is_an_answer_and_crumbs_are_left_out():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    assert locate(field, scene, field.scores(unit(5)), 0.5) == []
    few = np.where(np.arange(len(scene)) < 6, 1, 0).astype(np.float32)
    assert locate(field, scene, few, 0.5) == []
    assert len(locate(field, scene, few, 0.5, min_gaussians=3, link_distance=10.0)) == 1


def test_locate_moves_with_the_scene():
    turn, shift = Rotation.from_euler("xyz", [10, 80, -30], degrees=True), np.array([5.0, -2, 1])
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    points = (turn.apply(scene.means) + shift).astype(np.float32)
    moved = Gaussians(points, scene.quats, scene.scales, scene.opacities, scene.sh)
    a = locate(field_of(scene, labels), scene, field_of(scene, labels).scores(unit(0)))[0]
    b = locate(field_of(moved, labels), moved, field_of(moved, labels).scores(unit(0)))[0]
    np.testing.assert_allclose(b.center, turn.apply(a.center) + shift, atol=1e-3)
    np.testing.assert_allclose(b.extent, a.extent, atol=1e-3)


def test_another_scene_is_refused():
    scene, labels = boxes_scene([(0, 0, 0), (2, 0, 0)])
    field = field_of(scene, labels)
    other, _ = boxes_scene([(0, 0, 0), (2, 0, 0)], seed=1)
    with pytest.raises(MismatchError, match="row order"):
        locate(field, other, field.scores(unit(0)))
