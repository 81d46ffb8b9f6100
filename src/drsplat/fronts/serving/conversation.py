"""Conversation of a language model with a scene: each method is a tool with a short answer to reason on."""

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import Field

from ... import query as engine
from ...base.arrays import Vector3
from ...base.contents import Document
from ...errors import InputError
from ...query.documents import rounded
from ...query.objects import object_of, objects_of
from ...query.regions import region
from ...query.relations import OfTwo, Relation, gap, related, standing_on
from ...query.schema import CUT, Place, QueryField, fields
from ...query.suggesting import missed_text, words_instead
from ...scene.boxes import BoxKind
from .guards import Limits
from .models import (
    About,
    BestMatch,
    Body,
    Count,
    Distance,
    Located,
    ObjectList,
    Part,
    PointWords,
    Region,
    Related,
    RenderedPicture,
    RenderedView,
    When,
    Word,
    decimals_of,
    frame_document,
    ids_of,
    listed_objects,
    matches_of,
    measured,
    object_list,
)
from .query_fields import values_of
from .replies import png

MAX_MATCHES, MAX_OBJECTS, MAX_NAMES, MAX_TEXT_CHARACTERS, MAX_PHOTOS = 20, 100, 100, 200, 8
MAX_TRACK_TIMES = 12  # a model reads every number
PICTURE_SIDE_PIXELS = 768

Text = Annotated[str, Field(description="query in a few words, e.g. 'red mug'", max_length=MAX_TEXT_CHARACTERS)]
On = Annotated[
    str | None,
    Field(description="only those that stand on this, e.g. 'table'", min_length=1, max_length=MAX_TEXT_CHARACTERS),
]
Names = Annotated[
    list[Annotated[str, Field(max_length=MAX_TEXT_CHARACTERS)]] | None,
    Field(
        description="words to choose from; may be left out for encoders that know a list",
        min_length=1, max_length=MAX_NAMES,
    ),
]  # fmt: skip
WorldPoint = Annotated[list[float], Field(description="[x, y, z], world", min_length=3, max_length=3)]
Boxes = Annotated[
    BoxKind, Field(description="upright: the third axis of boxes is up; free: along the match's own axes")
]
M = TypeVar("M", bound=Callable[..., Body])


class ToolEntry(NamedTuple):
    """Method of `Conversation` that is a tool. cut: the fields of a query that it takes beside its own arguments."""

    title: str
    method: Callable[..., Body]
    cut: list[QueryField]


TOOLS: dict[str, ToolEntry] = {}


def _tool(title: str, *places: Place) -> Callable[[M], M]:
    """Make a method a tool. places: sorts of queries whose measuring and cutting its `**cut` takes."""

    def add(method: M) -> M:
        TOOLS[method.__name__] = ToolEntry(title, method, fields(*places, of=CUT) if places else [])
        return method

    return add


@dataclass(frozen=True)
class Conversation:
    """The tools, over an opened scene and its name. All raise DrSplatError with what to do next."""

    scene: engine.Scene
    name: str

    @_tool("About a scene")
    def about_scene(self) -> About:
        """Describe a scene: its size, where it lies, which way is up, the unit of lengths, some of its photos."""
        names = [view.name for view in self.scene.views]
        known = self.scene.up is not None
        return About(
            **frame_document(self.scene),
            scene=self.name,
            num_photos=len(names),
            some_photos=names[:: max(1, len(names) // MAX_PHOTOS)][:MAX_PHOTOS],
            advice="" if known else "the photos do not tell which way is up: count and locate know no 'on'",
        )

    @_tool("Locate matches", Place.MCP)
    def locate(
        self, text: Text, on: On = None, top: Annotated[int, Field(ge=1, le=MAX_MATCHES, description="most matches to "
        "list")] = 5, box: Boxes = "upright", tracks: Annotated[bool, Field(description="tell where each is over time, "
        "and when photos see it, of a scene that moves")] = False, **cut: Any,
    ) -> Located:  # fmt: skip
        """List the matches of a text, best first: centre, oriented box, score and supporting photos."""
        answer = self.scene.ask(_query_of(text, cut))
        every = self.scene.locate(answer, box=box)
        matches = self._standing_on(on, every, cut)
        return Located(
            query=_query(text, on),
            count=sum(match.sure for match in matches),
            num_matches=len(matches),
            matches=matches_of(self.scene, matches[:top], box if tracks else None, MAX_TRACK_TIMES),
            advice=self._advice(text, every, matches, on),
            measured=measured(answer),
            field=self._field,
        )

    @_tool("Count matches", Place.MCP)
    def count(self, text: Text, on: On = None, **cut: Any) -> Count:
        """Count what a text surely means, in the scene or standing on something."""
        answer = self.scene.ask(_query_of(text, cut))
        matches = self.scene.locate(answer)
        every = [match for match in matches if match.sure]
        counted = self._standing_on(on, every, cut)
        digits = decimals_of(self.scene)
        return Count(
            query=_query(text, on),
            count=len(counted),
            of=len(every),
            centers=[rounded(match.center, digits) for match in counted[:MAX_MATCHES]],
            field=self._field,
            advice=f"maybe {len(matches)}: {answer.doubt}"
            if matches and not every
            else self._advice(text, every, counted, on),
        )

    @_tool("Where is it", Place.MCP)
    def where_is(self, text: Text, **cut: Any) -> BestMatch:
        """Find the best match of a text: where it is, how large it is, and the photo that shows it best."""
        answer = self.scene.ask(_query_of(text, cut))
        found = self.scene.locate(answer)
        if not found:
            return BestMatch(
                query=text, best=None, others=0, best_view=None, field=self._field, advice=self._absent(text)
            )
        return BestMatch(
            query=text,
            best=matches_of(self.scene, found[:1])[0],
            others=len(found) - 1,
            best_view=self.scene.best_view(found[0].gaussian_ids).name if self.scene.views else None,
            field=self._field,
            advice=answer.doubt,
        )

    @_tool("How far apart", Place.MCP)
    def how_far_apart(self, first: Text, second: Text, **cut: Any) -> Distance:
        """Measure the distance of the best matches of two texts: centre to centre, and between their nearest parts."""
        one, other = (self._best(_query_of(text, cut)) for text in (first, second))
        if np.intersect1d(one.gaussian_ids, other.gaussian_ids).size:
            raise InputError(
                f"'{first}' and '{second}' mean the same place here: describe each more exactly, e.g. by colour"
            )
        offset, digits = other.center - one.center, decimals_of(self.scene)
        return Distance(
            first=first,
            second=second,
            center_distance=round(float(np.linalg.norm(offset)), digits),
            gap=round(gap(self.scene.rows, one, other), digits),
            offset=rounded(offset, digits),
            first_center=rounded(one.center, digits),
            second_center=rounded(other.center, digits),
            field=self._field,
        )

    @_tool("What is at a point")
    def what_is_at(self, point: WorldPoint, names: Names = None) -> PointWords:
        """Name what is at a point of the scene, best words first."""
        x, y, z = point
        nearest = np.array([self.scene.nearest((x, y, z))])
        return self._words_at((x, y, z), self.scene.rows.shapes_of(nearest).positions[0], names)

    @_tool("What is at a pixel")
    def what_is_at_pixel(
        self,
        view: Annotated[str, Field(description="a photo's name, as where_is and show return")],
        x: Annotated[float, Field(description="pixels from the left of the photo")],
        y: Annotated[float, Field(description="pixels from the top")],
        names: Names = None,
    ) -> PointWords:
        """Name what a pixel of a photo shows, and tell where that is in the scene."""
        return self._words_at((view, x, y), self.scene.point_at((view, x, y)), names)

    @_tool("List objects")
    def list_objects(
        self,
        top: Annotated[int, Field(ge=1, le=MAX_OBJECTS, description="most objects to list")] = 20,
        unsure: Annotated[bool, Field(description="list also what photos agree less on, most of it scraps")] = False,
    ) -> ObjectList:
        """List what is in a scene, largest first, without words for it: number, name if known, box, photos."""
        found, left = listed_objects(self.scene, unsure)
        if not found and not left:
            return object_list(self.scene, [], "photos agree on nothing here: use locate")
        cut = f"the {top} largest of {len(found)}" if len(found) > top else ""
        more = f"{left} more that photos agree less on, most of them scraps: unsure=true lists them" if left else ""
        return object_list(self.scene, found[:top], ". ".join(filter(None, (cut, more))))

    @_tool("How objects lie")
    def relations(
        self,
        relation: Relation,
        to: Annotated[str, Field(description="number from list_objects, or a text", min_length=1, max_length=200)],
        and_to: Annotated[str | None, Field(description="the second one, for 'between' only", max_length=200)] = None,
    ) -> Related:
        """Find the objects on, in, next to or above one, or between two, such as what lies on the table."""
        end = self._object(to)
        other = None if and_to is None else self._object(and_to)
        found = related(self.scene.rows, relation, self.scene.objects, end, other, self.scene.up)
        advice = "" if found else "no object is so: list_objects has all"
        listed = object_list(self.scene, found[:MAX_MATCHES], advice)
        numbers = [one.object_id for one in (end, other) if one is not None]
        return Related(**listed.model_dump(), relation=relation, to=numbers)

    @_tool("When does it hold", Place.MCP, Place.WORDS)
    def when(
        self, one: Text, relation: Annotated[OfTwo, Field(description="relation of the one to the other; left and "
        "right as seen from view")], other: Text,
        view: Annotated[str | None, Field(description="a photo's name, for left_of and right_of only")] = None,
        **cut: Any,
    ) -> When:  # fmt: skip
        """Find the spans of time in which one match stands in a relation to another, in a scene that moves."""
        first, second = (_query_of(text, cut) for text in (one, other))
        return when_told(self.scene, first, relation, second, view)

    @_tool("Describe a region")
    def describe_region(
        self, center: WorldPoint, radius: Annotated[float, Field(gt=0, description="scene units")], names: Names = None
    ) -> Region:
        """Name what lies within a radius of a point: names, how much of the region each is, and where."""
        x, y, z = center
        parts = region(self.scene, (x, y, z), radius, names)
        digits = decimals_of(self.scene)
        listed = [
            Part(**one._asdict() | {"share": round(one.share, 4), "center": rounded(one.center, digits)})
            for one in parts[:MAX_MATCHES]
        ]
        advice = "" if listed else "none of these words fits what is there: give other names, or a larger radius"
        return Region(center=rounded(center, digits), radius=radius, parts=listed, field=self._field, advice=advice)

    @_tool("Show a picture", Place.MCP)
    def show(
        self,
        text: Annotated[
            str | None,
            Field(description="kept in colour, the rest grey; left out: all as it is", max_length=MAX_TEXT_CHARACTERS),
        ] = None,
        view: Annotated[str | None, Field(description="a photo's name; left out: the best one")] = None,
        **cut: Any,
    ) -> RenderedPicture:
        """Render a picture (PNG) of the scene, optionally with the matches of a text kept in colour."""
        ids, advice, count = None, "", 0
        if text:
            found = self.scene.locate(_query_of(text, cut))
            count, ids = len(found), ids_of(found)
            advice = "" if found else self._absent(text)
        chosen = self.scene.view(view) if view else self.scene.best_view(ids if count else None)
        pixels = self.scene.picture(chosen, ids, max_side=PICTURE_SIDE_PIXELS)
        height, width = pixels.shape[:2]
        sizes = {"num_matches": count, "width": width, "height": height}
        shown = RenderedView(view=chosen.name, query=text, **sizes, field=self._field, advice=advice)
        return RenderedPicture(view=shown, png=base64.b64encode(png(pixels)).decode())

    @property
    def _field(self) -> str:
        return self.scene.field.fingerprint

    def _advice(self, text: str, every: list[engine.Match], found: list[engine.Match], on: str | None) -> str:
        if found:
            return ""
        if every:
            return f"{len(every)} in the scene, but none on the {on}: where_is says where"
        return self._absent(text)

    def _absent(self, text: str) -> str:
        answer = self.scene.ask(text)
        return (
            f"no match for '{text[:60]}': try a more general word or a synonym, add the colour, or see what is there "
            f"with describe_region. {missed_text(answer, words_instead(self.scene, answer))}".rstrip()
        )

    def _standing_on(self, on: str | None, matches: list[engine.Match], cut: Document) -> list[engine.Match]:
        """Return the matches that stand on another text's, wherever that is at any time; all for None."""
        return matches if on is None else standing_on(self.scene, matches, _query_of(on, {**cut, "during": None}))

    def _words_at(
        self, place: tuple[float, float, float] | tuple[str, float, float], point: Vector3, names: list[str] | None
    ) -> PointWords:
        words = words_of(self.scene.what_is(place, names))
        return PointWords(point=rounded(point, decimals_of(self.scene)), words=words, field=self._field)

    def _object(self, text: str) -> engine.Match:
        """Find it by its number, its label, or the largest match of words: as an object, where it is most of one."""
        every = self.scene.objects
        if text.isascii() and text.isdecimal() and len(text) < 10:
            objects_of(self.scene.field).thing(int(text))  # or the error that says which there are
            return every[int(text)]
        named, things = self.scene.labels.called(text), objects_of(self.scene.field)
        labelled = [one for one in every if one.object_id is not None and things.thing(one.object_id) in named]
        if labelled:
            return labelled[0]
        found = [one for one in self.scene.locate(text) if one.sure]
        if not found:
            raise InputError(self._absent(text))
        match = max(found, key=len)
        number = object_of(self.scene.field, match)
        return match if number is None else every[number]

    def _best(self, query: engine.Query) -> engine.Match:
        found = self.scene.locate(query, top=1)
        if not found or not found[0].sure:
            raise InputError(self._absent(query.text or ""))
        return found[0]


def tool_answer(scene: engine.Scene, asked: Document, _: Limits) -> Body:
    """Return a tool's answer with the reasons not to rely on words in its scene, if there are any.

    asked: the `tool`, the `name` of the scene here, and `arguments`.
    """
    answer = TOOLS[asked["tool"]].method(Conversation(scene, asked["name"]), **asked["arguments"])
    advice, doubts = getattr(answer, "advice", None), (scene.doubt, scene.background.list_doubt)
    if advice is None or not any(doubts):
        return answer
    return answer.model_copy(update={"advice": ". ".join(filter(None, (advice, *doubts)))})


def _query(text: str, on: str | None) -> str:
    return text if on is None else f"{text} on {on}"


def _query_of(text: str, cut: Document) -> engine.Query:
    return engine.Query(text, **values_of(cut, of=CUT))


def when_told(
    scene: engine.Scene, one: engine.Query, relation: str, other: engine.Query, view: str | None = None
) -> When:
    """Return when two queries stand in a relation. Raises: as `Scene.when`."""
    spans = scene.when(one, relation, other, view)
    return When(
        one=one.text or "",
        relation=relation,
        other=other.text or "",
        spans=[list(span) for span in spans],
        times=list(scene.moving.span),
        field=scene.field.fingerprint,
        advice="" if spans else "at no time; locate with tracks says where each is",
    )


def words_of(words: Sequence[engine.Word]) -> list[Word]:
    return [Word(name=word.text, score=round(word.score, 4)) for word in words]
