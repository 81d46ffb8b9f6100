"""Places that people point at in photos: a pixel, or a named marker with pixels in some photos."""

import math
from pathlib import Path
from typing import NamedTuple

from ...errors import FormatError, InputError, did_you_mean
from ...formats.csv_tables import read_rows
from ...formats.photo_files import listed

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
        name, place = _row(row, f"{path}, line {number}")
        if place.photo in seen.setdefault(name, {}):
            raise FormatError(f"{path}, line {number}: '{name}' is in {place.photo} twice")
        seen[name][place.photo] = place
    return {name: Marker(name, tuple(places.values())) for name, places in seen.items()}


def marker_named(name: str, markers: dict[str, Marker]) -> Marker:
    """Return a marker. Raises: InputError: there is none of that name."""
    if name not in markers:
        near = did_you_mean(name, markers)
        raise InputError(f"the table of places has no '{name}': it has {listed(sorted(markers)) or 'no place'}.{near}")
    return markers[name]


def _row(row: list[str], where: str) -> tuple[str, Place]:
    try:
        name, photo, x, y = (cell.strip() for cell in row)
        place = Place(photo, float(x), float(y))
        if name and photo and math.isfinite(place.x) and math.isfinite(place.y):
            return name, place
    except ValueError:
        pass
    raise FormatError(f"{where}: expected a name, a photo and two numbers, got {ascii(','.join(row))[:80]}")
