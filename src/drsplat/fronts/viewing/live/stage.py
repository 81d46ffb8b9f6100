"""The scene that is open, with what is computed once for all who look at it, and cameras as browsers send them."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field, StringConstraints

from ....authoring.filming.looking import Standpoints, beside, looking_at, size_in, up_direction
from ....authoring.filming.paths import CameraPath, KeyFrame
from ....base.arrays import RowIds, Vector3
from ....base.contents import Document
from ....errors import InputError
from ....query import Match
from ....query.suggesting import suggestions
from ....scene.gaussians import significance
from ....scene.views import View
from ...serving.query_fields import Strict
from ..exporting import in_order, names_of, placed_now
from ..page import film_document
from ..session import Session
from ..shown import first_look

MAX_WORDS_SUGGESTED = 4


@dataclass(eq=False)
class Stage:
    """A session, and where and how a browser sees it.

    up: a unit direction in the world. names: of the objects, by number; by numbers alone until `prepare` has asked the
    encoder. words: suggestions, none until then.
    """

    session: Session
    up: Vector3
    names: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    _order: tuple[RowIds, RowIds] | None = None

    @classmethod
    def of(cls, session: Session, up: Vector3 | None = None) -> "Stage":
        """Return a session as it is opened, a scene that moves at its first time. up: None takes the scene's own."""
        if session.scene.motion is not None and session.time is None:
            session.time = float(session.scene.moving.times[0])
        stage = cls(session, up_direction(session.scene) if up is None else up)
        stage.rename()
        return stage

    def copied(self) -> "Stage":
        """Return a stage that stays as this one is now, whatever is done to this one."""
        other = copy.copy(self)
        other.session = self.session.copied()
        return other

    def rename(self) -> None:
        """Take the names that people gave to objects; of others those that are known, or their numbers."""
        if self.session.has_objects:
            before = self.names or [f"object {number}" for number in range(len(self.session.scene.objects))]
            labels = [match.label for match in self.session.scene.objects]
            self.names = [
                before[number] if label is None else f"{label} · {number}" for number, label in enumerate(labels)
            ]

    def prepare(self) -> Callable[[], None]:
        """Find names of the objects and words to suggest, which loads the encoder, and return what takes them."""
        session = self.session
        names = names_of(session) if session.has_objects else []
        words = suggestions(session.scene, session.words, MAX_WORDS_SUGGESTED) if session.is_askable else []

        def take() -> None:
            self.names, self.words = names, words
            self.rename()

        return take

    @cached_property
    def first_look(self) -> tuple[Vector3, Vector3]:
        """Eye and target in the world."""
        return first_look(self.session.scene.views, self.session.shown.frame, self.up)

    @cached_property
    def listed(self) -> list[int]:
        """Numbers of the objects, those that photos agree on first; none where the scene has no objects."""
        return [number for part in in_order(self.session) for number in part] if self.session.has_objects else []

    @cached_property
    def _standpoints(self) -> Standpoints:
        return Standpoints.of(self.session.scene.views)

    @cached_property
    def _radius(self) -> float:
        return self.session.radius

    def eye_before(self, center: Vector3, extent: Vector3) -> Vector3:
        """Return a place in the world to see a box from, as `authoring.filming.looking.before`."""
        return beside(center, size_in(extent, self._radius), self._standpoints, self.up)

    def placed(self, match: Match) -> Match:
        """Return a match where its Gaussians are now."""
        return placed_now(self.session, match)

    @property
    def order(self) -> RowIds:
        """Places of the drawn rows by falling significance; the same at all times of the same edits."""
        session = self.session
        ids = session.drawn.ids
        if self._order is None or self._order[0] is not ids:
            weight = significance(session.edits.part(ids)[0])
            self._order = ids, np.argsort(-weight, kind="stable")
        return self._order[1]


MAX_TEXT_CHARACTERS = 500
MAX_SIDE_PIXELS = 1600  # of a picture that is drawn
MAX_KEYS = 200
MAX_FILM_S, FILM_S = 60.0, 8.0
FPS, FILM_SIZE_PIXELS = 24.0, (960, 720)

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
Point = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]  # a list, as JSON has it
Span = Annotated[tuple[Finite, Finite], Field(strict=False)]
Text = Annotated[str, StringConstraints(min_length=1, max_length=MAX_TEXT_CHARACTERS)]
Degrees = Annotated[float, Field(ge=1, le=170, allow_inf_nan=False)]
Side = Annotated[int, Field(ge=16, le=8192)]
Number = Annotated[int, Field(ge=0, le=2**31 - 1)]


class Body(Strict):
    """A JSON object of a request."""


class Key(Body):
    """A key frame of a film. fov: degrees from the top to the bottom of the picture."""

    eye: Point
    target: Point
    fov: Degrees


class Camera(Key):
    """The camera of a browser. width, height: of its picture in pixels."""

    width: Side
    height: Side


class Path(Body):
    """A path through key frames. closed: the last leads to the first."""

    keys: Annotated[list[Key], Field(min_length=2, max_length=MAX_KEYS)]
    seconds: Annotated[float, Field(gt=0, le=MAX_FILM_S, allow_inf_nan=False)] = FILM_S
    closed: bool = False


def view_of(stage: Stage, camera: Camera, most_side: int = MAX_SIDE_PIXELS) -> View:
    """Return a camera in the world, with pixels of the same shape but not too many.

    Raises: InputError: it stands where it looks.
    """
    return _view(stage, camera, (camera.width, camera.height)).limited(most_side)


def path_through(stage: Stage, path: Path) -> CameraPath:
    """Return a path in the world. Raises: InputError: a key frame stands where it looks."""
    keys = [KeyFrame.of(_view(stage, key, FILM_SIZE_PIXELS)) for key in path.keys]
    return CameraPath(tuple(keys), path.closed, False, path.seconds, FPS, FILM_SIZE_PIXELS)


def flight_document(stage: Stage, path: Path) -> Document:
    """Return the places that a browser flies through: those of the film that would be saved.

    Raises: InputError: a key frame stands where it looks.
    """
    frame = stage.session.shown.frame
    return film_document(frame, path_through(stage, path), frame.world(np.array(path.keys[0].target, np.float64)))


def path_document(stage: Stage, path: CameraPath) -> Document:
    """Return a path of the world as browsers take it. Raises: InputError: more key frames than they take."""
    if len(path.keys) > MAX_KEYS:
        raise InputError(f"a path of the viewer has up to {MAX_KEYS} key frames, this one has {len(path.keys):,}")
    lasts = path.seconds or (path.keys[-1].seconds or 0) - (path.keys[0].seconds or 0) or FILM_S
    frame = stage.session.shown.frame
    keys = [
        {"eye": frame.shown(key.eye).tolist(), "target": (frame.shown(key.eye) + key.rotation[2]).tolist(),
         "fov": key.fov_degrees}
        for key in path.keys
    ]  # fmt: skip
    return {"keys": keys, "seconds": float(np.clip(lasts, 1.0, MAX_FILM_S)), "closed": path.closed}


def _view(stage: Stage, key: Key, size: tuple[int, int]) -> View:
    frame = stage.session.shown.frame
    eye, target = (frame.world(np.array(place, np.float64)) for place in (key.eye, key.target))
    return looking_at(eye, target, stage.up, size, key.fov)
