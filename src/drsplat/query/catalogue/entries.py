"""Entries and answers of a catalogue, and conditions on its objects."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from ...base.arrays import ArraysByName, Flags, Matrix3, OtherPixels, Vector3
from ...base.contents import Document
from ...errors import FormatError, InputError
from ...formats.json_files import is_text
from ...scene.photos import decoded_picture
from ..documents import box_document

MAX_NAME = 200  # characters of a scene's name
Corners = tuple[float, float, float, float, float, float]
Degrees = tuple[float, float, float, float]


def checked_name(name: str) -> str:
    """Return a scene's name after a check. Raises: InputError: empty, too long, or it cannot be written."""
    if not is_text(name) or not 1 <= len(name) <= MAX_NAME or "\0" in name:
        raise InputError(f"a scene's name: expected a text of 1 to {MAX_NAME} characters, got {name!a:.80}")
    return name


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
            west, south, east, north = self.area
            if not (
                _rises((south, -180.0, -180.0), (north, west, east))
                and max(west, east) <= 180
                and -90 <= south <= north <= 90
            ):
                raise InputError(f"area: expected west, south, east and north in degrees, got {self.area}")
        if self.since is not None:
            _in_utc(self.since)

    def admit(self, scene: "SceneEntry") -> bool:
        """Return whether objects of a scene may meet them."""
        return (not self.scenes or scene.scene in self.scenes) and (self.since is None or scene.added >= self.since)

    def hold(self, arrays: ArraysByName) -> Flags:
        """Return which objects lie where they ask for. arrays: with the `centers` and `positions` of objects."""
        inside = np.ones(len(arrays["centers"]), np.bool_)
        if self.box is not None:
            inside &= ((arrays["centers"] >= self.box[:3]) & (arrays["centers"] <= self.box[3:])).all(1)
        if self.area is not None:
            (west, south, east, north), (longitude, latitude, _) = self.area, arrays["positions"].T
            sides = longitude >= west, longitude <= east
            inside &= (latitude >= south) & (latitude <= north)
            inside &= sides[0] & sides[1] if west <= east else sides[0] | sides[1]
        return inside


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


def _rises(low: Sequence[float], high: Sequence[float]) -> bool:
    return bool(np.isfinite([*low, *high]).all()) and all(a <= b for a, b in zip(low, high, strict=True))


JPEG = b"\xff\xd8\xff"
MAX_PIXELS = MAX_JPEG_BYTES = 1 << 20  # of a thumbnail


class Position(NamedTuple):
    """Position on the Earth, WGS 84: degrees, and metres above the ellipsoid."""

    longitude: float
    latitude: float
    height: float


@dataclass(frozen=True, eq=False)
class Entry:
    """Object of a scene.

    center, axes, extent: its box in the scene's world, as of `Match`. position: of the centre on the Earth, None where
    the scene has no georeference. object_id: its number in the scene. tile: the one with most of its Gaussians, 0 where
    the scene has none. label: the name that people gave it. name: the best word for it, if any. sure: how far the
    photos agree on it. photo: the one that shows it best; mask: its mask there. thumbnail: a small JPEG, None where it
    could not be drawn. added: when it was added. field: fingerprint of its field. score: for the query.
    """

    scene: str
    tile: int
    object_id: int
    score: float
    center: Vector3
    axes: Matrix3
    extent: Vector3
    position: Position | None
    num_gaussians: int
    num_views: int
    sure: float
    label: str | None
    name: str | None
    photo: str | None
    mask: int | None
    added: datetime
    field: str
    thumbnail: bytes | None = None

    def __repr__(self) -> str:
        return f"Entry({self.title} of '{self.scene}', score {self.score:.3f})"

    @property
    def title(self) -> str:
        """Label, else the best word, else the number."""
        return self.label or self.name or f"object {self.object_id}"

    def picture(self) -> OtherPixels:
        """Decode the thumbnail as RGB. Raises: InputError: it has none. FormatError: it is damaged, or no JPEG."""
        if self.thumbnail is None:
            raise InputError(f"{self.title} of '{self.scene}' has no thumbnail: its scene was added without photos")
        try:
            return decoded_picture(io.BytesIO(checked_jpeg(self.thumbnail)), MAX_PIXELS)
        except (FormatError, InputError) as error:
            raise FormatError(
                f"the thumbnail of {self.title} of '{self.scene}' {error}: add the scene again"
            ) from error

    def json(self) -> Document:
        """Return the entry as a JSON object, without the thumbnail."""
        return {
            "scene": self.scene,
            "tile": self.tile,
            "object_id": self.object_id,
            "label": self.label,
            "name": self.name,
            "score": round(self.score, 4),
            **box_document(self.center, self.axes, self.extent),
            "position": None if self.position is None else self.position._asdict(),
            "num_gaussians": self.num_gaussians,
            "num_views": self.num_views,
            "sure": self.sure,
            "photo": self.photo,
            "mask": self.mask,
            "added": self.added.isoformat(),
            "field": self.field,
        }


@dataclass(frozen=True, eq=False)
class CatalogueAnswer:
    """Answer of a catalogue.

    entries: the objects that a query means, best first, up to the number wanted. measure, threshold, rule: as of
    `Answer`. num_compared: objects that were compared in full. exact: True if those are the nearest of all, not only of
    those in the index's partitions.
    """

    entries: list[Entry]
    measure: str
    threshold: float
    rule: str
    num_compared: int
    exact: bool

    def json(self) -> Document:
        """Return the answer as a JSON object, but for its entries."""
        return {
            "measure": self.measure,
            "threshold": self.threshold,
            "threshold_rule": self.rule,
            "num_compared": self.num_compared,
            "exact": self.exact,
            "num_matches": len(self.entries),
        }


@dataclass(frozen=True)
class SceneEntry:
    """Scene of a catalogue.

    num_agreed: number of its objects that photos agree on or that have a label. folder: where it was added from, "" if
    unknown. state: "current", "changed" (its field is another one now: add it again), "missing" (nothing is there),
    "unknown".
    """

    scene: str
    num_objects: int
    num_agreed: int
    added: datetime
    field: str
    folder: str
    state: str


def checked_jpeg(data: bytes) -> bytes:
    """Check a thumbnail. Raises: FormatError: it does not begin as a JPEG does, or is too large."""
    if not data.startswith(JPEG) or len(data) > MAX_JPEG_BYTES:
        raise FormatError("is no JPEG of a thumbnail's size")
    return data
