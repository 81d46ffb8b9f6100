"""Photos with known poses to coloured points in the world."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ...base.arrays import Float64, Integer, UInt8
from ...scene.views import View
from .detecting import detect_all
from .keypoints import Keypoints, as_stored, located
from .matching import Matches, matches
from .meeting import meet
from .pairs import neighbours
from .tracks import Tracks, join

MAX_PHOTOS = 250  # more are thinned evenly, by name
MIN_PHOTOS_PER_POINT = 2


class Triangulation(NamedTuple):
    """Triangulated points of a capture.

    positions: in the world. colors: RGB, mean of the photos. photos: number compared. alike: number of pairs of similar
    keypoints. agreeing: number of those that the poses allow: nearly all where the poses are right, few where not.
    """

    positions: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    photos: int
    alike: int
    agreeing: int


def triangulate(views: Sequence[View], *, threads: int = 0) -> Triangulation:
    """Triangulate the scene's surfaces: return points where rays of the photos meet.

    Equal views give equal bits, at any number of threads. Memory is bounded by MAX_PHOTOS photos of at most
    MAX_KEYPOINTS each.

    Raises: InputError, FormatError: as `load_image`.
    Source: Hartley and Zisserman, "Multiple View Geometry" (2004), Ch. 9 and 12.
    """
    ordered = _thinned(sorted(views, key=lambda view: view.name))
    stored = [as_stored(view) for view in ordered]
    detected = detect_all(stored, threads=threads)
    photo_keypoints = [located(*args) for args in zip(ordered, stored, detected, strict=True)]
    pairs = neighbours(ordered)
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        matched = list(pool.map(lambda pair: _matches(ordered, photo_keypoints, pair), pairs))
    tracks = join([len(k.pixels) for k in photo_keypoints], pairs, [m.pairs for m in matched])
    positions, colors = _points(ordered, photo_keypoints, tracks)
    alike, agreeing = sum(m.alike for m in matched), sum(len(m.pairs) for m in matched)
    return Triangulation(positions, colors, len(ordered), alike, agreeing)


def _matches(views: Sequence[View], keypoints: Sequence[Keypoints], pair: Integer[np.ndarray, "2"]) -> Matches:
    first, second = pair
    return matches(views[first], keypoints[first], views[second], keypoints[second])


def _thinned(views: list[View]) -> list[View]:
    if len(views) <= MAX_PHOTOS:
        return views
    return [views[i] for i in np.linspace(0, len(views) - 1, MAX_PHOTOS).round().astype(int)]


def _points(
    views: Sequence[View], keypoints: Sequence[Keypoints], tracks: Tracks
) -> tuple[Float64[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    if len(tracks.tracks) == 0:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    rows = _rows(keypoints, tracks)
    pixels = np.concatenate([k.pixels for k in keypoints])[rows]
    colors = np.concatenate([k.colors for k in keypoints])[rows]
    points = meet(views, tracks, pixels, min(MIN_PHOTOS_PER_POINT, len(views)))
    return points.positions, _mean_colors(colors, tracks.tracks, points.used)[points.tracks]


def _rows(keypoints: Sequence[Keypoints], tracks: Tracks) -> Integer[np.ndarray, " o"]:
    """Return the row of each observation among the concatenated keypoints of all photos."""
    starts = np.concatenate([[0], np.cumsum([len(k.pixels) for k in keypoints])])
    rows: np.ndarray = starts[tracks.photos] + tracks.keypoints
    return rows


def _mean_colors(
    colors: UInt8[np.ndarray, "o 3"], tracks: Integer[np.ndarray, " o"], used: np.ndarray
) -> UInt8[np.ndarray, "n 3"]:
    """Return the mean colour of each track over the observations that are used."""
    count = int(tracks.max(initial=-1)) + 1
    counts = np.maximum(np.bincount(tracks[used], minlength=count), 1)
    sums = [np.bincount(tracks[used], channel[used], count) for channel in colors.T]
    means = np.stack(sums, axis=1) / counts[:, None]
    return np.rint(means).astype(np.uint8)
