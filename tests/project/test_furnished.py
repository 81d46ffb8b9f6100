"""The furnished room is what it says, its masks err as documented, and its answers are right."""

import numpy as np
from numpy.testing import assert_array_equal
from world.cameras import look_at

from drsplat.kernels import splat_arrays, topk_contributions
from furnished.masks import exact_labels
from furnished.probes import PROBES
from furnished.room import INVENTORY, build_room


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


def test_answers_are_right(story):
    wrong = {a.probe.text: a.iou for a in story.verdicts if not a.is_right}
    assert wrong == {}
    assert [a.probe for a in story.verdicts] == list(PROBES)
    absent = [a for a in story.verdicts if not a.probe.meant]
    assert not any(a.found for a in absent)
