"""Length of a metre, from people: a factor, or a distance between two places that they see in photos."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Doubles, PlanePoints, Vector3
from ...errors import FormatError, InputError, did_you_mean
from ...formats.captures import read_rows
from ...formats.photo_files import listed
from .program import ask_colmap

MAX_AWAY_SHARE = 0.05  # of the photo's diagonal: points farther from the pixel say nothing about it
MAX_SURFACE_POINTS = 12  # nearest to the pixel, which define the surface there
MIN_PLANE_POINTS = 5
MIN_GAP_SHARE = 0.05  # of the depth: points farther behind are of another surface
MIN_FRONT_POINTS = 2
MIN_ANGLE_DEGREES = 2.0  # between two rays of a marker
MAX_ERROR_DEGREES = 1.0  # between a marker's pixel and the projection of its place
HEADER = ("name", "photo", "x", "y")


class Place(NamedTuple):
    """Pixel (x right, y down, from the upper left corner) of an upright photo in its full size."""

    photo: str
    x: float
    y: float


class Marker(NamedTuple):
    """Named place, by its pixels in one photo or more."""

    name: str
    seen: tuple[Place, ...]


def read_places(path: Path) -> dict[str, Marker]:
    """Read a table of markers: the line "name,photo,x,y", then a line for each photo that shows a marker.

    Raises: InputError: there is no such file. FormatError: another table, or a marker twice in a photo.
    """
    seen: dict[str, dict[str, Place]] = {}
    for number, row in enumerate(read_rows(path, HEADER, "a marker's pixel"), 2):
        where = f"{path}, line {number}"
        try:
            name, photo, x, y = (cell.strip() for cell in row)
            place = Place(photo, float(x), float(y))
        except ValueError:
            name, place = "", Place("", 0.0, 0.0)
        if not (name and place.photo and math.isfinite(place.x) and math.isfinite(place.y)):
            raise FormatError(f"{where}: expected a name, a photo and two numbers, got {ascii(','.join(row))[:80]}")
        if place.photo in seen.setdefault(name, {}):
            raise FormatError(f"{where}: '{name}' is in {place.photo} twice")
        seen[name][place.photo] = place
    return {name: Marker(name, tuple(places.values())) for name, places in seen.items()}


def marker_named(name: str, markers: dict[str, Marker]) -> Marker:
    """Return a marker. Raises: InputError: there is none of that name."""
    if name not in markers:
        near = did_you_mean(name, markers)
        raise InputError(f"the table of places has no '{name}': it has {listed(sorted(markers)) or 'no place'}.{near}")
    return markers[name]


@dataclass(frozen=True)
class KnownDistance:
    """Two places and the metres between them.

    Raises: InputError: a distance that is not above 0.
    """

    one: Place | Marker
    other: Place | Marker
    metres: float

    def __post_init__(self) -> None:
        if not 0 < self.metres < np.inf:
            raise InputError(f"known_distance: expected metres above 0, got {self.metres:g}")


def units_between(distance: KnownDistance, model: Path, log: Path, names: dict[str, str]) -> float:
    """Return the distance of two places in the units of a model.

    names: in the model, by the names of photos that people use.

    Raises: InputError: a photo without a pose, a pixel that is not on it or near no point, pixels of a marker that are
    not of one place, or a distance of 0.
    """
    start, end = (_position(place, model, log, names) for place in (distance.one, distance.other))
    units = float(np.linalg.norm(start - end))
    if not units > 0:
        raise InputError("known_distance: both places are one: name two that are apart")
    return units


def _position(place: Place | Marker, model: Path, log: Path, names: dict[str, str]) -> Vector3:
    """Return the world position of a place: where its rays meet; a single ray ends at the points around its pixel."""
    pixels = place.seen if isinstance(place, Marker) else (place,)
    places = [pixel for pixel in pixels if pixel.photo in names]
    if not places:
        photos = listed([f"'{pixel.photo}'" for pixel in pixels], 3)
        which = f"the photo {photos} has no pose" if len(pixels) == 1 else f"none of the photos {photos} has a pose"
        raise InputError(f"known_distance: {which}: name one that has")
    requests = [[names[pixel.photo], [pixel.x, pixel.y]] for pixel in places]
    looks = ask_colmap("look", log, model=str(model), places=requests)
    for pixel, look in zip(places, looks, strict=True):
        width, height = look["size"]
        if not (0 <= pixel.x <= width and 0 <= pixel.y <= height):
            raise InputError(
                f"known_distance: ({pixel.x:g}, {pixel.y:g}) is not on {pixel.photo}, which is {width}x{height} upright"
            )
    if len(places) == 1:
        return _on_surface(places[0], looks[0])
    return _meeting(f"'{place.name}'" if isinstance(place, Marker) else place.photo, looks)


def _meeting(name: str, looks: Sequence[dict[str, Any]]) -> Vector3:
    """Return the place that is nearest to all rays.

    Raises: InputError: they are nearly parallel, or miss each other.
    """
    centers = np.array([look["center"] for look in looks])
    rays = np.array([look["ray"] for look in looks])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    if float(np.linalg.eigvalsh(across.sum(0))[0]) < len(looks) * np.radians(MIN_ANGLE_DEGREES) ** 2 / 4:
        raise InputError(
            f"known_distance: the photos of {name} were taken from nearly one direction, which tells no depth: give "
            "its pixel in a photo from the side, or in a single one"
        )
    place: Vector3 = np.linalg.solve(across.sum(0), (across @ centers[..., None]).sum(0))[:, 0]
    to_place = place - centers
    distances = np.linalg.norm(to_place, axis=1)
    along = (to_place * rays).sum(1)
    errors = np.degrees(np.arctan2(np.linalg.norm(np.cross(rays, to_place), axis=1), along))
    if errors.max() > MAX_ERROR_DEGREES or not distances.min() > 0:
        raise InputError(
            f"known_distance: the pixels of {name} are not of one place: their rays pass it by {errors.max():.1f} "
            f"degrees (at most {MAX_ERROR_DEGREES:g} are taken): look at them again"
        )
    return place


def _on_surface(place: Place, look: dict[str, Any]) -> Vector3:
    """Return the position seen at a pixel: on its ray, at the depth of the points around it."""
    pixels = np.array(look["pixels"], np.float64).reshape(-1, 2)
    away = np.linalg.norm(pixels - (place.x, place.y), axis=1)
    near = np.argsort(away, kind="stable")[:MAX_SURFACE_POINTS]
    near = near[away[near] <= MAX_AWAY_SHARE * np.hypot(*look["size"])]
    if not len(near):
        raise InputError(
            f"known_distance: no point of the capture is near ({place.x:g}, {place.y:g}) of {place.photo}: choose a "
            "place with texture, or give its pixels in two photos (places=FILE)"
        )
    depth = _depth(pixels[near] - (place.x, place.y), np.array(look["depths"])[near])
    return np.array(look["center"]) + depth * np.array(look["ray"])


def _depth(offsets: PlanePoints, depths: Doubles) -> float:
    """Return the depth at a pixel of the foremost surface through the points around it.

    On a plane the inverse of the depth is linear in the pixel; it is not extrapolated beyond the points' depths.
    """
    # which depths are of the first surface: people point at objects, not at the wall behind
    ascending = np.sort(depths)
    ends = np.flatnonzero(np.diff(ascending) > MIN_GAP_SHARE * ascending[:-1]) + 1
    end = next((int(end) for end in ends if end >= MIN_FRONT_POINTS), len(depths))
    front = depths <= ascending[end - 1]
    inverse, offsets = 1 / depths[front], offsets[front]
    if len(inverse) < MIN_PLANE_POINTS:
        return float(1 / np.median(inverse))
    terms = np.column_stack([np.ones(len(offsets)), offsets])
    at_pixel = float(np.linalg.lstsq(terms, inverse, rcond=None)[0][0])
    return 1 / float(np.clip(at_pixel, inverse.min(), inverse.max()))
