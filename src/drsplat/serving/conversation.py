"""What a language model can ask: each method is a tool, with short answers that it can reason on."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from .. import query as engine
from ..errors import InputError
from ..query.objects import object_of, objects_of
from ..query.regions import region
from ..query.relations import Relation, related
from ..query.spatial import gap, standing_on
from .catalog import Catalog
from .models import (
    UNITS,
    Body,
    Fingerprint,
    Located,
    Match,
    ObjectList,
    SceneList,
    Vector,
    Word,
    decimals_of,
    matches_of,
    measured,
    object_list,
    rounded,
    summarized,
)
from .pictures import png

MOST_MATCHES, MOST_OBJECTS, MOST_TEXT, PICTURE_SIDE, FEW = 20, 100, 200, 768, 8


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
    """What positions and lengths in a scene mean."""

    scene: str
    low: Vector = Field(description="corner of the box of the middle 98 % of the Gaussians")
    high: Vector
    up: Vector | None = Field(None, description="unit direction that is up; null where unknown")
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


@dataclass(frozen=True)
class Conversation:
    """The tools, over the scenes of a catalog. All raise DrSplatError with what to do next."""

    catalog: Catalog

    def list_scenes(self) -> SceneList:
        scenes = [summarized(one) for one in self.catalog.summaries()]
        advice = "" if scenes else "there is no scene: ask the user to add a folder with a field"
        return SceneList(scenes=scenes, advice=advice)

    def about_scene(self, scene: str) -> About:
        name, opened = self._named(scene)
        digits, names = decimals_of(opened), [view.name for view in opened.views]
        up = None if opened.up is None else rounded(opened.up, 4)
        low, high = opened.box
        return About(
            scene=name,
            low=rounded(low, digits),
            high=rounded(high, digits),
            up=up,
            num_photos=len(names),
            some_photos=names[:: max(1, len(names) // FEW)][:FEW],
            field=opened.field.fingerprint,
            advice="" if up else "the photos do not tell which way is up: count and locate know no 'on'",
        )

    def locate(self, text: str, on: str | None, scene: str, top: int) -> Located:
        opened = self._scene(scene)
        answer = opened.ask(_text(text))
        every = opened.locate(answer)
        found = every if on is None else standing_on(opened, every, on)
        return Located(
            query=_query(text, on),
            num_matches=len(found),
            matches=matches_of(found[:top], decimals_of(opened)),
            advice=_advice(text, every, found, on),
            measured=measured(answer),
            field=opened.field.fingerprint,
        )

    def count(self, text: str, on: str | None, scene: str) -> Count:
        opened = self._scene(scene)
        every = opened.locate(_text(text))
        counted = every if on is None else standing_on(opened, every, on)
        digits = decimals_of(opened)
        return Count(
            query=_query(text, on),
            count=len(counted),
            of=len(every),
            centers=[rounded(match.center, digits) for match in counted[:MOST_MATCHES]],
            field=opened.field.fingerprint,
            advice=_advice(text, every, counted, on),
        )

    def where_is(self, text: str, scene: str) -> Place:
        opened = self._scene(scene)
        found = opened.locate(_text(text))
        if not found:
            return Place(
                query=text, best=None, others=0, best_view=None, field=opened.field.fingerprint, advice=_absent(text)
            )
        return Place(
            query=text,
            best=matches_of(found[:1], decimals_of(opened))[0],
            others=len(found) - 1,
            best_view=opened.best_view(found[0].gaussian_ids).name if opened.views else None,
            field=opened.field.fingerprint,
        )

    def how_far_apart(self, first: str, second: str, scene: str) -> Distance:
        opened = self._scene(scene)
        one, other = (self._best(opened, text) for text in (first, second))
        if np.intersect1d(one.gaussian_ids, other.gaussian_ids).size:
            raise InputError(
                f"'{first}' and '{second}' mean the same place here: describe each more exactly, e.g. by colour"
            )
        offset, digits = other.center - one.center, decimals_of(opened)
        return Distance(
            first=first,
            second=second,
            center_distance=round(float(np.linalg.norm(offset)), digits),
            gap=round(gap(opened.gaussians, one, other), digits),
            offset=rounded(offset, digits),
            first_center=rounded(one.center, digits),
            second_center=rounded(other.center, digits),
            field=opened.field.fingerprint,
        )

    def what_is_at(
        self, place: tuple[float, float, float] | tuple[str, float, float], scene: str,
        names: list[str] | None,
    ) -> Here:  # fmt: skip
        opened = self._scene(scene)
        words = opened.what_is(place, _names(names))
        point = _point(opened, place)
        return Here(
            point=rounded(point, decimals_of(opened)),
            words=[Word(name=word.text, score=round(word.score, 4)) for word in words],
            field=opened.field.fingerprint,
        )

    def list_objects(self, scene: str, top: int) -> ObjectList:
        opened = self._scene(scene)
        found = opened.objects
        advice = f"the {top} largest of {len(found)}" if len(found) > top else ""
        return object_list(opened, found[:top], advice if found else "photos agree on nothing here: use locate")

    def relations(self, relation: Relation, to: str, and_to: str | None, scene: str) -> Related:
        opened = self._scene(scene)
        end = self._object(opened, to)
        other = None if and_to is None else self._object(opened, and_to)
        found = related(opened.gaussians, relation, opened.objects, end, other, opened.up)
        listed = object_list(opened, found[:MOST_MATCHES], "" if found else "no object is so: list_objects has all")
        numbers = [one.object_id for one in (end, other) if one is not None]
        return Related(**listed.model_dump(), relation=relation, to=numbers)

    def describe_region(self, center: list[float], radius: float, scene: str, names: list[str] | None) -> Region:
        opened = self._scene(scene)
        if len(center) != 3:
            raise InputError(f"center: expected [x, y, z], got {len(center)} numbers")
        parts = region(opened, (center[0], center[1], center[2]), radius, _names(names))
        digits = decimals_of(opened)
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
        return Region(
            center=rounded(center, digits), radius=radius, parts=listed, field=opened.field.fingerprint, advice=advice
        )

    def show(self, text: str | None, view: str | None, scene: str) -> tuple[Shown, bytes]:
        opened = self._scene(scene)
        ids, advice, count = None, "", 0
        if text:
            found = opened.locate(_text(text))
            count = len(found)
            ids = np.concatenate([m.gaussian_ids for m in found] or [np.empty(0, np.int64)])
            advice = "" if found else _absent(text)
        chosen = opened.view(view) if view else opened.best_view(ids if count else None)
        pixels = opened.picture(chosen, ids, max_side=PICTURE_SIDE)
        height, width = pixels.shape[:2]
        shown = Shown(
            view=chosen.name,
            query=text,
            num_matches=count,
            width=width,
            height=height,
            field=opened.field.fingerprint,
            advice=advice,
        )
        return shown, png(pixels)

    def _scene(self, name: str) -> engine.Scene:
        return self._named(name)[1]

    def _named(self, name: str) -> tuple[str, engine.Scene]:
        chosen = name or self.catalog.only()
        if not chosen:
            known = ", ".join(map(repr, list(self.catalog.folders())[:MOST_MATCHES])) or "none"
            raise InputError(f"name a scene; there are: {known}")
        return chosen, self.catalog.scene(chosen)

    def _object(self, scene: engine.Scene, text: str) -> engine.Match:
        """By its number, its label, or the largest match of words: as an object, where it is most of one."""
        every = scene.objects
        if text.isascii() and text.isdecimal() and len(text) < 10:
            objects_of(scene.field).thing(int(text))  # or the error that says which there are
            return every[int(text)]
        labelled = [one for one in every if one.label and one.label.casefold() == text.strip().casefold()]
        if labelled:
            return labelled[0]
        found = scene.locate(_text(text))
        if not found:
            raise InputError(_absent(text))
        match = max(found, key=len)
        number = object_of(scene.field, match)
        return match if number is None else every[number]

    def _best(self, scene: engine.Scene, text: str) -> engine.Match:
        found = scene.locate(_text(text), top=1)
        if not found:
            raise InputError(_absent(text))
        return found[0]


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
