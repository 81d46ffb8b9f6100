"""Points near a place of the Earth, in its longitude, latitude and height.

Source: WGS 84, NGA.STND.0036: semi-major axis and flattening; Bowring 1976 for the way back from geocentric ones.
"""

import numpy as np

from ..base.arrays import Matrix3, Points

EQUATOR_RADIUS_M, FLATTENING = 6_378_137.0, 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
LATITUDE_ITERATIONS = 6  # far more than are needed near the surface


def geodetic(origin: tuple[float, float, float], enu: Points) -> Points:
    """Return longitude and latitude in degrees and height in metres of points near an origin.

    origin: its longitude, latitude and height. enu: metres east, north and up of it.
    """
    return _from_geocentric(geocentric(np.array([origin]))[0] + enu @ enu_axes(origin))


def enu_axes(origin: tuple[float, float, float]) -> Matrix3:
    """Return rows east, north and up of an origin, in geocentric axes."""
    longitude, latitude = np.radians(origin[:2])
    sin_l, cos_l, sin_p, cos_p = np.sin(longitude), np.cos(longitude), np.sin(latitude), np.cos(latitude)
    east, north = (-sin_l, cos_l, 0.0), (-sin_p * cos_l, -sin_p * sin_l, cos_p)
    return np.array([east, north, (cos_p * cos_l, cos_p * sin_l, sin_p)])


def geocentric(positions: Points) -> Points:
    """Return metres from the centre of the Earth for longitudes and latitudes (degrees) and heights (metres)."""
    longitude, latitude = np.radians(positions[:, :2]).T
    height = positions[:, 2]
    normal = EQUATOR_RADIUS_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude) ** 2)
    around = (normal + height) * np.cos(latitude)
    z = (normal * (1 - ECCENTRICITY2) + height) * np.sin(latitude)
    return np.stack([around * np.cos(longitude), around * np.sin(longitude), z], axis=1)


def _from_geocentric(points: Points) -> Points:
    x, y, z = points.T
    around = np.hypot(x, y)
    latitude = np.arctan2(z, around * (1 - ECCENTRICITY2))
    for _ in range(LATITUDE_ITERATIONS):
        normal = EQUATOR_RADIUS_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + ECCENTRICITY2 * normal * np.sin(latitude), around)
    normal = EQUATOR_RADIUS_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude) ** 2)
    # of the two formulas for the height, the one that also holds at the poles
    height = around * np.cos(latitude) + z * np.sin(latitude) - EQUATOR_RADIUS_M**2 / normal
    return np.stack([np.degrees(np.arctan2(y, x)), np.degrees(latitude), height], axis=1)


def local_offsets(origin: tuple[float, float, float], positions: Points) -> Points:
    """Return metres east, north and up of an origin for longitudes, latitudes and heights; see `geodetic`."""
    return (geocentric(positions) - geocentric(np.array([origin]))[0]) @ enu_axes(origin).T
