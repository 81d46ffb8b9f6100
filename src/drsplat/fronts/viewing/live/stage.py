"""The scene that is open, with what is computed once for all who look at it."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ....authoring.filming.looking import Standpoints, beside, size_in, up_direction
from ....base.arrays import Float64, Int64
from ....query import Match
from ....query.suggesting import suggestions
from ....scene.gaussians import significance
from ..object_list import in_order, names_of, placed_now
from ..session import Session
from ..shown import first_look

MAX_WORDS_SUGGESTED = 4
Vector = Float64[np.ndarray, " 3"]


@dataclass(eq=False)
class Stage:
    """A session, and where and how a browser sees it.

    up: a unit direction in the world. names: of the objects, by number; by numbers alone until `prepare` has asked the
    encoder. words: suggestions, none until then.
    """

    session: Session
    up: Vector
    names: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    _order: tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]] | None = None

    @classmethod
    def of(cls, session: Session, up: Vector | None = None) -> "Stage":
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
    def first_look(self) -> tuple[Vector, Vector]:
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

    def eye_before(self, center: Vector, extent: Vector) -> Vector:
        """Return a place in the world to see a box from, as `authoring.filming.looking.before`."""
        return beside(center, size_in(extent, self._radius), self._standpoints, self.up)

    def placed(self, match: Match) -> Match:
        """Return a match where its Gaussians are now."""
        return placed_now(self.session, match)

    @property
    def order(self) -> Int64[np.ndarray, " m"]:
        """Places of the drawn rows by falling significance; the same at all times of the same edits."""
        session = self.session
        ids = session.drawn.ids
        if self._order is None or self._order[0] is not ids:
            weight = significance(session.edits.part(ids)[0])
            self._order = ids, np.argsort(-weight, kind="stable")
        return self._order[1]
