"""Conditions on the objects of a catalogue, as SQL, the language of LanceDB's filters."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from ...errors import InputError
from ...formats.json_files import is_text

MAX_NAME = 200  # characters of a scene's name
Corners = tuple[float, float, float, float, float, float]
Degrees = tuple[float, float, float, float]


def quoted(text: str) -> str:
    """Quote a text for SQL; quotes within it are doubled."""
    return "'" + text.replace("'", "''") + "'"


def checked_name(name: str) -> str:
    """Return a scene's name after a check. Raises: InputError: empty, too long, or it cannot be written."""
    if not is_text(name) or not 1 <= len(name) <= MAX_NAME or "\0" in name:
        raise InputError(f"a scene's name: expected a text of 1 to {MAX_NAME} characters, got {name!a:.80}")
    return name


def scenes_sql(names: Sequence[str]) -> str:
    """Return the condition that a row is of one of these scenes."""
    return f"scene IN ({', '.join(quoted(name) for name in names)})"


def of_scene(name: str) -> str:
    """Return the condition that a row is of this scene."""
    return f"scene = {quoted(checked_name(name))}"


@dataclass(frozen=True)
class Conditions:
    """Conditions that objects have to meet.

    scenes: names, () for all. box: the lowest and the highest corner of a box that centres lie in, in the world of
    each scene. area: west, south, east and north in degrees, of scenes with a georeference; west above east crosses
    the date line. since: added then or later.

    Raises: InputError: corners that are no box, names that are none, a time without a zone.
    """

    scenes: Sequence[str] = ()
    box: Corners | None = None
    area: Degrees | None = None
    since: datetime | None = None

    def __post_init__(self) -> None:
        if isinstance(self.scenes, str):
            raise InputError(f"scenes: expected a list of names, got the text {self.scenes!a:.80}")
        for name in self.scenes:
            checked_name(name)
        if self.box is not None and not _rises(self.box[:3], self.box[3:]):
            raise InputError(f"box: expected two corners, the lowest first, six finite numbers, got {self.box}")
        if self.area is not None:
            _check_area(self.area)
        if self.since is not None:
            _in_utc(self.since)

    @property
    def sql(self) -> str:
        """Conditions as SQL; "" for all objects."""
        parts = []
        if self.scenes:
            parts.append(scenes_sql(self.scenes))
        if self.box is not None:
            parts += _between("xyz", self.box[:3], self.box[3:])
        if self.area is not None:
            west, south, east, north = self.area
            parts += _between(("latitude",), (south,), (north,))
            joined = " AND " if west <= east else " OR "
            parts.append(f"({joined.join([f'longitude >= {west!r}', f'longitude <= {east!r}'])})")
        if self.since is not None:
            parts.append(f"added >= TIMESTAMP '{_in_utc(self.since).isoformat(' ', 'milliseconds')}'")
        return " AND ".join(parts)


def _in_utc(moment: datetime) -> datetime:
    """Return a time in UTC. Raises: InputError: it has no zone, or lies outside of the years 1 to 9999 there."""
    if moment.tzinfo is None:
        raise InputError(f"since: expected a time with its zone, as in 2026-11-22T14:00Z, got {moment.isoformat()}")
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise InputError(
            f"since: expected a time of the years 1 to 9999 in UTC, as 2026-11-22T14:00Z, got {moment.isoformat()}"
        ) from None


def _between(names: Sequence[str], low: Sequence[float], high: Sequence[float]) -> list[str]:
    sides = zip(names, low, high, strict=True)
    return [f"{name} >= {float(least)!r} AND {name} <= {float(most)!r}" for name, least, most in sides]


def _rises(low: Sequence[float], high: Sequence[float]) -> bool:
    return bool(np.isfinite([*low, *high]).all()) and all(a <= b for a, b in zip(low, high, strict=True))


def _check_area(area: Degrees) -> None:
    west, south, east, north = area
    if not (
        _rises((south, -180.0, -180.0), (north, west, east)) and max(west, east) <= 180 and -90 <= south <= north <= 90
    ):
        raise InputError(f"area: expected west, south, east and north in degrees, got {area}")
