"""Which pairs of photos are matched."""

import numpy as np

from drsplat.photos.capture.posing import (
    BEST_LARGE_MATCHES,
    NEIGHBOURS_IN_LOOKS,
    NEIGHBOURS_IN_ORDER,
    looks_of,
    pairs_in_large_features,
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


def sift(rng, count):
    """Return random descriptors as COLMAP stores them: of length 512, whole numbers."""
    values = rng.gamma(0.3, size=(count, 128))
    return np.round(512 * values / np.linalg.norm(values, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)


def test_photos_that_look_alike_are_matched():
    """Three places, each with its own descriptors, of which each photo shows a part: pairs stay within places."""
    rng = np.random.default_rng(0)
    places = [sift(rng, 400) for _ in range(3)]

    def read(key):
        seen = places[int(key) % 3][rng.permutation(400)[:250]]
        return np.maximum(seen, rng.integers(0, 10, seen.shape, np.uint8))

    looks = looks_of([str(key) for key in range(90)], read)
    pairs = pairs_in_looks(looks, 10)
    assert np.mean([(j - i) % 3 == 0 for i, j in pairs]) > 0.95
    assert len(pairs) <= 90 * 10


def test_a_photo_without_features_looks_like_nothing():
    empty = np.empty((0, 128), np.uint8)
    some = np.eye(128, dtype=np.uint8)
    looks = looks_of(["0", "1", "2"], lambda key: empty if key == "1" else some)
    assert not looks[1].any()
    assert pairs_in_looks(looks, NEIGHBOURS_IN_LOOKS) == {(0, 2)}
    assert looks_of(["0"], lambda key: empty).shape == (1, 1)


def test_pairs_whose_largest_features_match_are_kept_and_the_best_of_each_photo():
    """Two places, 20 photos of each; photo 40 shares five features with one alone, 41 has none."""
    rng = np.random.default_rng(0)
    places = [sift(rng, 30) for _ in range(2)]
    photos = [np.concatenate([sift(rng, 40), rng.permutation(places[k % 2])]) for k in range(40)]
    photos += [np.concatenate([sift(rng, 40), photos[7][-5:]]), np.empty((0, 128), np.uint8)]
    pairs = pairs_in_large_features(photos)
    assert {(i, j) for i in range(40) for j in range(i + 2, 40, 2)} <= pairs
    assert (7, 40) in pairs
    assert sum((i + j) % 2 for i, j in pairs if j < 40) == 0
    assert len(pairs) <= 2 * 190 + 2 * BEST_LARGE_MATCHES
    swapped = pairs_in_large_features(photos[::-1])
    alike = {(41 - j, 41 - i) for i, j in swapped if min(i, j) > 1}
    assert alike == {(i, j) for i, j in pairs if j < 40}
