"""Conversation of a language model with a scene: each method is a tool with a short answer to reason on."""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from ... import query as engine
from ...errors import InputError
from ...query.defaults import AUTO
from ...query.objects import object_of, objects_of
from ...query.regions import region
from ...query.relations import Relation, related
from ...query.spatial import gap, standing_on
from ...scene.boxes import BoxKind
from .limits import Limits
from .models import (  # fmt: skip
    UNITS,
    Body,
    Fingerprint,
    Located,
    Match,
    ObjectList,
    Span,
    Vector,
    When,
    Word,
    decimals_of,
    listed_objects,
    matches_of,
    measured,
    object_list,
    rounded,
    span_of,
    tracked,
    when_told,
)
from .pictures import png
from .requests import Tool

Range = Sequence[float]
MOST_MATCHES, MOST_OBJECTS, MOST_TEXT, PICTURE_SIDE, FEW = 20, 100, 200, 768, 8
MOST_TIMES = 12  # of a track: a model reads every number


class Count(Body):
    query: str
    count: int
    of: int = Field(description="how many there are in the whole scene")
    centers: list[Vector] = Field(description="of the matches counted, best score first")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Place(Body):
    query: str
    best: Match | None = Field(None, description="null where nothing matches")
    others: int = Field(0, description="further matches that fit less well")
    best_view: str | None = Field(None, description="the photo that shows most of it")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Distance(Body):
    first: str
    second: str
    center_distance: float = Field(description="between the centres of the two")
    gap: float = Field(description="between their nearest parts")
    offset: Vector = Field(description="from the centre of the first to that of the second")
    first_center: Vector
    second_center: Vector
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Here(Body):
    point: Vector = Field(description="centre of the Gaussian that is there")
    words: list[Word] = Field(description="best first")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Part(Body):
    name: str
    share: float = Field(description="of the registered Gaussians in the region")
    num_gaussians: int
    center: Vector


class Region(Body):
    center: Vector
    radius: float
    parts: list[Part]
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class About(Body):
    """Frame of a scene: the meaning of its positions and lengths."""

    scene: str
    low: Vector = Field(description="corner of the box of the middle 98 % of the Gaussians")
    high: Vector
    up: Vector | None = Field(None, description="unit direction that is up; null where unknown")
    times: Annotated[Span | None, Field(description="first and last time of a scene that moves, else null")] = None
    num_photos: int
    some_photos: list[str] = Field(description="names of a few, for show and what_is_at_pixel")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Related(ObjectList):
    relation: str
    to: list[int | None] = Field(description="the objects that they are related to; null for a place that is none")


class Shown(Body):
    view: str
    query: str | None
    num_matches: int
    width: int
    height: int
    field: Fingerprint = ""
    advice: str = ""


class Pictured(Body):
    """png: base64."""

    shown: Shown
    png: str


@dataclass(frozen=True)
class Conversation:
    """The tools, over an opened scene and its name. All raise DrSplatError with what to do next."""

    scene: engine.Scene
    name: str

    def about_scene(self) -> About:
        digits, names = decimals_of(self.scene), [view.name for view in self.scene.views]
        up = None if self.scene.up is None else rounded(self.scene.up, 4)
        low, high = self.scene.box
        return About(
            scene=self.name,
            low=rounded(low, digits),
            high=rounded(high, digits),
            up=up,
            times=span_of(self.scene),
            num_photos=len(names),
            some_photos=names[:: max(1, len(names) // FEW)][:FEW],
            field=self._field,
            advice="" if up else "the photos do not tell which way is up: count and locate know no 'on'",
        )

    def locate(
        self, text: str, on: str | None = None, top: int = 5, box: BoxKind = "upright", during: Range | None = None,
        tracks: bool = False, objects: str = AUTO,
    ) -> Located:  # fmt: skip
        answer = self.scene.ask(_query_of(text, during, objects))
        every = self.scene.locate(answer, box=box)
        found = every if on is None else standing_on(self.scene, every, _query_of(on, objects=objects))
        return Located(
            query=_query(text, on),
            num_matches=len(found),
            matches=tracked(self.scene, found[:top], box, MOST_TIMES)
            if tracks
            else matches_of(found[:top], decimals_of(self.scene)),
            advice=_advice(text, every, found, on),
            measured=measured(answer),
            field=self._field,
        )

    def count(self, text: str, on: str | None = None, during: Range | None = None, objects: str = AUTO) -> Count:
        every = self.scene.locate(_query_of(text, during, objects))
        counted = every if on is None else standing_on(self.scene, every, _query_of(on, objects=objects))
        digits = decimals_of(self.scene)
        return Count(
            query=_query(text, on),
            count=len(counted),
            of=len(every),
            centers=[rounded(match.center, digits) for match in counted[:MOST_MATCHES]],
            field=self._field,
            advice=_advice(text, every, counted, on),
        )

    def where_is(self, text: str, during: Range | None = None, objects: str = AUTO) -> Place:
        found = self.scene.locate(_query_of(text, during, objects))
        if not found:
            return Place(query=text, best=None, others=0, best_view=None, field=self._field, advice=_absent(text))
        return Place(
            query=text,
            best=matches_of(found[:1], decimals_of(self.scene))[0],
            others=len(found) - 1,
            best_view=self.scene.best_view(found[0].gaussian_ids).name if self.scene.views else None,
            field=self._field,
        )

    def how_far_apart(self, first: str, second: str, objects: str = AUTO) -> Distance:
        one, other = (self._best(_query_of(text, objects=objects)) for text in (first, second))
        if np.intersect1d(one.gaussian_ids, other.gaussian_ids).size:
            raise InputError(
                f"'{first}' and '{second}' mean the same place here: describe each more exactly, e.g. by colour"
            )
        offset, digits = other.center - one.center, decimals_of(self.scene)
        return Distance(
            first=first,
            second=second,
            center_distance=round(float(np.linalg.norm(offset)), digits),
            gap=round(gap(self.scene.gaussians, one, other), digits),
            offset=rounded(offset, digits),
            first_center=rounded(one.center, digits),
            second_center=rounded(other.center, digits),
            field=self._field,
        )

    def what_is_at(self, point: Sequence[float], names: list[str] | None = None) -> Here:
        return self._here((point[0], point[1], point[2]), names)

    def what_is_at_pixel(self, view: str, x: float, y: float, names: list[str] | None = None) -> Here:
        return self._here((view, x, y), names)

    def list_objects(self, top: int, unsure: bool = False) -> ObjectList:
        found, left = listed_objects(self.scene, unsure)
        if not found and not left:
            return object_list(self.scene, [], "photos agree on nothing here: use locate")
        cut = f"the {top} largest of {len(found)}" if len(found) > top else ""
        more = f"{left} more that photos agree less on, most of them scraps: unsure=true lists them" if left else ""
        return object_list(self.scene, found[:top], ". ".join(filter(None, (cut, more))))

    def relations(self, relation: Relation, to: str, and_to: str | None = None) -> Related:
        end = self._object(to)
        other = None if and_to is None else self._object(and_to)
        found = related(self.scene.gaussians, relation, self.scene.objects, end, other, self.scene.up)
        advice = "" if found else "no object is so: list_objects has all"
        listed = object_list(self.scene, found[:MOST_MATCHES], advice)
        numbers = [one.object_id for one in (end, other) if one is not None]
        return Related(**listed.model_dump(), relation=relation, to=numbers)

    def when(self, one: str, relation: str, other: str, view: str | None = None, objects: str = AUTO) -> When:
        first, second = (_query_of(text, objects=objects) for text in (one, other))
        return when_told(self.scene, first, relation, second, view)

    def describe_region(self, center: Sequence[float], radius: float, names: list[str] | None = None) -> Region:
        parts = region(self.scene, (center[0], center[1], center[2]), radius, _names(names))
        digits = decimals_of(self.scene)
        listed = [
            Part(
                name=one.name,
                share=round(one.share, 4),
                num_gaussians=one.num_gaussians,
                center=rounded(one.center, digits),
            )
            for one in parts[:MOST_MATCHES]
        ]
        advice = "" if listed else "none of these words fits what is there: give other names, or a larger radius"
        return Region(center=rounded(center, digits), radius=radius, parts=listed, field=self._field, advice=advice)

    def show(self, text: str | None = None, view: str | None = None, objects: str = AUTO) -> Pictured:
        ids, advice, count = None, "", 0
        if text:
            found = self.scene.locate(_query_of(text, objects=objects))
            count = len(found)
            ids = np.concatenate([m.gaussian_ids for m in found] or [np.empty(0, np.int64)])
            advice = "" if found else _absent(text)
        chosen = self.scene.view(view) if view else self.scene.best_view(ids if count else None)
        pixels = self.scene.picture(chosen, ids, max_side=PICTURE_SIDE)
        height, width = pixels.shape[:2]
        shown = Shown(
            view=chosen.name,
            query=text,
            num_matches=count,
            width=width,
            height=height,
            field=self._field,
            advice=advice,
        )
        return Pictured(shown=shown, png=base64.b64encode(png(pixels)).decode())

    @property
    def _field(self) -> str:
        return self.scene.field.fingerprint

    def _here(self, place: tuple[float, float, float] | tuple[str, float, float], names: list[str] | None) -> Here:
        words = self.scene.what_is(place, _names(names))
        return Here(
            point=rounded(_point(self.scene, place), decimals_of(self.scene)),
            words=[Word(name=word.text, score=round(word.score, 4)) for word in words],
            field=self._field,
        )

    def _object(self, text: str) -> engine.Match:
        """By its number, its label, or the largest match of words: as an object, where it is most of one."""
        every = self.scene.objects
        if text.isascii() and text.isdecimal() and len(text) < 10:
            objects_of(self.scene.field).thing(int(text))  # or the error that says which there are
            return every[int(text)]
        named, things = self.scene.labels.called(text), objects_of(self.scene.field)
        labelled = [one for one in every if one.object_id is not None and things.thing(one.object_id) in named]
        if labelled:
            return labelled[0]
        found = self.scene.locate(_text(text))
        if not found:
            raise InputError(_absent(text))
        match = max(found, key=len)
        number = object_of(self.scene.field, match)
        return match if number is None else every[number]

    def _best(self, query: engine.Query) -> engine.Match:
        found = self.scene.locate(query, top=1)
        if not found:
            raise InputError(_absent(query.text or ""))
        return found[0]


_TOOLS: Mapping[str, Callable[..., Body]] = {
    tool.__name__: tool
    for tool in (
        Conversation.about_scene,
        Conversation.locate,
        Conversation.count,
        Conversation.where_is,
        Conversation.how_far_apart,
        Conversation.what_is_at,
        Conversation.what_is_at_pixel,
        Conversation.list_objects,
        Conversation.relations,
        Conversation.when,
        Conversation.describe_region,
        Conversation.show,
    )
}


def tool_answer(scene: engine.Scene, asked: Tool, _: Limits) -> Body:
    """Return a tool's answer with the reason not to rely on names in its scene, if there is one."""
    answer = _TOOLS[asked.tool](Conversation(scene, asked.name), **asked.arguments)
    advice = [getattr(answer, "advice", None), scene.doubt]
    if None in advice or not scene.doubt:
        return answer
    return answer.model_copy(update={"advice": ". ".join(filter(None, advice))})


def _query(text: str, on: str | None) -> str:
    return text if on is None else f"{text} on {on}"


def _advice(text: str, every: list[engine.Match], found: list[engine.Match], on: str | None) -> str:
    if found:
        return ""
    if every:
        return f"{len(every)} in the scene, but none on the {on}: where_is says where"
    return _absent(text)


def _text(text: str) -> str:
    if not text.strip() or len(text) > MOST_TEXT:
        raise InputError(
            f"text: expected a few words that name an object, at most {MOST_TEXT} characters; got {len(text)}"
        )
    return text


def _query_of(text: str, during: Range | None = None, objects: str = AUTO) -> engine.Query:
    """Return the query of a text, of all times or a span of them."""
    span = None if during is None else (during[0], during[1])
    return engine.Query(_text(text), during=span, objects=objects)


def _names(names: list[str] | None) -> list[str] | None:
    if names is not None and (not 1 <= len(names) <= 100 or any(len(one) > MOST_TEXT for one in names)):
        raise InputError(f"names: expected 1 to 100 texts of at most {MOST_TEXT} characters")
    return names


def _absent(text: str) -> str:
    return (
        f"no match for '{text[:60]}': try a more general word or a synonym, add the colour, or see what is there "
        "with describe_region"
    )


def _point(scene: engine.Scene, place: tuple[float, float, float] | tuple[str, float, float]) -> np.ndarray:
    if isinstance(place[0], str):
        return scene.point_at((place[0], place[1], place[2]))
    return np.asarray(scene.gaussians.positions[scene.nearest((place[0], place[1], place[2]))])
