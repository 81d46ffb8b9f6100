"""Requests as JSON: fields of a query made of the schema of queries, and models with what else is asked."""

from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import datetime
from types import new_class
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import urlencode

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, create_model, model_validator
from pydantic_core import PydanticCustomError

from ... import query as engine
from ...base.contents import Document
from ...errors import InputError, did_you_mean
from ...query.catalogue import Catalogue, Conditions
from ...query.defaults import MIN_GAUSSIANS
from ...query.relations import OfTwo
from ...query.schema import CUT, FIELDS, SUBJECTS, Kind, Place, QueryField, fields
from ...scene.boxes import BoxKind
from .guards import Limits
from .models import Body, EarthPosition, Vector, significant
from .replies import JPEG, Reply, decoded, from_base64

LIMITS = Limits()
Text = Annotated[str, StringConstraints(min_length=1, max_length=LIMITS.text)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Point = Annotated[list[Finite], Field(min_length=3, max_length=3)]
M = TypeVar("M", bound=BaseModel)


class Strict(BaseModel):
    """Unknown keys are refused: a misspelt option would otherwise be ignored in silence."""

    model_config = ConfigDict(extra="forbid", strict=True)

    @model_validator(mode="before")
    @classmethod
    def _without_unknown(cls, given: Any) -> Any:
        """Refuse a field that is not there, with the name of the nearest one. Raises: PydanticCustomError."""
        known = cls.model_fields
        for key in given.keys() - known.keys() if isinstance(given, dict) else ():
            meant = did_you_mean(key[:99], known, 1) or f" There are {', '.join(known)}."
            raise PydanticCustomError("unknown", "{said}", {"said": f"there is no such field: {key[:99]}.{meant}"})
        return given


class Request(Strict):
    """A body of the service."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, given: Any) -> Any:
        """Take null for the default, where there is one: libraries of clients send it for what is left out."""
        required = {name for name, field in cls.model_fields.items() if field.is_required()}
        return without_nulls(given, cls.model_fields.keys() - required) if isinstance(given, dict) else given


def examples(*given: Document) -> ConfigDict:
    """Return settings of a request whose schema has examples."""
    return ConfigDict(json_schema_extra={"examples": list(given)})


def without_nulls(given: Mapping[str, Any], optional: Collection[str]) -> Document:
    """Return what is given, without null for what may be left out."""
    return {name: value for name, value in given.items() if value is not None or name not in optional}


class Click(Request):
    """A pixel of a photo, from the left and from the top."""

    view: Annotated[str, Field(min_length=1, max_length=500)]
    x: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
    y: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


_TYPES: Mapping[Kind, Any] = {
    "text": Text,
    "texts": list[Text],
    "negatives": Annotated[list[Text], Field(min_length=1)],
    "vector": Annotated[list[Finite], Field(min_length=1, max_length=8192)],
    "picture": Annotated[str, Field(max_length=LIMITS.body_bytes)],
    "point": Point,
    "pixel": Click,
    "threshold": Annotated[float, Field(allow_inf_nan=False, ge=-1, le=1)] | Literal["auto"],
    "share": Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)],
    "flag": bool,
    "span": Annotated[list[Finite], Field(min_length=2, max_length=2)],
}
_NOTES: Mapping[Kind, str] = {"picture": "; base64 of PNG, JPEG, WebP, TIFF, BMP or PPM"}


def _as_tuple(values: Any, _: Limits) -> tuple[Any, ...]:
    return tuple(values)


_READERS: Mapping[Kind, Callable[[Any, Limits], Any]] = {
    "texts": _as_tuple, "negatives": _as_tuple, "point": _as_tuple, "span": _as_tuple,
    "vector": lambda numbers, _: np.asarray(numbers, np.float32),
    "picture": lambda text, limits: decoded(from_base64(text, "image"), limits.pixels),
    "pixel": lambda click, _: (click.view, click.x, click.y),
}  # fmt: skip


def annotation(field: QueryField) -> Any:
    """Return the type of a field's JSON, with its bounds and its meaning."""
    kind: Any = Literal[field.choices] if field.choices else _TYPES[field.kind]
    if field.most > 1:
        kind = Annotated[kind, Field(max_length=field.most)]
    about = Field(description=field.meaning + _NOTES.get(field.kind, ""))
    return Annotated[kind | None if field.default is None else kind, about]


def default_of(field: QueryField) -> Any:
    """Return the JSON of a field that is left out."""
    return list(field.default) if isinstance(field.default, tuple) else field.default


def asking(*places: Place, of: Sequence[QueryField] = FIELDS) -> Callable[[type[M]], type[M]]:
    """Give a model the fields of a query that are offered in all of some places, but those that it has itself."""

    def extended(model: type[M]) -> type[M]:
        offered = [field for field in fields(*places, of=of) if field.name not in model.model_fields]
        more: Any = {field.name: (annotation(field), default_of(field)) for field in offered}
        base = create_model("QueryFields", **more)
        about = {"__doc__": model.__doc__, "__module__": model.__module__}
        return new_class(model.__name__, (model, base), exec_body=lambda body: body.update(about))

    return extended


def values_of(given: Mapping[str, Any], limits: Limits = LIMITS, of: Sequence[QueryField] = FIELDS) -> Document:
    """Return what a request gives of some fields, as `Query` takes it. Raises: InputError: no picture, or too large."""
    values = {field: given.get(field.name) for field in of}
    return {
        field.name: _READERS[field.kind](value, limits) if field.kind in _READERS else value
        for field, value in values.items()
        if value is not None
    }


def asks_something(asked: BaseModel) -> bool:
    return any(getattr(asked, field.name, None) is not None for field in SUBJECTS)


def query_of(asked: BaseModel, limits: Limits = LIMITS) -> engine.Query:
    """Return the engine's query. Raises: InputError: not one of the five, or a picture that is damaged or too large."""
    return engine.Query(**values_of(vars(asked), limits))


def cut_of(asked: BaseModel) -> engine.Cut:
    return engine.Cut(**values_of(vars(asked), of=CUT))


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


SceneNames = Annotated[list[Annotated[str, Field(min_length=1, max_length=200)]], Field(max_length=64)]


@asking(Place.HTTP, Place.CATALOGUE)
class AskCatalogue(Request):
    """Exactly one of text, vector and image; and which objects are looked at."""

    top: Annotated[int, Field(ge=1, le=LIMITS.matches)] = 10
    """matches to return, best first"""
    scenes: SceneNames = Field([])
    """names of scenes to search; none for all"""
    box: Annotated[list[Finite], Field(min_length=6, max_length=6)] | None = None
    """lowest and highest corner of a box that centres lie in, in the world of each scene"""
    area: Annotated[list[Finite], Field(min_length=4, max_length=4)] | None = None
    """west, south, east and north in degrees, of scenes with a georeference"""
    since: Annotated[str, Field(max_length=40)] | None = None
    """time of the oldest addition, ISO 8601 with its zone"""

    model_config = examples({"text": "red mug", "top": 5})


class CatalogueMatch(Body):
    """An object of one of the scenes, with its oriented box in that scene's world."""

    scene: str
    tile: int
    object_id: int
    """its number in the scene, as from /scenes/{scene}/objects"""
    label: str | None
    """the name that people gave it"""
    name: str | None
    """the best word for it, where one was known"""
    score: float
    center: Vector
    extent: Vector
    """full lengths of the box along its axes"""
    axes: list[Vector]
    position: EarthPosition | None
    """on the Earth, where the scene has a georeference"""
    num_gaussians: int
    num_views: int
    sure: float
    photo: str | None
    """the photo that shows it best"""
    mask: int | None
    """its mask there"""
    added: str
    field: str
    """fingerprint of the field that it is of"""
    picture: str | None
    """where to get its thumbnail, a JPEG"""


class CatalogueAnswer(Body):
    query: str
    num_matches: int
    matches: list[CatalogueMatch]
    """best first, of all scenes"""
    measure: str
    """cosine or relevancy"""
    threshold: float
    threshold_rule: str
    num_compared: int
    exact: bool
    """whether no index was used"""
    advice: str = ""


class CatalogueScene(Body):
    name: str
    num_objects: int
    num_agreed: int
    """of its objects, those that photos agree on, or that have a label"""
    added: str
    state: str
    """current, changed (its field is another one now), missing or unknown"""


class CatalogueScenes(Body):
    scenes: list[CatalogueScene]
    num_objects: int


def catalogue_reply(catalogue: Catalogue, act: str, asked: Mapping[str, Any], limits: Limits) -> Reply:
    """Answer an act: "catalogue-list", "catalogue-ask" or "catalogue-picture". Raises: DrSplatError."""
    if act == "catalogue-picture":
        return Reply(catalogue.thumbnail(asked["scene"], asked["object_id"], asked["tile"]), JPEG)
    if act == "catalogue-ask":
        return Reply(_answered(catalogue, AskCatalogue(**asked), limits).model_dump_json().encode())
    listed = catalogue.scenes()
    scenes = [CatalogueScene(**vars(one) | {"name": one.scene, "added": one.added.isoformat()}) for one in listed]
    answer = CatalogueScenes(scenes=scenes, num_objects=sum(one.num_objects for one in listed))
    return Reply(answer.model_dump_json().encode())


def _answered(catalogue: Catalogue, asked: AskCatalogue, limits: Limits) -> CatalogueAnswer:
    query = query_of(asked, limits)
    answer = catalogue.answer(query, _where(asked), top=asked.top)
    matches = []
    for entry in answer.entries:
        which = urlencode({"scene": entry.scene, "object_id": entry.object_id, "tile": entry.tile})
        picture = None if entry.thumbnail is None else f"/catalogue/picture?{which}"
        matches.append(CatalogueMatch(**entry.json(), picture=picture))
    return CatalogueAnswer(
        query=query.text or "",
        matches=matches,
        **answer.json() | {"threshold": significant(answer.threshold)},
        advice="" if matches else "no match in any scene: try other words, or a lower threshold",
    )


def _where(asked: AskCatalogue) -> Conditions:
    """Return the conditions of a request. Raises: InputError: a box or an area that is none, or no time."""
    box, area = (None if given is None else tuple(given) for given in (asked.box, asked.area))
    try:
        since = None if asked.since is None else datetime.fromisoformat(asked.since)
    except ValueError:
        raise InputError("since: expected a time as 2026-11-22T14:00:00Z") from None
    return Conditions(tuple(asked.scenes), box, area, since)  # type: ignore[arg-type]
