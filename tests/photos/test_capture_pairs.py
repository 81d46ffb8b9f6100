"""Which pairs of photos are matched."""

import numpy as np

from drsplat.photos.capture.posing import (
    NEIGHBOURS_IN_LOOKS,
    NEIGHBOURS_IN_ORDER,
    looks_of,
    pairs_in_looks,
    pairs_in_order,
    pairs_in_place,
)


def test_photos_in_order_are_matched_with_the_next_ones_and_rarer_ones_far_away():
    pairs = pairs_in_order(1000)
    assert {(0, step) for step in (1, NEIGHBOURS_IN_ORDER, 24, 48, 768)} <= pairs
    assert (0, 500) not in pairs
    assert all(0 <= i < j < 1000 for i, j in pairs)
    assert pairs_in_order(2) == {(0, 1)}


def test_photos_in_place_are_matched_with_the_nearest():
    positions = np.full((201, 3), np.nan)
    positions[:200] = np.arange(200)[:, None] * [1.0, 0, 0]
    pairs = pairs_in_place(positions)
    assert {(i, i + 1) for i in range(199)} <= pairs
    assert max(j - i for i, j in pairs) <= 25
    assert not any(200 in pair for pair in pairs)
    assert pairs_in_place(np.full((5, 3), np.nan)) == set()


def test_photos_that_look_alike_are_matched():
    """Three places, each with its own descriptors, of which each photo shows a part: pairs stay within places."""
    rng = np.random.default_rng(0)
    places = rng.normal(size=(3, 400, 128)).astype(np.float32)
    places /= np.linalg.norm(places, axis=2, keepdims=True)

    def read(key):
        seen = rng.permutation(400)[:250]
        noisy = places[int(key) % 3, seen] + rng.normal(0, 0.01, (250, 128)).astype(np.float32)
        return np.asarray(noisy / np.linalg.norm(noisy, axis=1, keepdims=True), np.float32)

    looks = looks_of([str(key) for key in range(90)], read)
    pairs = pairs_in_looks(looks, 10)
    assert np.mean([(j - i) % 3 == 0 for i, j in pairs]) > 0.95
    assert len(pairs) <= 90 * 10


def test_a_photo_without_features_looks_like_nothing():
    empty = np.empty((0, 128), np.float32)
    some = np.eye(128, dtype=np.float32)
    looks = looks_of(["0", "1", "2"], lambda key: empty if key == "1" else some)
    assert not looks[1].any()
    assert pairs_in_looks(looks, NEIGHBOURS_IN_LOOKS) == {(0, 2)}
    assert looks_of(["0"], lambda key: empty).shape == (1, 1)
