"""Photos with known poses to coloured points in the world."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...base.arrays import (
    Colors,
    DoubleRows,
    Doubles,
    Float64,
    Integer,
    Matrix3,
    OtherDoubles,
    OtherFlags,
    PlanePoints,
    Points,
    RowIds,
    Vector3,
    WholeNumbers,
)
from ...scene.views import View
from .detecting import Keypoints, as_stored, detect_all, located

MAX_PHOTOS = 250  # more are thinned evenly, by name
MIN_PHOTOS_PER_POINT = 2
NEIGHBOUR_RANKS = (1, 2, 3, 5, 8, 12, 18)
"""Ranks of the neighbours to compare: the nearest share most, farther ones give depth."""
MAX_TURN_DEGREES = 60.0  # between two cameras' directions; SIFT does not match beyond
MAX_DISTANCE_RATIO = 0.8  # Lowe's ratio test: nearest over second nearest
MAX_EPIPOLAR_SHARE = 1 / 320  # of the photo's longer side; 2 pixels of 640
TOLERANCE_FACTORS = (16, 4, 1)  # by round: an outlier moves the first point off all rays
MAX_REPROJECTION_SHARE = 1 / 320  # of the photo's longer side; 2 pixels of 640
MIN_ANGLE_DEGREES = 1.5  # between the outermost rays and their middle; depth is a guess below
MIN_DETERMINANT = 1e-9


class Tracks(NamedTuple):
    """Observations sorted by track, then photo: keypoint `keypoints[i]` of photo `photos[i]` shows `tracks[i]`."""

    tracks: WholeNumbers
    photos: WholeNumbers
    keypoints: WholeNumbers


class Triangulation(NamedTuple):
    """Triangulated points of a capture.

    positions: in the world. colors: RGB, mean of the photos. photos: number compared. alike: number of pairs of similar
    keypoints. agreeing: number of those that the poses allow: nearly all where the poses are right, few where not.
    """

    positions: Points
    colors: Colors
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
    ordered = sorted(views, key=lambda view: view.name)
    if len(ordered) > MAX_PHOTOS:
        ordered = [ordered[i] for i in np.linspace(0, len(ordered) - 1, MAX_PHOTOS).round().astype(int)]
    stored = [as_stored(view) for view in ordered]
    detected = detect_all(stored, threads=threads)
    photo_keypoints = [located(*args) for args in zip(ordered, stored, detected, strict=True)]
    pairs = neighbours(ordered)
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        sides = [zip([ordered[i] for i in ids], [photo_keypoints[i] for i in ids], strict=True) for ids in pairs.T]
        matched = list(pool.map(lambda a, b: matches(*a, *b), *sides))
    agreeing, alike = zip(*matched, strict=True) if matched else ((), ())
    tracks = join([len(k.pixels) for k in photo_keypoints], pairs, agreeing)
    positions, colors = _points(ordered, photo_keypoints, tracks)
    return Triangulation(positions, colors, len(ordered), sum(alike), sum(map(len, agreeing)))


def _points(views: Sequence[View], keypoints: Sequence[Keypoints], tracks: Tracks) -> tuple[Points, Colors]:
    if len(tracks.tracks) == 0:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    # the row of each observation among the concatenated keypoints of all photos
    starts = np.concatenate([[0], np.cumsum([len(k.pixels) for k in keypoints])])
    rows: np.ndarray = starts[tracks.photos] + tracks.keypoints
    pixels = np.concatenate([k.pixels for k in keypoints])[rows]
    colors = np.concatenate([k.colors for k in keypoints])[rows]
    points = meet(views, tracks, pixels, min(MIN_PHOTOS_PER_POINT, len(views)))
    # the mean colour of each track over the observations that are used
    count = int(tracks.tracks.max(initial=-1)) + 1
    counts = np.maximum(np.bincount(tracks.tracks[points.used], minlength=count), 1)
    sums = [np.bincount(tracks.tracks[points.used], channel[points.used], count) for channel in colors.T]
    means = np.stack(sums, axis=1) / counts[:, None]
    return points.positions, np.rint(means).astype(np.uint8)[points.tracks]


def neighbours(views: Sequence[View]) -> Integer[np.ndarray, "p 2"]:
    """Return the sorted pairs of indices of the views to compare, the smaller index first."""
    centers = np.array([view.center for view in views])
    directions = np.array([view.cam_from_world[2, :3] for view in views])
    pairs: set[tuple[int, int]] = set()
    for index in range(len(views)):
        # the other cameras that look about the same way, nearest first
        alike = directions @ directions[index] > np.cos(np.radians(MAX_TURN_DEGREES))
        alike[index] = False
        others = np.flatnonzero(alike)
        distances = np.linalg.norm(centers[others] - centers[index], axis=1)
        by_distance = others[np.argsort(distances, kind="stable")]
        for rank in NEIGHBOUR_RANKS:
            if rank <= len(by_distance):
                other = int(by_distance[rank - 1])
                pairs.add((min(index, other), max(index, other)))
    return np.array(sorted(pairs), np.int64).reshape(-1, 2)


def matches(first: View, a: Keypoints, second: View, b: Keypoints) -> tuple[Integer[np.ndarray, "m 2"], int]:
    """Match mutually nearest descriptors; return the pairs that the poses allow, and the number of all."""
    pairs = _alike(a, b)
    # which pairs lie on each other's epipolar lines, to `MAX_EPIPOLAR_SHARE` of the photo's longer side
    x = a.pixels[pairs[:, 0]]
    fundamental = fundamental_matrix(first, second)
    homogeneous = [np.concatenate([points, np.ones((len(points), 1))], axis=1) for points in (x, b.pixels[pairs[:, 1]])]
    in_second, in_first = homogeneous[0] @ fundamental.T, homogeneous[1] @ fundamental
    residuals = np.abs((homogeneous[1] * in_second).sum(1))
    fits = np.ones(len(x), bool)
    for lines, view in ((in_second, second), (in_first, first)):
        tolerance = MAX_EPIPOLAR_SHARE * max(view.size)
        fits &= residuals <= tolerance * np.linalg.norm(lines[:, :2], axis=1)
    return pairs[fits], len(pairs)


def _alike(a: Keypoints, b: Keypoints) -> Integer[np.ndarray, "m 2"]:
    """Return pairs of mutual nearest neighbours that pass the ratio test.  Source: Lowe 2004, Sec. 7.1."""
    if len(a.descriptors) < 2 or len(b.descriptors) < 2:
        return np.empty((0, 2), np.int64)
    # compute squared distances of all descriptors. Exact in float32: integers below 2**24.
    left, right = a.descriptors.astype(np.float32), b.descriptors.astype(np.float32)
    distances2: np.ndarray = (left**2).sum(1)[:, None] + (right**2).sum(1) - 2 * (left @ right.T)
    forward, backward = _nearest(distances2), _nearest(distances2.T)
    (mutual,) = np.nonzero((forward >= 0) & (backward[forward] == np.arange(len(forward))))
    return np.stack([mutual, forward[mutual]], axis=1)


def _nearest(distances2: np.ndarray) -> WholeNumbers:
    """Return each row's nearest neighbour, or -1 where Lowe's ratio test fails."""
    rows, best = np.arange(len(distances2)), distances2.argmin(1)
    others = distances2.copy()
    others[rows, best] = np.inf
    return np.where(distances2[rows, best] < MAX_DISTANCE_RATIO**2 * others.min(1), best, -1)


def fundamental_matrix(first: View, second: View) -> Matrix3:
    """Return F with y^T F x = 0 for pixels x of the first and y of the second view that show one point.

    Source: Hartley and Zisserman, "Multiple View Geometry" (2004), Eq. 9.2.
    """
    relative = second.cam_from_world[:3, :3] @ first.cam_from_world[:3, :3].T
    x, y, z = second.cam_from_world[:3, :3] @ (first.center - second.center)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    essential = cross @ relative
    inverses = [np.linalg.inv(view.K) for view in (first, second)]
    return inverses[1].T @ essential @ inverses[0]


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
    # which observations are the only one of their photo in their track; both inputs are sorted
    repeated = np.zeros(len(tracks), bool)
    same = (np.diff(tracks) == 0) & (np.diff(photos) == 0)
    repeated[:-1] |= same
    repeated[1:] |= same
    chosen = ~repeated
    chosen &= np.bincount(tracks[chosen], minlength=starts[-1])[tracks] >= 2
    numbered = np.unique(tracks[chosen], return_inverse=True)[1]
    return Tracks(numbered, photos[chosen], (order - starts[:-1][photos])[chosen])


class Met(NamedTuple):
    """Triangulated points. tracks: the track of each. used: the observations that agree with their track's point."""

    positions: Points
    tracks: WholeNumbers
    used: OtherFlags


def meet(views: Sequence[View], tracks: Tracks, pixels: PlanePoints, least: int) -> Met:
    """Triangulate each track, and return the points that at least `least` observations agree on.

    pixels: of each observation. In rounds of falling tolerance, observations that are off by more leave their track;
    the point then minimises the sum of squared distances to the rays, each over its depth.
    Source: the linear-Eigen triangulation's geometric twin, Hartley and Zisserman, Sec. 12.2; weights ours.
    """
    mean_center = np.mean([view.center for view in views], axis=0)
    centers, directions, slopes = _rays(views, tracks.photos, pixels, mean_center)
    count = int(tracks.tracks.max(initial=-1)) + 1
    used, weights = np.ones(len(pixels), bool), np.ones(len(pixels))
    for factor in (*TOLERANCE_FACTORS, TOLERANCE_FACTORS[-1]):
        positions = _nearest_to_rays(centers, directions, tracks.tracks, weights, count)
        # the depth of each point along its ray, and its distance from the ray over the depth (NaN stays)
        to_point = positions[tracks.tracks] - centers
        depths = (to_point * directions).sum(1)
        aside = np.linalg.norm(to_point - depths[:, None] * directions, axis=1)
        errors = aside / np.maximum(depths, MIN_DETERMINANT)
        before, used = used, (depths > 0) & (errors <= factor * slopes)
        weights = np.where(used, 1 / np.maximum(depths, MIN_DETERMINANT) ** 2, 0)
    used &= before
    enough = np.bincount(tracks.tracks[used], minlength=count) >= least
    # each track's largest angle between a ray and the mean of all, in radians
    means = _summed(directions * used[:, None], tracks.tracks, count)
    means /= np.maximum(np.linalg.norm(means, axis=1, keepdims=True), MIN_DETERMINANT)
    sines = np.linalg.norm(np.cross(directions, means[tracks.tracks]), axis=1)
    largest = np.zeros(count)
    np.maximum.at(largest, tracks.tracks[used], np.arcsin(np.minimum(sines[used], 1)))
    enough &= largest >= np.radians(MIN_ANGLE_DEGREES)
    return Met(positions[enough] + mean_center, np.flatnonzero(enough), used)


def _rays(
    views: Sequence[View], photos: WholeNumbers, pixels: PlanePoints, mean_center: Vector3
) -> tuple[Points, Points, Doubles]:
    """Return the centers and directions of rays by observation, and tolerances as slopes.

    Centers are counted from the mean camera, so that a scene may lie far from its origin. A slope is of the tolerated
    pixels over the focal length.
    """
    homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
    to_world = np.array([view.cam_from_world[:3, :3].T @ np.linalg.inv(view.K) for view in views])
    directions = np.einsum("oij,oj->oi", to_world[photos], homogeneous)
    centers = np.array([view.center - mean_center for view in views])
    slopes = np.array([MAX_REPROJECTION_SHARE * max(v.size) / v.K[0, 0] for v in views])
    return centers[photos], directions / np.linalg.norm(directions, axis=1, keepdims=True), slopes[photos]


def _nearest_to_rays(
    centers: Points, directions: Points, tracks: RowIds, weights: OtherDoubles, count: int
) -> Float64[np.ndarray, "t 3"]:
    """Return each track's point nearest to its rays; NaN where they are parallel or all weights are 0."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    across *= weights[:, None, None]
    matrices = _summed(across.reshape(-1, 9), tracks, count).reshape(-1, 3, 3)
    sides = _summed(np.einsum("oij,oj->oi", across, centers), tracks, count)
    scale = np.trace(matrices, axis1=1, axis2=2)
    solvable = np.linalg.det(matrices) > MIN_DETERMINANT * scale**3
    positions = np.full((count, 3), np.nan)
    positions[solvable] = np.linalg.solve(matrices[solvable], sides[solvable][..., None])[..., 0]
    return positions


def _summed(values: Float64[np.ndarray, "m k"], tracks: RowIds, count: int) -> DoubleRows:
    """Sum values by track, in the order of the observations."""
    columns = [np.bincount(tracks, column, minlength=count) for column in values.T]
    return np.stack(columns, axis=1)
