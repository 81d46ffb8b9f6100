"""Annotations as GeoJSON has features: NAME.annotations.json beside the scene NAME.ply.

A feature has a Point as its geometry, with coordinates of the scene's world; a box says its axes and lengths in the
properties, so that other programs show its middle.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from ..base.arrays import Matrix3, Vector3
from ..base.contents import AnyPath
from ..errors import FormatError, InputError
from ..scene.labelled import Annotation, Outline
from .json_files import as_document, as_fields, read_json, write_json
from .replacing import claimed_output
from .scenes import companion

KIND, FORMAT, VERSION = "FeatureCollection", "drsplat annotations", 1
MAX_ANNOTATIONS = 10_000  # of a file
PATIENCE_S = 10.0  # for another process that writes
Annotations = tuple[Annotation, ...]


@dataclass(frozen=True)
class AnnotationFile:
    """The annotations of a scene. Every change is whole or not at all, and one writer's at a time."""

    path: Path

    @classmethod
    def beside(cls, scene: AnyPath) -> "AnnotationFile":
        """Return the file of a scene's annotations: NAME.annotations.json beside NAME.ply or the folder NAME."""
        return cls(companion(scene, "annotations"))

    def read(self) -> Annotations:
        """Read all of them; () where there is no file. Raises: FormatError: it is damaged, or of a newer version."""
        return annotations_of(read_json(self.path), str(self.path)) if self.path.exists() else ()

    def add(self, annotations: Sequence[Annotation]) -> Annotations:
        """Keep some more; returns all. Raises: as `read`; InputError: too many, or the file cannot be written."""
        return self._change(lambda known: (*known, *annotations))

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep others from writing it while the block runs. Raises: InputError: another process does."""
        with claimed_output(self.path, PATIENCE_S):
            yield

    def write(self, annotations: Annotations) -> None:
        """Write the annotations; the caller must hold the file. Raises: InputError: too many, or no place to write."""
        if len(annotations) > MAX_ANNOTATIONS:
            raise InputError(
                f"{self.path}: would have {len(annotations):,} annotations, the most are {MAX_ANNOTATIONS:,}"
            )
        # the annotations as the GeoJSON document that is stored on disk
        features = [
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": one.center.tolist()},
                "properties": {"text": one.text}
                | ({} if one.outline is None else {name: box.tolist() for name, box in one.outline._asdict().items()}),
            }
            for one in annotations
        ]
        write_json(
            self.path,
            {"type": KIND, "format": FORMAT, "version": VERSION, "features": features},
            overwrite=True,
            ensure_ascii=False,
        )

    def drop(self, number: int) -> Annotations:
        """Drop one, counted from 1; returns the others. Raises: as `read`; InputError: no such annotation."""
        return self._change(lambda known: without(known, number))

    def _change(self, change: Callable[[Annotations], Annotations]) -> Annotations:
        with self.held():
            annotations = change(self.read())
            self.write(annotations)
        return annotations


def without(known: Annotations, number: int) -> Annotations:
    """Return all but one, counted from 1. Raises: InputError: there is no such annotation."""
    if not 1 <= number <= len(known):
        raise InputError(f"there is no annotation {number} of {len(known)}")
    return (*known[: number - 1], *known[number:])


class _Geometry(NamedTuple):
    type: Literal["Point"]
    coordinates: Vector3


class _Properties(NamedTuple):
    text: str
    extent: Vector3 | None = None
    axes: Matrix3 | None = None


class _Feature(NamedTuple):
    geometry: _Geometry
    properties: _Properties


def annotations_of(document: object, where: str) -> Annotations:
    """Return the annotations of a document, also of one written by hand without format and version.

    Raises: FormatError: no collection of features with a point and a text.
    """
    collection = as_fields(document, where, type=Literal["FeatureCollection"], features=tuple[_Feature, ...])
    as_document({"format": FORMAT, "version": VERSION, **document}, where, FORMAT, VERSION)  # type: ignore[dict-item]
    if len(collection["features"]) > MAX_ANNOTATIONS:
        raise FormatError(f"{where}: expected a list of up to {MAX_ANNOTATIONS:,} features")
    return tuple(_annotation(one, f"{where}: feature {number}") for number, one in enumerate(collection["features"], 1))


def _annotation(feature: _Feature, where: str) -> Annotation:
    text, extent, axes = feature.properties
    if extent is not None and axes is None:
        raise FormatError(f"{where}: properties: expected axes beside the extent")
    try:
        outline = None if extent is None or axes is None else Outline(axes, extent)
        return Annotation(text, feature.geometry.coordinates, outline)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error
