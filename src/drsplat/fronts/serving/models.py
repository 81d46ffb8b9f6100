"""Answers as JSON, for programs and for language models alike.

Coordinates are world coordinates of the scene, in scene units: metres only where the capture was scaled so.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ... import query as engine
from ...base.arrays import RowIds
from ...base.contents import Document
from ...query.documents import answer_document, match_document, object_documents, rounded, track_document
from ...scene.boxes import BoxKind

UNITS = "scene units"
MAX_PHOTOS_OF_OBJECT = 8
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Span = Annotated[list[float], Field(min_length=2, max_length=2)]


class Body(BaseModel):
    """A JSON object of an answer."""

    model_config = ConfigDict(ser_json_inf_nan="null", use_attribute_docstrings=True)


Fingerprint = Annotated[str, Field(description="fingerprint of the field that answered: another one, another version")]


class SceneSummary(Body):
    name: str
    """what to pass as scene"""
    num_gaussians: int
    """Gaussians of the scene"""
    num_registered: int
    """those that have a language feature"""
    encoder: str
    """the model that embeds words for this scene"""
    fault: str = ""
    """why it cannot be opened; empty if it can"""


class Word(Body):
    name: str
    score: float
    """cosine; only the order means something across encoders"""


class Words(Body):
    words: list[Word]
    """best first"""
    field: Fingerprint = ""


class Problem(Body):
    """Why there is no answer."""

    error: str
    """what was given, what is expected, what to do"""
    kind: str


class Health(Body):
    status: str
    num_scenes: int


class SceneDetails(SceneSummary):
    views: list[str]
    """names of the photos"""
    low: Vector
    """corner of the box of the middle 98 % of the Gaussians"""
    high: Vector
    up: Vector | None = None
    """unit direction, told by the photos"""
    times: Span | None = None
    """first and last time of a scene that moves, else null"""
    units: str = UNITS
    scene: str = ""
    """fingerprint of the Gaussians: of their count, positions and order"""
    field: Fingerprint = ""


DOUBT: str = Field("", description="reason not to rely on the answer; empty if there is none")
LIST_DOUBT: str = Field("", description="why a vocabulary of few texts says little of what a word does not mean, or ''")


class Measured(Body):
    """How a query was scored and cut."""

    measure: str
    """cosine or relevancy"""
    threshold: float
    threshold_rule: str
    num_selected: int
    num_registered: int
    certainty: str
    """sure, maybe where there is a doubt, or nothing"""
    doubt: str = DOUBT
    list_doubt: str = LIST_DOUBT
    seen_from: str = ""
    """the photo that left and right are meant from"""


class Selected(Body):
    """Selection of a query."""

    measured: Measured
    score_range: Annotated[list[float], Field(min_length=2, max_length=2)]
    gaussian_ids: list[int] | None = None
    """rows of the scene, ascending; only with 'ids': true"""
    field: Fingerprint = ""


class ClassCount(Body):
    name: str
    num_gaussians: int
    share: float
    """of the registered Gaussians"""
    threshold: float


class Segmented(Body):
    measure: str
    num_registered: int
    num_labelled: int
    classes: list[ClassCount]
    labels: list[int] | None = None
    """per Gaussian of the scene the number of its class, -1 for none"""
    field: Fingerprint = ""
    doubt: str = DOUBT
    list_doubt: str = LIST_DOUBT


class SceneList(Body):
    scenes: list[SceneSummary]
    advice: str = ""


class Support(Body):
    """A mask of a supporting photo."""

    view: str
    mask: int
    """its number in the photo"""
    share: float
    """its part of all support"""


class Track(Body):
    """Track of a match: its places over time, and when photos see it."""

    times: list[float]
    """those of the scene's times at which it is there, ascending"""
    centers: list[Vector]
    """one of each time, as are extents and axes"""
    extents: list[Vector]
    axes: list[Annotated[list[Vector], Field(min_length=3, max_length=3)]]
    spans: list[Span]
    """first and last time of each span in which a photo sees it"""
    views: list[str]
    """these photos"""


class EarthPosition(Body):
    longitude: float
    """degrees, WGS 84"""
    latitude: float
    height: float
    """metres above the ellipsoid"""


class Footprint(Body):
    """Outline of a box seen from above, as GeoJSON: longitudes, latitudes and heights, anticlockwise and closed."""

    type: Literal["Polygon"]
    coordinates: list[list[Vector]]


POSITION: EarthPosition | None = Field(
    None, description="of the centre on the Earth, where the scene has a georeference"
)
FOOTPRINT: Footprint | None = Field(None, description="of the box on the Earth, where the scene has a georeference")


class Match(Body):
    """A place that a query matches, with its oriented box."""

    center: Vector
    extent: Vector
    """full lengths of the box along its axes"""
    axes: list[Vector]
    """unit directions of the box, one per row: the third is up, or, of free boxes, the longest first"""
    score: float
    sure: bool
    """whether the query surely means it"""
    num_gaussians: int
    support: list[Support]
    position: EarthPosition | None = POSITION
    footprint: Footprint | None = FOOTPRINT
    track: Track | None = None
    """only with 'tracks': true, of a scene that moves"""


class SceneObject(Body):
    """An object that photos agree on, with or without a word for it."""

    id: int
    """its number: 0 has the largest mass"""
    label: str | None
    """the name that people gave it"""
    name: str | None
    """the word that the encoder is sure of among its list"""
    center: Vector
    extent: Vector
    """full lengths of the box along its axes"""
    axes: list[Vector]
    """unit directions of the box, one per row: the third is up where it is known"""
    num_gaussians: int
    num_views: int
    """photos that see it"""
    sure: float
    """how far the photos agree on it, from 0 to 1"""
    agreed: bool
    """whether photos agree on it, or it has a label; most others are scraps"""
    few_photos: bool
    """whether so few photos see it that most of its sides are unknown"""
    surface: bool | None
    """whether it is flat and large, such as a floor or a table top, by its shape; null of a scene that stays on disk"""
    views: list[str]
    """photos, those that show most of it first"""
    position: EarthPosition | None = POSITION
    footprint: Footprint | None = FOOTPRINT


class ObjectList(Body):
    num_objects: int
    """all, listed or not"""
    num_agreed: int
    """of these, those that photos agree on"""
    objects: list[SceneObject]
    """largest mass first"""
    units: str = UNITS
    advice: str = ""
    field: Fingerprint = ""


class Located(Body):
    query: str
    count: int
    """of the matches, those that are surely meant"""
    num_matches: int
    matches: list[Match]
    units: str = UNITS
    advice: str = ""
    measured: Measured | None = None
    field: Fingerprint = ""


class When(Body):
    one: str
    relation: str
    other: str
    spans: list[Span]
    """first and last time of each span in which it holds"""
    times: Span
    """first and last time of the scene"""
    field: Fingerprint = ""
    advice: str = ""


class Measurement(Body):
    """Lengths or positions in a scene, and what to do next."""

    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Count(Measurement):
    query: str
    count: int
    of: int
    """how many there are in the whole scene"""
    centers: list[Vector]
    """of the matches counted, best score first"""


class BestMatch(Measurement):
    """Best match of a query."""

    query: str
    best: Match | None = None
    """null where nothing matches"""
    others: int = 0
    """further matches that fit less well"""
    best_view: str | None = None
    """the photo that shows most of it"""


class Distance(Measurement):
    first: str
    second: str
    center_distance: float
    """between the centres of the two"""
    gap: float
    """between their nearest parts"""
    offset: Vector
    """from the centre of the first to that of the second"""
    first_center: Vector
    second_center: Vector


class PointWords(Measurement):
    """Words for what is at a point."""

    point: Vector
    """centre of the Gaussian that is there"""
    words: list[Word]
    """best first"""


class Part(Body):
    name: str
    share: float
    """of the registered Gaussians in the region"""
    num_gaussians: int
    center: Vector


class Region(Measurement):
    center: Vector
    radius: float
    parts: list[Part]


class About(Measurement):
    """Frame of a scene: the meaning of its positions and lengths."""

    scene: str
    low: Vector
    """corner of the box of the middle 98 % of the Gaussians"""
    high: Vector
    up: Vector | None = None
    """unit direction that is up; null where unknown"""
    times: Span | None = None
    """first and last time of a scene that moves, else null"""
    num_photos: int
    some_photos: list[str]
    """names of a few, for show and what_is_at_pixel"""


class Related(ObjectList):
    relation: str
    to: list[int | None]
    """the objects that they are related to; null for a place that is none"""


class RenderedView(Body):
    """View of a picture, and what it shows."""

    view: str
    query: str | None
    num_matches: int
    width: int
    height: int
    field: Fingerprint = ""
    advice: str = ""


class RenderedPicture(Body):
    """Picture with its view. png: base64."""

    view: RenderedView
    png: str


def measured(answer: engine.Answer) -> Measured:
    return Measured(**answer_document(answer) | {"threshold": significant(answer.threshold)})


def matches_of(
    scene: engine.Scene, matches: Sequence[engine.Match], tracks: BoxKind | None = None, most: int | None = None
) -> list[Match]:
    """Return matches. tracks: the boxes of their tracks, None for no tracks. most: times and photos of a track at most.

    Raises: InputError: tracks of a scene that stands still.
    """
    digits = decimals_of(scene)
    documents = [match_document(match, digits, scene.georeference) for match in matches]
    if tracks is not None:
        for document, track in zip(documents, scene.tracks(matches, tracks), strict=True):
            document["track"] = track_document(track, digits, most)
    return [Match(**document) for document in documents]


def frame_document(scene: engine.Scene) -> Document:
    """Return where a scene lies, which way is up in it, and its first and last time if it moves."""
    low, high = (rounded(corner, decimals_of(scene)) for corner in scene.box)
    up = None if scene.up is None else rounded(scene.up, 4)
    times = None if scene.motion is None else list(scene.motion.span)
    return {"low": low, "high": high, "up": up, "times": times, "field": scene.field.fingerprint}


def listed_objects(scene: engine.Scene, every: bool) -> tuple[list[engine.Match], int]:
    """Return the objects that photos agree on, or all, and how many are left out. Raises: as `Scene.objects`."""
    objects = scene.objects
    shown = [one for one, agreed in zip(objects, scene.agreed, strict=True) if agreed or every]
    return shown, len(objects) - len(shown)


def object_list(scene: engine.Scene, shown: Sequence[engine.Match], advice: str = "") -> ObjectList:
    """List objects. shown: objects of the scene."""
    agreed = scene.agreed
    listed = [
        SceneObject(**document | {"views": document["views"][:MAX_PHOTOS_OF_OBJECT]})
        for document in object_documents(scene, shown, decimals_of(scene))
    ]
    return ObjectList(
        num_objects=len(agreed),
        num_agreed=int(np.count_nonzero(agreed)),
        objects=listed,
        advice=advice,
        field=scene.field.fingerprint,
    )


def ids_of(matches: Sequence[engine.Match]) -> RowIds:
    """Return the Gaussians of some matches."""
    return np.concatenate([match.gaussian_ids for match in matches] or [np.empty(0, np.int64)])


def decimals_of(scene: engine.Scene) -> int:
    """Return the decimals of coordinates: a ten-thousandth of the scene's size or finer, 4 for a room in metres."""
    low, high = scene.box
    size = max(float(np.linalg.norm(high - low)), 1e-12)
    return 4 - math.floor(math.log10(size))


def significant(value: float) -> float:
    """Return six digits of a score: as many as single precision holds."""
    return float(f"{float(value):.6g}")
