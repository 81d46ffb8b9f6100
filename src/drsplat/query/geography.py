"""Boxes on the Earth: where a georeferenced scene's places are in longitude, latitude and height."""

from typing import Any

import numpy as np

from ..base.arrays import Float64
from ..formats.georeference import Georeference

CORNER_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
DEGREE_DECIMALS, HEIGHT_DECIMALS = 9, 4  # a ten-thousandth of a metre


def earth_document(
    georeference: Georeference | None,
    center: Float64[np.ndarray, " 3"],
    axes: Float64[np.ndarray, "3 3"],
    extent: Float64[np.ndarray, " 3"],
) -> dict[str, Any]:
    """Return the position of a box's centre and its footprint, in WGS 84; nothing without a georeference.

    The footprint is a polygon as GeoJSON has it (RFC 7946): what the box covers seen from above, anticlockwise and
    closed, at the height of its lowest corner.
    """
    if georeference is None:
        return {}
    corners = center + CORNER_SIGNS * extent / 2 @ axes
    local = corners @ georeference.enu_from_world.T
    outline = hull(local[:, :2])
    ring = local[[*outline, outline[0]]]
    ring[:, 2] = local[:, 2].min()
    places = georeference.positions(np.vstack([center, ring @ georeference.enu_from_world]))
    here, *footprint = [_rounded(place) for place in places]
    return {
        "position": dict(zip(("longitude", "latitude", "height"), here, strict=True)),
        "footprint": {"type": "Polygon", "coordinates": [footprint]},
    }


def hull(points: Float64[np.ndarray, "n 2"]) -> list[int]:
    """Return the points at the corners of their convex hull, anticlockwise.

    Source: Andrew 1979, monotone chain.
    """
    order = np.lexsort((points[:, 1], points[:, 0])).tolist()
    return _chain(points, order)[:-1] + _chain(points, order[::-1])[:-1]


def _chain(points: Float64[np.ndarray, "n 2"], order: list[int]) -> list[int]:
    chain: list[int] = []
    for number in order:
        while len(chain) > 1 and _turn(points[chain[-2]], points[chain[-1]], points[number]) <= 0:
            chain.pop()
        chain.append(number)
    return chain


def _turn(one: np.ndarray, two: np.ndarray, three: np.ndarray) -> float:
    """Return a number above 0 where the way from one to two turns left towards three."""
    (a, b), (c, d) = two - one, three - one
    return float(a * d - b * c)


def _rounded(place: Float64[np.ndarray, " 3"]) -> list[float]:
    longitude, latitude, height = place.tolist()
    return [round(longitude, DEGREE_DECIMALS), round(latitude, DEGREE_DECIMALS), round(height, HEIGHT_DECIMALS)]
