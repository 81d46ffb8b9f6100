"""What can be asked over HTTP, and how it becomes a question."""

import base64
import binascii
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from ..asking import Question
from ..boxes import BoxKind
from ..defaults import MIN_GAUSSIANS
from ..errors import InputError
from .limits import Limits
from .pictures import decoded

MOST = Limits()
Text = Annotated[str, StringConstraints(min_length=1, max_length=MOST.text)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Threshold = Annotated[float, Field(allow_inf_nan=False, ge=-1, le=1)]
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


class Query(Cut):
    """Exactly one of text, vector, image, point and click."""

    text: Text | None = Field(None, description="words; 'mug, not red' leaves some out")
    vector: Annotated[list[Finite], Field(min_length=1, max_length=8192)] | None = None
    image: Annotated[str, Field(max_length=MOST.body_bytes)] | None = Field(
        None, description="a picture of a thing, base64 of PNG, JPEG, WebP, TIFF, BMP or PPM"
    )
    point: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None = None
    click: Click | None = None
    unwanted: Annotated[list[Text], Field(max_length=16)] = []

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"text": "red vase"}, {"point": [0.3, 0.14, 0.82]}]},
    )


class Locate(Query):
    """A query, and which of the things found are returned."""

    limit: Annotated[int, Field(ge=1, le=MOST.things)] = 10
    min_gaussians: Annotated[int, Field(ge=2, le=1_000_000)] = MIN_GAUSSIANS
    box: BoxKind = Field(
        "upright",
        description="upright: the third axis of boxes is up, where the photos tell it; free: as things lie",
    )


class Details(Request):
    """name: what the scene is called here."""

    name: str


class Photo(Request):
    """A photo of the scene by its name."""

    view: str
    max_side: int


class Ids(Query):
    """A query for the Gaussians themselves."""

    ids: bool = Field(False, description="whether to return the rows of the selected Gaussians")


class Segment(Cut):
    classes: Annotated[list[Text], Field(min_length=1, max_length=MOST.classes)]
    labels: bool = Field(False, description="whether to return the class of every Gaussian")

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"classes": ["table", "red vase", "orange sofa"]}]},
    )


class Picture(Query):
    """A rendering, with what a query means in colour; without a query the scene as it is."""

    view: Annotated[str, Field(min_length=1, max_length=500)] | None = Field(
        None, description="a photo's name; left out: the one that shows most of what was found"
    )
    photo: bool = Field(False, description="the photo instead of a rendering")
    max_side: Annotated[int, Field(ge=16, le=MOST.side)] = 800

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"text": "red vase", "max_side": 320}]}
    )


class WhatIs(Request):
    """Exactly one of point and click."""

    point: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None = None
    click: Click | None = None
    names: Annotated[list[Text], Field(min_length=1, max_length=MOST.classes)] | None = None

    model_config = ConfigDict(json_schema_extra={"examples": [{"point": [0.3, 0.14, 0.82]}]})


def asks_something(query: Query) -> bool:
    given = (query.text, query.vector, query.image, query.point, query.click)
    return any(one is not None for one in given)


def question(query: Query, limits: Limits) -> Question:
    """Raises: InputError: not one of the five, or a picture that cannot be read or is too large."""
    vector = None if query.vector is None else np.asarray(query.vector, np.float32)
    image = None if query.image is None else _picture(query.image, limits)
    point = query.point
    return Question(
        text=query.text,
        vector=vector,
        image=image,
        point=None if point is None else (point[0], point[1], point[2]),
        click=None if query.click is None else _pixel(query.click),
        unwanted=tuple(query.unwanted),
        **cut(query),
    )


def cut(given: Cut) -> dict[str, Any]:
    return {
        "threshold": given.threshold,
        "top_share": given.top_share,
        "relevancy": given.relevancy,
        "negatives": None if given.negatives is None else tuple(given.negatives),
    }


def place(given: WhatIs) -> tuple[float, float, float] | tuple[str, float, float]:
    """Raises: InputError: not one of the two."""
    if (given.point is None) == (given.click is None):
        raise InputError("say where: give one of point and click")
    if given.click is not None:
        return _pixel(given.click)
    assert given.point is not None
    return given.point[0], given.point[1], given.point[2]


def _pixel(click: Click) -> tuple[str, float, float]:
    return click.view, click.x, click.y


def _picture(text: str, limits: Limits) -> np.ndarray:
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"image: expected base64: {error}") from None
    return decoded(data, limits.pixels)
