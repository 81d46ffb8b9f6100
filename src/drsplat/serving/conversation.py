"""What a language model can ask: each method is a tool, with short answers that it can reason on."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from ..asking import AskableScene, Found, Question
from ..asking.regions import region
from ..asking.spatial import gap, stands_on
from ..errors import InputError
from ..tasks import Instance
from .catalog import Catalog
from .models import (
    UNITS,
    Answer,
    Fingerprint,
    SceneList,
    Thing,
    Things,
    Vector,
    Word,
    decimals_of,
    measured,
    rounded,
    summarized,
    things_of,
)
from .pictures import png

MOST_THINGS, MOST_TEXT, PICTURE_SIDE, FEW = 20, 200, 768, 8


class Count(Answer):
    query: str
    count: int
    of: int = Field(description="how many there are in the whole scene")
    centers: list[Vector] = Field(description="of the things counted, best score first")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Place(Answer):
    query: str
    found: bool
    best: Thing | None = None
    others: int = Field(0, description="further things that fit less well")
    best_view: str | None = Field(None, description="the photo that shows most of it")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Distance(Answer):
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


class Here(Answer):
    point: Vector = Field(description="centre of the Gaussian that was found there")
    names: list[Word] = Field(description="best first")
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class Part(Answer):
    name: str
    share: float = Field(description="of the registered Gaussians in the region")
    num_gaussians: int
    center: Vector


class Region(Answer):
    center: Vector
    radius: float
    things: list[Part]
    units: str = UNITS
    field: Fingerprint = ""
    advice: str = ""


class About(Answer):
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


class Shown(Answer):
    view: str
    query: str | None
    num_found: int
    width: int
    height: int
    field: Fingerprint = ""
    advice: str = ""


@dataclass(frozen=True)
class Conversation:
    """The questions, over the scenes of a catalog. All raise DrSplatError with what to do next."""

    catalog: Catalog

    def list_scenes(self) -> SceneList:
        scenes = [summarized(one) for one in self.catalog.summaries()]
        advice = "" if scenes else "there is no scene: ask the user to add a folder with a field"
        return SceneList(scenes=scenes, advice=advice)

    def about_scene(self, scene: str) -> About:
        name, opened = self._named(scene)
        digits, names = decimals_of(opened), [view.name for view in opened.views]
        up = None if opened.field.up is None else rounded(opened.field.up, 4)
        low, high = opened.box
        return About(
            scene=name,
            low=rounded(low, digits),
            high=rounded(high, digits),
            up=up,
            num_photos=len(names),
            some_photos=names[:: max(1, len(names) // FEW)][:FEW],
            field=opened.field.fingerprint,
            advice=""
            if up
            else "the photos do not tell which way is up: count and find know no 'on'",
        )

    def find(self, text: str, on: str | None, scene: str, limit: int) -> Things:
        opened = self._scene(scene)
        asked = opened.ask(Question(text=_text(text)))
        every = opened.find(asked)
        found = self._on(opened, every, on)
        advice = "" if every else _absent(text)
        if every and not found:
            advice = _none_on(len(every), on)
        return Things(
            query=_query(text, on),
            num_found=len(found),
            things=things_of(found[:limit], decimals_of(opened)),
            advice=advice,
            measured=measured(asked),
            field=opened.field.fingerprint,
        )

    def count(self, text: str, on: str | None, scene: str) -> Count:
        opened = self._scene(scene)
        every = opened.find(Question(text=_text(text)))
        counted = self._on(opened, every, on)
        advice = "" if every else _absent(text)
        if every and not counted:
            advice = _none_on(len(every), on)
        digits = decimals_of(opened)
        return Count(
            query=_query(text, on),
            count=len(counted),
            of=len(every),
            centers=[rounded(one.thing.center, digits) for one in counted[:MOST_THINGS]],
            field=opened.field.fingerprint,
            advice=advice,
        )

    def where_is(self, text: str, scene: str) -> Place:
        opened = self._scene(scene)
        found = opened.find(Question(text=_text(text)))
        if not found:
            return Place(
                query=text,
                found=False,
                others=0,
                best_view=None,
                field=opened.field.fingerprint,
                advice=_absent(text),
            )
        thing = found[0].thing
        view = opened.best_view(thing.gaussian_ids).name if opened.views else None
        return Place(
            query=text,
            found=True,
            best=things_of(found[:1], decimals_of(opened))[0],
            others=len(found) - 1,
            best_view=view,
            field=opened.field.fingerprint,
        )

    def how_far_apart(self, first: str, second: str, scene: str) -> Distance:
        opened = self._scene(scene)
        one, other = (self._best(opened, text) for text in (first, second))
        if np.intersect1d(one.gaussian_ids, other.gaussian_ids).size:
            raise InputError(
                f"'{first}' and '{second}' mean the same thing here: describe each more exactly, e.g. by colour"
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
        words = opened.what_is(place, _names(names), top=5)
        point = _point(opened, place)
        return Here(
            point=rounded(point, decimals_of(opened)),
            names=[Word(name=word.text, score=round(word.score, 4)) for word in words],
            field=opened.field.fingerprint,
        )

    def describe_region(
        self, center: list[float], radius: float, scene: str, names: list[str] | None
    ) -> Region:
        opened = self._scene(scene)
        if len(center) != 3:
            raise InputError(f"center: expected [x, y, z], got {len(center)} numbers")
        parts = region(opened, (center[0], center[1], center[2]), radius, _names(names))
        digits = decimals_of(opened)
        things = [
            Part(
                name=one.name,
                share=round(one.share, 4),
                num_gaussians=one.num_gaussians,
                center=rounded(one.center, digits),
            )
            for one in parts[:MOST_THINGS]
        ]
        advice = (
            ""
            if things
            else "nothing there is called by these words: give names, or a larger radius"
        )
        return Region(
            center=rounded(center, digits),
            radius=radius,
            things=things,
            field=opened.field.fingerprint,
            advice=advice,
        )

    def show(self, text: str | None, view: str | None, scene: str) -> tuple[Shown, bytes]:
        opened = self._scene(scene)
        ids, advice, count = None, "", 0
        if text:
            things = self._things(opened, text)
            count = len(things)
            ids = np.concatenate([t.gaussian_ids for t in things] or [np.empty(0, np.int64)])
            advice = "" if things else _absent(text)
        chosen = opened.view(view) if view else opened.best_view(ids if count else None)
        pixels = opened.picture(chosen, ids, max_side=PICTURE_SIDE)
        height, width = pixels.shape[:2]
        shown = Shown(
            view=chosen.name,
            query=text,
            num_found=count,
            width=width,
            height=height,
            field=opened.field.fingerprint,
            advice=advice,
        )
        return shown, png(pixels)

    def _scene(self, name: str) -> AskableScene:
        return self._named(name)[1]

    def _named(self, name: str) -> tuple[str, AskableScene]:
        chosen = name or self.catalog.only()
        if not chosen:
            known = ", ".join(map(repr, list(self.catalog.folders())[:MOST_THINGS])) or "none"
            raise InputError(f"say which scene; there are: {known}")
        return chosen, self.catalog.scene(chosen)

    def _things(self, scene: AskableScene, text: str) -> list[Instance]:
        return [one.thing for one in scene.find(Question(text=_text(text)))]

    def _best(self, scene: AskableScene, text: str) -> Instance:
        things = self._things(scene, text)
        if not things:
            raise InputError(_absent(text))
        return things[0]

    def _on(self, scene: AskableScene, found: list[Found], on: str | None) -> list[Found]:
        """Those that stand on the largest thing of that name, itself left out; all of them for None."""
        if on is None:
            return found
        supports = self._things(scene, on)
        if not supports:
            raise InputError(_absent(on))
        support, up = max(supports, key=len), scene.field.up
        if up is None:
            raise InputError(
                "the photos of this scene do not tell which way is up: ask without 'on'"
            )
        return [one for one in found if stands_on(scene.gaussians, one.thing, support, up)]


def _query(text: str, on: str | None) -> str:
    return text if on is None else f"{text} on {on}"


def _none_on(number: int, on: str | None) -> str:
    return f"{number} in the scene, but none on the {on}: where_is says where"


def _text(text: str) -> str:
    if not text.strip() or len(text) > MOST_TEXT:
        raise InputError(
            f"text: expected a few words that name a thing, at most {MOST_TEXT} characters; got {len(text)}"
        )
    return text


def _names(names: list[str] | None) -> list[str] | None:
    if names is not None and (
        not 1 <= len(names) <= 100 or any(len(one) > MOST_TEXT for one in names)
    ):
        raise InputError(f"names: expected 1 to 100 texts of at most {MOST_TEXT} characters")
    return names


def _absent(text: str) -> str:
    return (
        f"nothing found for '{text[:60]}': try a more general word or a synonym, add the colour, or see what is there "
        "with describe_region"
    )


def _point(
    scene: AskableScene, place: tuple[float, float, float] | tuple[str, float, float]
) -> np.ndarray:
    if isinstance(place[0], str):
        return scene.point_at((place[0], place[1], place[2]))
    return np.asarray(scene.gaussians.positions[scene.nearest((place[0], place[1], place[2]))])
