"""What a catalogue keeps of an object, and what it answers."""

import io
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Float64, UInt8
from ..errors import FormatError, InputError
from ..scene.photos import decoded_picture

JPEG = b"\xff\xd8\xff"
MOST_PIXELS = MOST_JPEG = 1 << 20  # of a thumbnail; bytes of one


class Position(NamedTuple):
    """On the Earth, of WGS 84: degrees, and metres above the ellipsoid."""

    longitude: float
    latitude: float
    height: float


@dataclass(frozen=True, eq=False)
class Entry:
    """One object of one scene.

    center, axes, extent: its box in the scene's world, as of `Match`. position: of the centre on the Earth, None where
    the scene has no georeference. object_id: its number in the scene. tile: that has most of it, 0 where the scene has
    none. label: the name that people gave it. name: the best word for it, where one was known. sure: how far the photos
    agree on it. photo: the one that shows it best; mask: its mask there. thumbnail: a small JPEG, None where it could
    not be drawn. added: when the catalogue got it. field: fingerprint of the field that it is of. score: of the query
    that found it.
    """

    scene: str
    tile: int
    object_id: int
    score: float
    center: Float64[np.ndarray, " 3"]
    axes: Float64[np.ndarray, "3 3"]
    extent: Float64[np.ndarray, " 3"]
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
        """What people call it, else the best word, else its number."""
        return self.label or self.name or f"object {self.object_id}"

    def picture(self) -> UInt8[np.ndarray, "_ _ 3"]:
        """RGB of the thumbnail. Raises: InputError: it has none. FormatError: it is damaged, or no JPEG."""
        if self.thumbnail is None:
            raise InputError(f"{self.title} of '{self.scene}' has no thumbnail: its scene was added without photos")
        try:
            return decoded_picture(io.BytesIO(checked_jpeg(self.thumbnail)), MOST_PIXELS)
        except (FormatError, InputError) as error:
            raise FormatError(
                f"the thumbnail of {self.title} of '{self.scene}' {error}: add the scene again"
            ) from error

    def json(self) -> dict[str, Any]:
        """As programs get it: without the thumbnail."""
        return {
            "scene": self.scene,
            "tile": self.tile,
            "object_id": self.object_id,
            "label": self.label,
            "name": self.name,
            "score": round(self.score, 4),
            "center": self.center.tolist(),
            "extent": self.extent.tolist(),
            "axes": self.axes.tolist(),
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
    """entries: the objects that a query means, best first, as many as were wanted. measure, threshold, rule: as of
    `Answer`. num_compared: objects that were looked at closely. exact: whether these are the nearest of all, not of
    those that an index led to.
    """

    entries: list[Entry]
    measure: str
    threshold: float
    rule: str
    num_compared: int
    exact: bool


@dataclass(frozen=True)
class Listed:
    """A scene of a catalogue. num_agreed: of its objects, those that photos agree on or that have a label. folder:
    where it was added from, "" where that is not known. state: "current", "changed" (its field is another one now: add
    it again), "missing" (nothing is there), "unknown".
    """

    scene: str
    num_objects: int
    num_agreed: int
    added: datetime
    field: str
    folder: str
    state: str


def checked_jpeg(data: bytes) -> bytes:
    """Raises: FormatError: it does not begin as a JPEG does, or is far larger than a thumbnail."""
    if not data.startswith(JPEG) or len(data) > MOST_JPEG:
        raise FormatError("is no JPEG of a thumbnail's size")
    return data
