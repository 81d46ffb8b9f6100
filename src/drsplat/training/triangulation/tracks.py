"""Tracks from the matches of pairs: all keypoints that show one place."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...base.arrays import Integer


class Tracks(NamedTuple):
    """Observations sorted by track, then photo: keypoint `keypoints[i]` of photo `photos[i]` shows `tracks[i]`."""

    tracks: Integer[np.ndarray, " o"]
    photos: Integer[np.ndarray, " o"]
    keypoints: Integer[np.ndarray, " o"]


def join(
    counts: Sequence[int], pairs: Integer[np.ndarray, "p 2"], matches: Sequence[Integer[np.ndarray, "_ 2"]]
) -> Tracks:
    """Join matched keypoints into tracks of two photos or more.

    counts: keypoints of each photo. pairs: photos compared. matches: of the keypoints of each pair.
    A photo with two keypoints in a track is ambiguous there, and leaves it.
    """
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    edges = [matched + starts[pair] for pair, matched in zip(pairs, matches, strict=True)]
    joined = np.concatenate(edges) if edges else np.empty((0, 2), np.int64)
    graph = coo_array((np.ones(len(joined), bool), joined.T), shape=(starts[-1], starts[-1]))
    of_keypoint = connected_components(graph, directed=False)[1]
    photos = np.repeat(np.arange(len(counts)), counts)
    order = np.lexsort((photos, of_keypoint))
    tracks, photos = of_keypoint[order], photos[order]
    chosen = _once(tracks, photos)
    chosen &= np.bincount(tracks[chosen], minlength=starts[-1])[tracks] >= 2
    numbered = np.unique(tracks[chosen], return_inverse=True)[1]
    return Tracks(numbered, photos[chosen], (order - starts[:-1][photos])[chosen])


def _once(tracks: np.ndarray, photos: np.ndarray) -> np.ndarray:
    """Return which observations are the only one of their photo in their track; both inputs are sorted."""
    repeated = np.zeros(len(tracks), bool)
    same = (np.diff(tracks) == 0) & (np.diff(photos) == 0)
    repeated[:-1] |= same
    repeated[1:] |= same
    return ~repeated
