"""World of a capture, which is upright and, where the photos or people give a scale, in metres.

+z is up. Where the photos say where on the Earth they were taken, +x is east and +y north, in metres.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ...base.arrays import Doubles, Matrix3, Points, Vector3
from ...errors import InputError
from ...formats.georeference import Georeference
from ...scene.boxes import upward
from ...scene.geodesy import geocentric, local_offsets
from ...scene.similarity import Similarity
from ...scene.views import View
from .photos import ExifFacts

MIN_GPS_PHOTOS = 4
MAX_RESIDUAL_SHARE = 0.2  # of the spread of the GPS positions: noise in a room is larger than the room
MIN_SPREAD_RESIDUALS = 3.0  # of positions to the side of a line: with less, GPS does not say which way is up
MAX_INLIER_MEDIANS = 4.0  # residual over the median one
RANSAC_TRIES = 200
RANSAC_SAMPLE = 4
REFIT_ROUNDS = 5
MAX_GRAVITY_SPREAD_DEGREES = 10.0  # median angle to the mean
DEFAULT_MEDIAN_DEPTH = 4.0  # units from a camera to the points it sees, where the scale is unknown


@dataclass(frozen=True)
class World:
    """World of a capture: `similarity` maps COLMAP's world to it.

    unit: "m" or "units". up_from: "GPS", "gravity", "horizons" or "" (unknown). scale_from: "GPS", "scale",
    "known distance" or "". georeference: where its zero is on the Earth. residual_m: median distance of the cameras
    from their GPS positions, None without. scale_factor: product of the scales that people gave.
    """

    similarity: Similarity
    unit: str
    up_from: str
    scale_from: str
    georeference: Georeference | None = None
    residual_m: float | None = None
    scale_factor: float = 1.0


def world_of(views: Sequence[View], facts: Mapping[str, ExifFacts], depth: float) -> World:
    """Return the world that follows from the photos' facts.

    views: posed by COLMAP. facts: by their names. depth: median depth of the points in the cameras that saw them.
    """
    up, up_from = _gravity_up(views, facts), "gravity"
    if up is None:
        up_from = ""
        with suppress(InputError):
            up, up_from = upward(views), "horizons"
    rotation = np.eye(3)
    if up is not None:  # `up` is +z, and the first camera's right +x
        across = max(
            (axis - (axis @ up) * up for axis in views[0].cam_from_world[:3, :3]),
            key=lambda axis: float(np.linalg.norm(axis)),
        )
        right = across / np.linalg.norm(across)
        rotation = np.stack([right, np.cross(up, right), up])
    fit = _gps_fit(views, facts, rotation)
    if fit is not None:
        return fit if fit.up_from else replace(fit, up_from=up_from)
    center = np.mean([view.center for view in views], axis=0)
    scale = DEFAULT_MEDIAN_DEPTH / depth if depth > 0 else 1.0
    return World(Similarity(scale, rotation, -scale * rotation @ center), "units", up_from, "")


def with_scale(world: World, factor: float, source: str) -> World:
    """Return the world with lengths times `factor`, in metres; its zero on the Earth stays where it is."""
    old = world.similarity
    similarity = Similarity(old.scale * factor, old.rotation, old.translation * factor)
    return replace(world, similarity=similarity, unit="m", scale_from=source, scale_factor=factor)


def _gravity_up(views: Sequence[View], facts: Mapping[str, ExifFacts]) -> Vector3 | None:
    """Return the mean upward direction of the photos' accelerometers; None where they disagree or are missing."""
    downs = [(view, facts[view.name].down) for view in views]
    ups = np.array([-view.cam_from_world[:3, :3].T @ np.array(down) for view, down in downs if down is not None])
    if len(ups) < max(2, len(views) / 4):
        return None
    mean = ups.mean(0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    spread = np.degrees(np.median(np.arccos(np.clip(ups @ mean, -1, 1))))
    return mean if spread <= MAX_GRAVITY_SPREAD_DEGREES else None


def _gps_fit(views: Sequence[View], facts: Mapping[str, ExifFacts], upright: Matrix3) -> World | None:
    """Return the world in metres east, north and up; None where GPS is missing or coarser than the scene."""
    placed = [view for view in views if (at := facts[view.name].position) is not None and at[2] is not None]
    if len(placed) < MIN_GPS_PHOTOS:
        return None
    places = np.array([facts[view.name].position for view in placed], np.float64)
    round_earth = geocentric(places)
    middle_one = np.linalg.norm(round_earth - np.median(round_earth, axis=0), axis=1).argmin()
    origin = (float(places[middle_one, 0]), float(places[middle_one, 1]), float(places[middle_one, 2]))
    offsets = local_offsets(origin, places)
    centers = np.array([view.center for view in placed])
    similarity, residuals = _robust_similarity(centers, offsets)
    middle = float(np.median(residuals))
    trusted = offsets[residuals <= MAX_INLIER_MEDIANS * middle]
    spread = np.linalg.svd(trusted - trusted.mean(0), compute_uv=False) / np.sqrt(len(trusted))
    if middle > MAX_RESIDUAL_SHARE * spread[0]:
        return None
    up_from = "GPS"
    if spread[1] < MIN_SPREAD_RESIDUALS * middle:  # a straight walk: the fit can turn about it
        # the best similarity that keeps +z of `upright` up; it turns about that axis only
        a = (centers - centers.mean(0)) @ upright.T
        b = offsets - offsets.mean(0)
        cosine, sine = (a[:, :2] * b[:, :2]).sum(), (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
        angle = np.arctan2(sine, cosine)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        scale = float(np.hypot(cosine, sine) / max(float((a[:, :2] ** 2).sum()), 1e-30))
        rotation = turn @ upright
        similarity, up_from = Similarity(scale, rotation, offsets.mean(0) - scale * rotation @ centers.mean(0)), ""
        middle = float(np.median(_distances(similarity, centers, offsets)))
    georeference = Georeference(*origin, np.eye(3), 1.0)
    return World(similarity, "m", up_from, "GPS", georeference, middle)


def _robust_similarity(source: Points, target: Points) -> tuple[Similarity, Doubles]:
    """Return the similarity from source to target without the influence of outliers, and all distances after it.

    It begins with the best of many that are fitted to four pairs each: least median of squares.
    """
    rng = np.random.default_rng(0)
    tries = [rng.choice(len(source), min(RANSAC_SAMPLE, len(source)), replace=False) for _ in range(RANSAC_TRIES)]
    starts = [umeyama(source[sample], target[sample]) for sample in tries]
    similarity = min(starts, key=lambda start: float(np.median(_distances(start, source, target))))
    for _ in range(REFIT_ROUNDS):
        residuals = _distances(similarity, source, target)
        inliers = residuals <= MAX_INLIER_MEDIANS * np.median(residuals)
        similarity = umeyama(source[inliers], target[inliers])
    return similarity, _distances(similarity, source, target)


def _distances(similarity: Similarity, source: Points, target: Points) -> Doubles:
    return np.asarray(np.linalg.norm(similarity.positions(source) - target, axis=1))


def umeyama(source: Points, target: Points) -> Similarity:
    """Return the similarity with the least squared distances.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991.
    """
    a, b = source - source.mean(0), target - target.mean(0)
    u, stretch, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(signs) @ vt
    scale = float((stretch * signs).sum() / max(float((a**2).sum()), 1e-30))
    return Similarity(scale, rotation, target.mean(0) - scale * rotation @ source.mean(0))
