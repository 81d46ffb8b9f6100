"""How things lie to each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Float64
from ..errors import InputError
from ..scene.boxes import solid
from ..scene.parted import AnyGaussians
from .answer import Match
from .contact import rests_on
from .query import Query

if TYPE_CHECKING:
    from .scene import Scene

MAX_OVERHANG_SHARE = 0.05  # of a thing's size, that its middle may stand out of what it is over


def gap(gaussians: AnyGaussians, one: Match, other: Match) -> float:
    """Return the distance between the nearest solid Gaussians of two things, centre to centre, in scene units."""
    first, second = solid_centers(gaussians, one), solid_centers(gaussians, other)
    small, large = (first, second) if len(first) < len(second) else (second, first)
    return float(cKDTree(large).query(small)[0].min())


def standing_on(scene: Scene, matches: Sequence[Match], query: Query | str) -> list[Match]:
    """Return the matches that stand on a sure match of a query.

    Raises: InputError: nothing is called so, or the photos do not tell which way is up.
    """
    supports = [one for one in scene.locate(query) if one.sure]
    if not supports:
        text = query if isinstance(query, str) else query.text or ""
        raise InputError(f"no match for '{text[:60]}', so nothing can stand on it")
    gaussians, up = scene.rows, scene.up
    if up is None:
        raise InputError("the photos of this scene do not tell which way is up: query without 'on'")
    return [one for one in matches if any(stands_on(gaussians, one, support, up) for support in supports)]


def stands_on(gaussians: AnyGaussians, thing: Match, support: Match, up: Float64[np.ndarray, " 3"]) -> bool:
    """Return whether a thing rests on another one, by contact of their Gaussians; see `contact.rests_on`."""
    return rests_on(gaussians, thing.gaussian_ids, support.gaussian_ids, up)


def is_over(
    above: Float64[np.ndarray, "m 3"], below: Float64[np.ndarray, "n 3"], up: Float64[np.ndarray, " 3"]
) -> bool:
    """Return True if the middle of some points is over others, seen from above: within a twentieth of their size."""
    flat = np.eye(3) - np.outer(up, up)
    size = float(np.linalg.norm(np.ptp(below @ flat, axis=0)))
    distance = cKDTree(below @ flat).query(above.mean(0) @ flat)[0]
    return bool(distance <= MAX_OVERHANG_SHARE * size)


def solid_centers(gaussians: AnyGaussians, thing: Match) -> Float64[np.ndarray, "n 3"]:
    """Return the centres of what can be seen of a thing."""
    return gaussians.shapes_of(solid(gaussians, thing.gaussian_ids)).positions
