"""The scene that is open, as a browser sees it: where to look from, in what order rows are drawn, and as JSON.

Pages and the live viewer send the same documents (web/src/protocol.ts); places in them are in the browser's frame.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...authoring.filming.looking import FOV_DEGREES, Standpoints, beside, size_in, up_direction
from ...authoring.filming.paths import CameraPath
from ...base.arrays import Matrix3, RowIds, Vector3
from ...base.contents import Document
from ...drawing.heat import HEAT
from ...kernels.boxes import box_of
from ...query import Match, documents
from ...query.suggesting import suggestions
from ...scene.boxes import solid
from ...scene.gaussians import significance
from ...scene.labelled import Annotation
from . import painting
from .client import printable
from .session import Session
from .shown import DECIMALS, first_look, place_text, rounded, size_text

POINT_SIZE = 1.0  # of the browser's units
MAX_NAME_CHARACTERS = 60
FILM_STEPS_PER_SECOND, FILM_S, MAX_FILM_S = 12, 8.0, 60.0


@dataclass(eq=False)
class Stage:
    """A session, and where and how a browser sees it.

    up: a unit direction in the world. names: of the objects, by number; by numbers alone until `prepare` has asked the
    encoder. words: suggestions, none until then. pictures: of objects, as JPEG, that were drawn already.
    """

    session: Session
    up: Vector3
    names: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    pictures: dict[int, bytes] = field(default_factory=dict)
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

    # --- names ---

    def rename(self) -> None:
        """Take the names that people gave to objects; of others those that are known, or their numbers."""
        if self.session.has_objects:
            objects = self.session.scene.objects
            before = self.names or [f"object {number}" for number in range(len(objects))]
            labels = enumerate(match.label for match in objects)
            self.names = [before[number] if label is None else f"{label} · {number}" for number, label in labels]

    def object_names(self) -> list[str]:
        """Label, else the word for it, and the number of each object; "object 7" or "surface 7" where no word is sure.

        This loads the encoder. Without objects there are none.
        """
        scene = self.session.scene
        if not self.session.has_objects:
            return []
        words, flat = scene.object_names(words=self.session.words or ()), scene.surfaces
        return [
            f"{match.label or word} · {number}"
            if match.label or word
            else f"{'surface' if flat and flat[number] else 'object'} {number}"
            for number, (match, word) in enumerate(zip(scene.objects, words, strict=True))
        ]

    def prepare(self) -> Callable[[], None]:
        """Find names of the objects and words to suggest, which loads the encoder, and return what takes them."""
        names, session = self.object_names(), self.session
        words = suggestions(session.scene, session.words) if session.is_askable else []

        def take() -> None:
            self.names, self.words = names, words
            self.rename()

        return take

    @cached_property
    def agreed(self) -> tuple[list[int], list[int]]:
        """Numbers of the objects that photos agree on or that have a label, and of the others."""
        agreed = self.session.scene.agreed if self.session.has_objects else np.empty(0, bool)
        return np.flatnonzero(agreed).tolist(), np.flatnonzero(~agreed).tolist()

    @property
    def listed(self) -> list[int]:
        """Numbers of the objects, those that photos agree on first; none where the scene has no objects."""
        return [*self.agreed[0], *self.agreed[1]]

    # --- places ---

    @cached_property
    def first_look(self) -> tuple[Vector3, Vector3]:
        """Eye and target in the world."""
        return first_look(self.session.scene.views, self.session.shown.frame, self.up)

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
        """Return a match with its box where its Gaussians are now, at the session's time and after its edits."""
        session, ids = self.session, match.gaussian_ids
        if session.scene.tiles is not None:
            return match
        now = session.standing(ids)
        if session.time is None and np.array_equal(now.means, session.scene.rows.shapes_of(ids).means):
            return match
        box = box_of(now, solid(now, np.arange(len(ids))), session.scene.up)
        return replace(match, center=box.center, axes=box.axes, extent=box.extent)

    @property
    def order(self) -> RowIds:
        """Places of the drawn rows by falling significance; the same at all times of the same edits."""
        ids = self.session.drawn.ids
        if self._order is None or self._order[0] is not ids:
            weight = significance(self.session.edits.part(ids)[0])
            self._order = ids, np.argsort(-weight, kind="stable")
        return self._order[1]

    # --- documents ---

    def at(self, place: Vector3) -> list[float]:
        """Return a place of the world in the browser's frame."""
        return rounded(self.session.shown.frame.shown(place))

    def look_document(self) -> Document:
        """Return from where a scene is seen at first, and what the client needs to paint it."""
        eye, target = self.first_look
        return {
            "eye": self.at(eye), "target": self.at(target), "up": rounded(self.up), "fov": FOV_DEGREES,
            "heat": rounded(HEAT), "look": painting.LOOK, "antialiased": self.session.shown.antialiased,
        }  # fmt: skip

    def box_document(self, center: Vector3, axes: Matrix3, extent: Vector3) -> Document:
        """Return an oriented box of the world and a place to see it from."""
        frame = self.session.shown.frame
        box = documents.box_document(frame.shown(center), axes, extent * frame.scale, DECIMALS)
        return box | {"eye": self.at(self.eye_before(center, extent))}

    def object_documents(self, numbers: Sequence[int], matches: Sequence[Match]) -> list[Document]:
        """Return objects by their numbers. matches: where they are now."""
        agreed = self.session.scene.agreed if numbers else ()
        return [
            self.box_document(match.center, match.axes, match.extent)
            | {
                "number": number,
                "name": printable(self.names[number], MAX_NAME_CHARACTERS),
                "size": size_text(match.extent),
                "num_gaussians": len(match),
                "unsure": not bool(agreed[number]),
            }
            for number, match in zip(numbers, matches, strict=True)
        ]

    def match_document(self, match: Match, name: str = "") -> Document:
        """Return a match with its box, a place to see it from, and its numbers in scene units."""
        document = documents.match_document(match, DECIMALS)
        del document["support"]  # many masks, which the client does not list
        return (
            document
            | self.box_document(match.center, match.axes, match.extent)
            | {
                "size": size_text(match.extent),
                "place": place_text(match.center),
                "name": printable(name, MAX_NAME_CHARACTERS),
            }
        )

    def annotation_document(self, annotation: Annotation) -> Document:
        """Return a text and its place, and its box where it has one."""
        text, center, outline = {"text": printable(annotation.text)}, annotation.center, annotation.outline
        if outline is not None:
            return text | self.box_document(center, outline.axes, outline.extent)
        extent = np.full(3, POINT_SIZE / self.session.shown.frame.scale)
        return text | {"center": self.at(center), "eye": self.at(self.eye_before(center, extent))}

    def film_document(self, path: CameraPath, target: Vector3) -> Document:
        """Return places along a path, near enough to each other for straight lines.

        Each looks at something as far off as `target`, in the world.
        """
        frame, seconds = self.session.shown.frame, min(path.seconds or FILM_S, MAX_FILM_S)
        keys = path.at(np.linspace(0, 1, max(2, round(seconds * FILM_STEPS_PER_SECOND))))
        ahead = [max(float(key.rotation[2] @ (target - key.eye)), 1 / frame.scale) for key in keys]
        targets = [key.eye + far * key.rotation[2] for key, far in zip(keys, ahead, strict=True)]
        return {
            "seconds": seconds,
            "eyes": [np.round(frame.shown(key.eye), 4).tolist() for key in keys],
            "targets": [np.round(frame.shown(one), 4).tolist() for one in targets],
            "fovs": [round(key.fov_degrees, 2) for key in keys],
        }
