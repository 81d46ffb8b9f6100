"""Requests over HTTP, and the queries of the engine that they become."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from ... import query as engine
from ...errors import InputError
from ...query.defaults import MIN_GAUSSIANS
from ...query.relations import OfTwo
from ...scene.boxes import BoxKind
from .limits import Limits
from .pictures import from_base64

MOST = Limits()
Text = Annotated[str, StringConstraints(min_length=1, max_length=MOST.text)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Threshold = Annotated[float, Field(allow_inf_nan=False, ge=-1, le=1)]
WithObjects = Annotated[
    Literal["auto", "never"],
    Field(description="auto: objects answer as wholes, where the field has them; never: each Gaussian for itself"),
]
Share = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]


class Request(BaseModel):
    """Unknown keys are refused: a misspelt option would otherwise be ignored in silence."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Click(Request):
    """A pixel of a photo, from the left and from the top."""

    view: Annotated[str, Field(min_length=1, max_length=500)]
    x: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
    y: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class Cut(Request):
    """How scores are measured and cut; all may be left out."""

    threshold: Threshold | Literal["auto"] | None = None
    top_share: Share | None = None
    relevancy: bool = False
    negatives: Annotated[list[Text], Field(min_length=1, max_length=32)] | None = None
    during: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None = Field(
        None, description="start and end of a span of time, of a scene that moves: only what photos of it have shown"
    )
    objects: WithObjects = "auto"


class Query(Cut):
    """Exactly one of text, vector, image, point and click."""

    text: Text | None = Field(None, description="words; 'mug, not red' excludes what 'red mug' fits as well")
    vector: Annotated[list[Finite], Field(min_length=1, max_length=8192)] | None = None
    image: Annotated[str, Field(max_length=MOST.body_bytes)] | None = Field(
        None, description="a picture of what to search for, base64 of PNG, JPEG, WebP, TIFF, BMP or PPM"
    )
    point: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None = None
    click: Click | None = None
    exclude: Annotated[list[Text], Field(max_length=16)] = []

    model_config = ConfigDict(json_schema_extra={"examples": [{"text": "red vase"}, {"point": [0.3, 0.14, 0.82]}]})


class Locate(Query):
    """A query, and which of its matches are returned."""

    top: Annotated[int, Field(ge=1, le=MOST.matches, description="matches to return, best first")] = 10
    min_gaussians: Annotated[int, Field(ge=2, le=1_000_000)] = MIN_GAUSSIANS
    box: BoxKind = Field(
        "upright",
        description="upright: the third axis of boxes is up, where the photos tell it; free: along the match's own "
        "axes",
    )
    tracks: bool = Field(
        False, description="whether to tell where each match is over time, and when photos see it (scenes that move)"
    )


class When(Request):
    """Two queries in words, of which the sure matches are taken, and a relation of the one to the other."""

    one: Text
    relation: OfTwo = Field(description="left_of and right_of are meant as seen from view")
    other: Text
    view: Annotated[str, Field(min_length=1, max_length=500)] | None = Field(
        None, description="a photo's name, for left_of and right_of only"
    )
    threshold: Threshold | Literal["auto"] | None = Field(None, description="of both queries")
    objects: WithObjects = "auto"

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"one": "red car", "relation": "next_to", "other": "white vase"}]}
    )


class Details(Request):
    """name: what the scene is called here."""

    name: str


class Objects(Request):
    """The objects of a scene that photos agree on, or all."""

    all: bool = False


class OneObject(Request):
    """An object by its number."""

    number: int


class Photo(Request):
    """A photo of the scene by its name."""

    view: str
    max_side: int


class Tool(Request):
    """One of `Conversation`'s, about the scene that is called `name` here."""

    tool: str
    name: str
    arguments: dict[str, Any]


class Select(Query):
    """A query for the Gaussians themselves."""

    ids: bool = Field(False, description="whether to return the rows of the selected Gaussians")


class Segment(Cut):
    classes: Annotated[list[Text], Field(min_length=1, max_length=MOST.classes)]
    labels: bool = Field(False, description="whether to return the class of every Gaussian")

    model_config = ConfigDict(json_schema_extra={"examples": [{"classes": ["table", "red vase", "orange sofa"]}]})


class Picture(Query):
    """A rendering, with the matches of a query in colour; without a query the scene as it is."""

    view: Annotated[str, Field(min_length=1, max_length=500)] | None = Field(
        None, description="a photo's name; left out: the one that shows most of the matches"
    )
    photo: bool = Field(False, description="the photo instead of a rendering")
    max_side: Annotated[int, Field(ge=16, le=MOST.side)] = 800

    model_config = ConfigDict(json_schema_extra={"examples": [{"text": "red vase", "max_side": 320}]})


class Export(Query):
    """The scene as a file, with the answer to a query where there is one."""

    format: Literal["glb", "ply", "spz"] = Field("glb", description="a .glb has names, boxes and matches")
    only: bool = Field(False, description="whether to leave out all that does not match the query")
    object: Annotated[int, Field(ge=0, le=2**31 - 1)] | None = Field(None, description="an object to write alone")
    time: Finite | None = Field(None, description="the time of a scene that moves")
    edits: Literal["none", "kept"] = Field("none", description="kept: as edited, with the edits beside the scene")
    embeddings: bool = Field(False, description="whether objects take their embeddings along")

    model_config = ConfigDict(json_schema_extra={"examples": [{"text": "red vase", "only": True}, {"format": "ply"}]})


class WhatIs(Request):
    """Exactly one of point and click."""

    point: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None = None
    click: Click | None = None
    names: Annotated[list[Text], Field(min_length=1, max_length=MOST.classes)] | None = None

    model_config = ConfigDict(json_schema_extra={"examples": [{"point": [0.3, 0.14, 0.82]}]})


def asks_something(query: Query) -> bool:
    return any(getattr(query, kind) is not None for kind in engine.query.KINDS)


def query_of(given: Query, limits: Limits) -> engine.Query:
    """Return the engine's query. Raises: InputError: not one of the five, or a picture that is damaged or too large."""
    return engine.Query(
        given.text,
        None if given.vector is None else np.asarray(given.vector, np.float32),
        None if given.image is None else from_base64(given.image, limits.pixels),
        None if given.point is None else _point(given.point),
        None if given.click is None else _pixel(given.click),
        tuple(given.exclude),
        **vars(cut_of(given)),
    )


def cut_of(given: Cut) -> engine.Cut:
    return engine.Cut(
        threshold=given.threshold,
        top_share=given.top_share,
        relevancy=given.relevancy,
        negatives=None if given.negatives is None else tuple(given.negatives),
        during=None if given.during is None else (given.during[0], given.during[1]),
        objects=given.objects,
    )


def place(given: WhatIs) -> tuple[float, float, float] | tuple[str, float, float]:
    """Return the point or the click of a request. Raises: InputError: not exactly one of the two."""
    if (given.point is None) == (given.click is None):
        raise InputError("expected exactly one of point and click")
    if given.click is not None:
        return _pixel(given.click)
    assert given.point is not None
    return _point(given.point)


def _point(given: list[float]) -> tuple[float, float, float]:
    return given[0], given[1], given[2]


def _pixel(click: Click) -> tuple[str, float, float]:
    return click.view, click.x, click.y
