"""Entries and answers of a catalogue."""

import io
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Float64, UInt8
from ...errors import FormatError, InputError
from ...scene.photos import decoded_picture
from ..documents import box_document

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
        """Label, else the best word, else the number."""
        return self.label or self.name or f"object {self.object_id}"

    def picture(self) -> UInt8[np.ndarray, "_ _ 3"]:
        """Decode the thumbnail as RGB. Raises: InputError: it has none. FormatError: it is damaged, or no JPEG."""
        if self.thumbnail is None:
            raise InputError(f"{self.title} of '{self.scene}' has no thumbnail: its scene was added without photos")
        try:
            return decoded_picture(io.BytesIO(checked_jpeg(self.thumbnail)), MAX_PIXELS)
        except (FormatError, InputError) as error:
            raise FormatError(
                f"the thumbnail of {self.title} of '{self.scene}' {error}: add the scene again"
            ) from error

    def json(self) -> dict[str, Any]:
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

    def json(self) -> dict[str, Any]:
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
