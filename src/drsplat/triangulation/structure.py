"""Photos of known poses -> points in the world, with colours."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..arrays import Float64, Integer, UInt8
from ..scene.views import View
from .detecting import detect_all
from .keypoints import Keypoints, as_stored, located
from .matching import Matches, matches
from .meeting import meet
from .pairs import neighbours
from .tracks import Tracks, join

MOST_PHOTOS = 250  # more are thinned evenly, by name
LEAST_PHOTOS = 2  # of a point


class Triangulation(NamedTuple):
    """positions: world. colors: RGB, the photos' mean. photos: compared. alike: pairs of keypoints that look
    alike. agreeing: of them, those that the poses allow: nearly all where the poses are right, few where not.
    """

    positions: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    photos: int
    alike: int
    agreeing: int


def triangulate(views: Sequence[View], *, threads: int = 0) -> Triangulation:
    """What the photos show of the scene's surfaces: points where their rays meet.

    Equal views give equal bits, at any number of threads. Memory is bounded by MOST_PHOTOS photos of at most MOST
    keypoints.

    Raises: InputError, FormatError: as `load_image`.
    Source: Hartley and Zisserman, "Multiple View Geometry" (2004), Ch. 9 and 12.
    """
    ordered = _thinned(sorted(views, key=lambda view: view.name))
    stored = [as_stored(view) for view in ordered]
    detected = detect_all(stored, threads=threads)
    found = [located(*one) for one in zip(ordered, stored, detected, strict=True)]
    pairs = neighbours(ordered)
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        matched = list(pool.map(lambda pair: _matches(ordered, found, pair), pairs))
    tracks = join([len(f.pixels) for f in found], pairs, [m.pairs for m in matched])
    positions, colors = _points(ordered, found, tracks)
    alike, agreeing = sum(m.alike for m in matched), sum(len(m.pairs) for m in matched)
    return Triangulation(positions, colors, len(ordered), alike, agreeing)


def _matches(views: Sequence[View], found: Sequence[Keypoints], pair: Integer[np.ndarray, "2"]) -> Matches:
    first, second = pair
    return matches(views[first], found[first], views[second], found[second])


def _thinned(views: list[View]) -> list[View]:
    if len(views) <= MOST_PHOTOS:
        return views
    return [views[i] for i in np.linspace(0, len(views) - 1, MOST_PHOTOS).round().astype(int)]


def _points(
    views: Sequence[View], found: Sequence[Keypoints], tracks: Tracks
) -> tuple[Float64[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    if len(tracks.tracks) == 0:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    rows = _rows(found, tracks)
    pixels = np.concatenate([f.pixels for f in found])[rows]
    colors = np.concatenate([f.colors for f in found])[rows]
    points = meet(views, tracks, pixels, min(LEAST_PHOTOS, len(views)))
    return points.positions, _mean_colors(colors, tracks.tracks, points.used)[points.tracks]


def _rows(found: Sequence[Keypoints], tracks: Tracks) -> Integer[np.ndarray, " o"]:
    """Of each observation among all keypoints in a row."""
    starts = np.concatenate([[0], np.cumsum([len(f.pixels) for f in found])])
    rows: np.ndarray = starts[tracks.photos] + tracks.keypoints
    return rows


def _mean_colors(
    colors: UInt8[np.ndarray, "o 3"], tracks: Integer[np.ndarray, " o"], used: np.ndarray
) -> UInt8[np.ndarray, "n 3"]:
    count = int(tracks.max(initial=-1)) + 1
    times = np.maximum(np.bincount(tracks[used], minlength=count), 1)
    sums = [np.bincount(tracks[used], channel[used], count) for channel in colors.T]
    means = np.stack(sums, axis=1) / times[:, None]
    return np.rint(means).astype(np.uint8)
