"""The furnished room is what it says, its masks err as documented, and its answers are right."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from world.cameras import look_at

from drsplat import WordEncoder
from drsplat.kernels import splat_arrays, topk_contributions
from furnished.cameras import walk
from furnished.masks import MISSED_SHARE, MaskMaker, exact_labels, perturbed
from furnished.probes import PROBES
from furnished.room import INVENTORY, build_room
from furnished.story import intersection_over_union


def test_every_question_is_about_things_in_the_room_or_about_none():
    assert all({*probe.meant} <= INVENTORY.keys() for probe in PROBES)
    assert sum(not probe.meant for probe in PROBES) >= 2


def test_labels_are_those_of_the_largest_share():
    """Against the sum over each pixel's contributors, one by one."""
    room = build_room(4.0)
    view = look_at((4.5, -1, 2), (2, 2, 0.8), (48, 36), 60, "v")
    ids, weights = topk_contributions(splat_arrays(room.gaussians), view, 400)
    shares = np.zeros((36, 48, len(room.names)))
    for k in range(ids.shape[2]):
        rows, columns = np.nonzero(ids[..., k] >= 0)
        np.add.at(shares, (rows, columns, room.labels[ids[rows, columns, k]]), weights[rows, columns, k])
    two = np.sort(shares, axis=-1)[..., -2:]
    clear = (two[..., 1] - two[..., 0] > 1e-3) & (abs(shares.sum(-1) - 0.5) > 1e-3)
    expected = np.where(shares.sum(-1) < 0.5, -1, shares.argmax(-1))
    assert_array_equal(exact_labels(room, view)[clear], expected[clear])
    assert clear.mean() > 0.95


def test_masks_lie_within_their_thing_and_leave_its_border_out():
    labels = np.full((60, 80), -1, np.int32)
    labels[10:30, 10:40], labels[10:30, 40:70], labels[40:44, 5:9] = 0, 1, 2
    mask_ids, things = perturbed(labels, default_rng(1))
    for mask, thing in enumerate(things):
        assert (labels[mask_ids == mask] == thing).all()
    assert (mask_ids[:, [10, 39, 40, 69]] == -1).all()
    assert 2 not in things  # 4 x 4 pixels are too few


def test_masks_are_missing_as_often_as_documented():
    labels = np.repeat(np.repeat(np.arange(100, dtype=np.int32).reshape(10, 10), 12, 0), 12, 1)
    counts = [len(perturbed(labels, default_rng(seed))[1]) for seed in range(20)]
    # 2000 draws: the share's standard deviation is 0.006
    assert 1 - np.mean(counts) / 100 == pytest.approx(MISSED_SHARE, abs=0.02)


def test_embeddings_of_one_thing_are_at_cosine_0_8():
    room, views = build_room(4.0), walk(4, 160, 120)
    maker = MaskMaker(room, WordEncoder())
    seen = [maker.features(view) for view in views]
    again = MaskMaker(room, WordEncoder()).features(views[1])
    assert_array_equal(seen[1].embeddings, again.embeddings)
    floor = WordEncoder().encode_texts(["wooden floor"])[0]
    best = np.stack([f.embeddings[(f.embeddings @ floor).argmax()] for f in seen])
    cosines = (best @ best.T)[np.triu_indices(4, 1)]
    assert cosines.mean() == pytest.approx(0.8, abs=0.05)


def test_answers_are_right(story):
    wrong = {a.probe.text: a.iou for a in story.verdicts if not a.is_right}
    assert wrong == {}
    assert [a.probe for a in story.verdicts] == list(PROBES)
    absent = [a for a in story.verdicts if not a.probe.meant]
    assert not any(a.found for a in absent)


def test_iou_is_against_the_labels_of_the_scene_file(story):
    assert len(story.room.labels) == len(story.gaussians)
    mug = next(a for a in story.verdicts if a.probe.text == "red mug")
    truth = story.gaussians.means[story.room.members("red mug")]
    assert mug.center is not None
    assert_allclose(mug.center, (truth.min(0) + truth.max(0)) / 2, atol=0.03)


def test_intersection_over_union():
    a, b, none = np.array([1, 2, 3]), np.array([3, 4]), np.array([], np.int64)
    assert intersection_over_union(a, b) == 1 / 4
    assert intersection_over_union(a, none) == 0
    assert intersection_over_union(none, none) == 1
