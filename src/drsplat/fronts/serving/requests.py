"""Requests over HTTP, except for the fields of queries, which `query_fields` makes."""

from typing import Annotated, Any, Literal

from pydantic import Field

from ...errors import InputError
from ...query.defaults import MIN_GAUSSIANS
from ...query.relations import OfTwo
from ...query.schema import CUT, Place
from ...scene.boxes import BoxKind
from .query_fields import LIMITS, Click, Finite, Point, Request, Text, asking, examples, values_of

EXAMPLES = examples({"text": "red vase"}, {"point": [0.3, 0.14, 0.82]})


@asking(Place.HTTP)
class Locate(Request):
    """A query, and which of its matches are returned."""

    model_config = EXAMPLES

    top: Annotated[int, Field(ge=1, le=LIMITS.matches)] = 10
    """matches to return, best first"""
    min_gaussians: Annotated[int, Field(ge=2, le=1_000_000)] = MIN_GAUSSIANS
    box: BoxKind = "upright"
    """upright: the third axis of boxes is up, where the photos tell it; free: along the match's own axes"""
    tracks: bool = False
    """whether to tell where each match is over time, and when photos see it (scenes that move)"""


@asking(Place.HTTP, Place.WORDS)
class When(Request):
    """Two queries in words, of which the sure matches are taken, and a relation of the one to the other."""

    one: Text
    relation: OfTwo
    """left_of and right_of are meant as seen from view"""
    other: Text
    view: Annotated[str, Field(min_length=1, max_length=500)] | None = None
    """a photo's name, for left_of and right_of only"""

    model_config = examples({"one": "red car", "relation": "next_to", "other": "white vase"})


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


@asking(Place.HTTP)
class Select(Request):
    """A query for the Gaussians themselves."""

    model_config = EXAMPLES

    ids: bool = False
    """whether to return the rows of the selected Gaussians"""


@asking(Place.HTTP, of=CUT)
class Segment(Request):
    classes: Annotated[list[Text], Field(min_length=1, max_length=LIMITS.classes)]
    labels: bool = False
    """whether to return the class of every Gaussian"""

    model_config = examples({"classes": ["table", "red vase", "orange sofa"]})


@asking(Place.HTTP)
class Picture(Request):
    """A rendering, with the matches of a query in colour; without a query the scene as it is."""

    view: Annotated[str, Field(min_length=1, max_length=500)] | None = None
    """a photo's name; left out: the one that shows most of the matches"""
    photo: bool = False
    """the photo instead of a rendering"""
    max_side: Annotated[int, Field(ge=16, le=LIMITS.side)] = 800

    model_config = examples({"text": "red vase", "max_side": 320})


@asking(Place.HTTP)
class Export(Request):
    """The scene as a file, with the answer to a query where there is one."""

    format: Literal["glb", "ply", "spz"] = "glb"
    """a .glb has names, boxes and matches"""
    only: bool = False
    """whether to leave out all that does not match the query"""
    object: Annotated[int, Field(ge=0, le=2**31 - 1)] | None = None
    """an object to write alone"""
    time: Finite | None = None
    """the time of a scene that moves"""
    edits: Literal["none", "kept"] = "none"
    """kept: as edited, with the edits beside the scene"""
    embeddings: bool = False
    """whether objects take their embeddings along"""

    model_config = examples({"text": "red vase", "only": True}, {"format": "ply"})


class WhatIs(Request):
    """Exactly one of point and click."""

    point: Point | None = None
    click: Click | None = None
    names: Annotated[list[Text], Field(min_length=1, max_length=LIMITS.classes)] | None = None

    model_config = examples({"point": [0.3, 0.14, 0.82]})


def place(given: WhatIs) -> tuple[float, float, float] | tuple[str, float, float]:
    """Return the point or the click of a request. Raises: InputError: not exactly one of the two."""
    if (given.point is None) == (given.click is None):
        raise InputError("expected exactly one of point and click")
    (where,) = values_of(vars(given)).values()
    return where  # type: ignore[no-any-return]
