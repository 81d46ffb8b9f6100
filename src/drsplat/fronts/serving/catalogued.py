"""Requests to a catalogue, over HTTP and by language models, and their answers."""

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any
from urllib.parse import urlencode

from pydantic import Field

from ...errors import InputError
from ...query.catalogue import Catalogue, Conditions, Entry
from ...query.schema import Place
from .limits import Limits
from .models import Body, EarthPosition, Vector, significant
from .query_fields import LIMITS, Finite, Request, asking, examples, query_of
from .replies import JPEG, Reply

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


class CataloguePicture(Request):
    """The thumbnail of an object by its scene and number."""

    scene: str
    object_id: int
    tile: int


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
        which = CataloguePicture(**asked)
        return Reply(catalogue.thumbnail(which.scene, which.object_id, which.tile), JPEG)
    if act == "catalogue-ask":
        return Reply(_answered(catalogue, AskCatalogue(**asked), limits).model_dump_json().encode())
    listed = catalogue.scenes()
    scenes = [CatalogueScene(**vars(one) | {"name": one.scene, "added": one.added.isoformat()}) for one in listed]
    answer = CatalogueScenes(scenes=scenes, num_objects=sum(one.num_objects for one in listed))
    return Reply(answer.model_dump_json().encode())


def _answered(catalogue: Catalogue, asked: AskCatalogue, limits: Limits) -> CatalogueAnswer:
    query = query_of(asked, limits)
    answer = catalogue.answer(query, _where(asked), top=asked.top)
    return CatalogueAnswer(
        query=query.text or "",
        matches=[_match(entry) for entry in answer.entries],
        **answer.json() | {"threshold": significant(answer.threshold)},
        advice="" if answer.entries else "no match in any scene: try other words, or a lower threshold",
    )


def _match(entry: Entry) -> CatalogueMatch:
    which = urlencode({"scene": entry.scene, "object_id": entry.object_id, "tile": entry.tile})
    picture = None if entry.thumbnail is None else f"/catalogue/picture?{which}"
    return CatalogueMatch(**entry.json(), picture=picture)


def _where(asked: AskCatalogue) -> Conditions:
    """Return the conditions of a request. Raises: InputError: a box or an area that is none, or no time."""
    box, area = (None if given is None else tuple(given) for given in (asked.box, asked.area))
    try:
        since = None if asked.since is None else datetime.fromisoformat(asked.since)
    except ValueError:
        raise InputError("since: expected a time as 2026-11-22T14:00:00Z") from None
    return Conditions(tuple(asked.scenes), box, area, since)  # type: ignore[arg-type]
