"""The state of a viewer and what people do to it; no browser, no network."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np

from ...authoring.editing import Edit, Rows
from ...authoring.editing.draft import OBJECT_ID
from ...authoring.editing.edits import Change
from ...authoring.editing.resolving import complete_rows
from ...authoring.editing.targets import MAX_NAME_CHARACTERS
from ...authoring.filming.looking import radius_of
from ...base.arrays import Ids, OtherPixels, PlanePoints, RowIds, Shaped, Vector3, Vectors, WholeNumbers
from ...base.terminal import counted
from ...drawing.heat import class_colors, heat_colors
from ...errors import InputError
from ...query import Query, Scene, Segmentation
from ...query.defaults import OBJECT
from ...query.nodes import Chosen, chosen_at, name_of
from ...query.objects import answer_of, match_of, objects_of
from ...query.seen import Seen
from ...scene.gaussians import Gaussians
from ...scene.moving import Span
from ...scene.views import View
from . import painting, results
from .edits import Edits
from .naming import Hit, Ray, This, hit_by_ray, inside_outline, known_words, ray_along, this_is
from .results import Result
from .shown import Shown, shown_of

MAX_QUERIES = 8  # at once: as many as there are colours
BYTES_PER_VALUE = 20  # two numbers, its heat, and the row where it is selected


class Mode(StrEnum):
    """Mode of colours; the values are what people read."""

    ANSWER = "answer"
    HEAT = "heat map"
    SCENE = "as it is"
    FEATURES = "features"
    CLASSES = "classes"
    OBJECTS = "objects"


@dataclass(eq=False)
class Session:
    """One scene on show. Not safe for several threads at once.

    words: to name things with; None takes the encoder's own. budget: Gaussians that a browser gets. chosen: the part,
    thing or group that was clicked, None for none. time: at which a scene that moves is shown; None: it stands still.
    during: the span of time that queries ask of. edits_kept: whether edits are those kept beside the scene, or in
    memory from none on. asked: the queries in words that are answered now, none where something else is shown.
    present: whether they were asked for what is known to be there.
    """

    scene: Scene
    budget: int = 1_000_000
    words: Sequence[str] | None = None
    mode: Mode = Mode.SCENE
    results: tuple[Result, ...] = ()
    segmentation: Segmentation | None = None
    clicked: This | None = None
    chosen: Chosen | None = None
    time: float | None = None
    during: Span | None = None
    edits_kept: bool = True
    asked: tuple[str, ...] = ()
    present: bool = False
    _edits: Edits = field(init=False)
    _features: list[Vectors] = field(default_factory=list, init=False)  # made once for all who look

    def __repr__(self) -> str:
        return f"Session({self.scene.name!r}, {self.mode}, {counted(len(self.results), 'result')})"

    def __post_init__(self) -> None:
        self._edits = Edits(self.scene, self.edits_kept)

    @property
    def edits(self) -> Any:
        """The `Edits` of the scene, done to it as it is at the time that is shown."""
        if self.scene.tiles is None:
            self._edits.stand(self.here.gaussians)
        return self._edits

    def copied(self) -> "Session":
        """Return a session that stays as this one is now, whatever is done to this one; edits of it are kept."""
        edits, other = copy.copy(self.edits), copy.copy(self)
        other._edits = edits
        return other

    def visited(self) -> "Session":
        """Return a session of somebody else, who at first sees what this one shows; edits are those of both."""
        _ = self.shown  # which all share
        return copy.copy(self)

    @property
    def num_bytes(self) -> int:
        """Bytes that what was found has at most: values, cosines and ids of each answer; the codes of a time span."""
        field, count = self.scene.field, len(self.results) + bool(self.clicked) + bool(self.segmentation)
        return count * (BYTES_PER_VALUE * len(field) + (0 if self.during is None else field.code.nbytes))

    def unasked(self, budget: int) -> "Session":
        """Return a session of the same scene with a copy of its edits, in which nothing was asked."""
        other = type(self)(self.scene, min(budget, self.budget), self.words, edits_kept=False)
        other._edits = copy.copy(self.edits)
        return other

    def take_edits(self, other: "Session") -> None:
        """Take the edits of a copy, as they are now."""
        self._edits.take(other._edits)

    @cached_property
    def shown(self) -> Shown:
        return shown_of(self.scene.gaussians, self.budget)

    @property
    def num_shown(self) -> int:
        """Gaussians that a browser gets."""
        return len(self.shown)

    @property
    def radius(self) -> float:
        """Median distance of the Gaussians from their middle, in scene units."""
        return radius_of(self.scene.gaussians)

    @property
    def here(self) -> Scene:
        """The scene as it is at the time that is shown."""
        return self.scene if self.time is None else self.scene.at(self.time)

    # --- asking ---

    @property
    def is_askable(self) -> bool:
        """True if any Gaussian has a feature."""
        return len(self.scene.field) > 0

    @property
    def has_objects(self) -> bool:
        """True if the field has objects."""
        return bool(self.scene.field.objects)

    @property
    def can_name(self) -> bool:
        """True if there is a file to keep names in."""
        return self.scene.label_file is not None

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Those that show something of this scene."""
        if not self.is_askable:
            return (Mode.SCENE,)
        return tuple(mode for mode in Mode if mode is not Mode.OBJECTS or self.has_objects)

    def ask(self, text: str, **cut: Any) -> str:
        """Ask one query in words, or several with ";" between them; says what was found.

        Raises: InputError: no words, too many queries, words that the encoder does not know.
        """
        texts = results.split_queries(text)
        if not 1 <= len(texts) <= MAX_QUERIES:
            raise InputError(f"expected one to {MAX_QUERIES} queries with ';' between them")
        queries = [Query(one, during=self.during, **cut) for one in texts]
        summary = self._answered(
            [results.result_of(self.scene, one.text or "", self.scene.ask(one)) for one in queries]
        )
        self.asked, self.present, self.clicked = tuple(texts), bool(cut.get("present")), None
        return summary

    def ask_picture(self, picture: OtherPixels, name: str) -> str:
        """Ask by what a picture shows. Raises: InputError: an encoder that sees no images."""
        answer = self.scene.ask(Query(image=picture, during=self.during))
        self.clicked = None
        return self._answered([results.result_of(self.scene, name, answer)])

    def more_like_this(self) -> str:
        """Ask by what was clicked. Raises: InputError: nothing was."""
        if self.clicked is None:
            raise InputError("click something in the scene first")
        label = f"like this {self.clicked.name}".rstrip()
        return self._answered([replace(self.clicked.alike, label=label)])

    def set_threshold(self, number: int, threshold: float) -> str:
        """Cut the values of one of the queries elsewhere. Raises: InputError: no such query, or not a number."""
        if not np.isfinite(threshold):
            raise InputError(f"expected a finite threshold, got {threshold}")
        if not 0 <= number < len(self.results):
            raise InputError(f"there is no query {number} of {len(self.results)}")
        changed = results.cut_at(self.scene, self.results[number], threshold)
        self.results = (*self.results[:number], changed, *self.results[number + 1 :])
        return self.summary

    def classify(self, texts: Sequence[str]) -> Segmentation:
        """Take each Gaussian as the best of some classes, and show them.

        Raises: InputError: no classes, one twice, or words that the encoder does not know.
        """
        found = self.scene.segment([text.strip() for text in texts if text.strip()])
        self.segmentation, self.mode = replace(found, answers=[]), Mode.CLASSES
        return found

    @property
    def summary(self) -> str:
        return " \n".join(result.summary for result in self.results)

    def _answered(self, answers: list[Result]) -> str:
        self.results, self.mode, self.chosen, self.asked = tuple(answers), Mode.ANSWER, None, ()
        return self.summary

    def clear(self) -> None:
        """Show the scene as it is, with nothing found, clicked or selected."""
        self.results, self.asked, self.clicked, self.chosen, self.mode = (), (), None, None, Mode.SCENE

    def lasso(self, view: View, outline: PlanePoints) -> str:
        """Select what is mostly seen inside an outline in a picture from a camera in the world.

        outline: corners in pixels of the view. Raises: InputError: nothing is seen there.
        """
        seen = self.seen(view)
        ids = inside_outline(seen.splats, view, outline, threads=self.scene.threads)
        ids = ids[ids < len(self.scene.gaussians)] if seen.rows is None else seen.rows[ids]  # added ones answer nothing
        if not len(ids):
            raise InputError("nothing is seen inside the outline: draw it around something")
        self.clicked = None
        return self._answered([results.result_of_ids(self.scene, "outlined", ids)])

    # --- pointing ---

    def click(self, origin: Vector3, direction: Vector3) -> This | None:
        """Return what a ray in the browser's frame meets first, None where that has no feature.

        In a field with objects it is selected: the object, or where that is none all that is like it.

        Raises: InputError: a ray that goes nowhere.
        """
        if not (np.isfinite(origin).all() and np.isfinite(direction).all() and direction.any()):
            raise InputError("a click needs a place and a direction")
        hit = self._hit(ray_along(self.shown.frame.world(origin), direction))
        self.clicked, self.chosen = None if hit is None else this_is(self.scene, hit, self.words), None
        if hit is not None and self.has_objects:
            self._choose(chosen_at(self.scene, hit.gaussian_ids, hit.weights))
        return self.clicked

    def _hit(self, ray: Ray) -> Hit | None:
        visible = np.zeros(len(self.scene.gaussians), bool)
        visible[self.scene.field.gaussian_ids] = True
        return hit_by_ray(self.edits.standing, ray, visible & self.edits.present)

    # --- objects ---

    def choose_object(self, number: int) -> None:
        """Select an object by its number. Raises: InputError: there is none of that number, or the field has none."""
        self.clicked = None
        self._choose(Chosen((objects_of(self.scene.field).thing(number),), 0))

    def smaller(self) -> None:
        """Select the next smaller node at the place that was clicked.

        Raises: InputError: no object is selected, or it has no parts.
        """
        smaller = self._needed_node().smaller(objects_of(self.scene.field))
        if smaller is None:
            raise InputError("there is nothing smaller in it")
        self._choose(smaller)

    def larger(self) -> None:
        """Select what the selected node is part or member of.

        Raises: InputError: no object is selected, or it is in none.
        """
        larger = self._needed_node().larger()
        if larger is None:
            raise InputError("there is nothing larger that it is part of")
        self._choose(larger)

    def name(self, text: str) -> None:
        """Call the selected part, thing or group so from now on.

        Raises: InputError: no object is selected, an empty name, or nowhere to keep it.
        """
        chosen = self._needed_node()
        self.scene.label(chosen.node, text)
        self._choose(chosen)

    def _choose(self, chosen: Chosen | None) -> None:
        """Select a node; where there is none, what is like the place that was clicked."""
        was_everything = self.mode is Mode.OBJECTS
        if chosen is None:
            self.more_like_this()
        else:
            name = name_of(self.scene, chosen.node, known_words(self.scene, self.words))
            answer = answer_of(self.scene.field, [chosen.node], OBJECT)
            match = match_of(self.scene.field, chosen.node)
            self._answered([Result(name, answer, answer.threshold, [match])])
            self.clicked = None if self.clicked is None else replace(self.clicked, match=match)
        self.chosen = chosen
        if was_everything:
            self.mode = Mode.OBJECTS

    def _needed_node(self) -> Chosen:
        if self.chosen is None:
            raise InputError("no object is selected: click one in the scene first")
        return self.chosen

    # --- changing what is there ---

    @property
    def selection(self) -> RowIds:
        """All that was found and is not removed, ascending."""
        ids = results.joined([result.gaussian_ids for result in self.results])
        return ids[self.edits.present[ids]]

    def edit(self, change: Change) -> None:
        """Change the selection, with what hangs on to it. Raises: InputError: nothing is selected, or it cannot be."""
        self.edits.add(Edit(self.target, change))
        self.mode = Mode.SCENE

    @property
    def target(self) -> Rows:
        """The selection, as edits name it. Raises: InputError: nothing is selected."""
        ids, chosen = complete_rows(self.scene, self._needed()), self.chosen
        objects = self.scene.field.objects
        number = -1 if chosen is None or objects is None else int(objects.number_of[chosen.node])
        if number >= 0 and objects is not None and objects.thing(number) == chosen.node:  # type: ignore[union-attr]
            return Rows.of(ids, "object", str(number))
        return Rows.of(ids, "query", "; ".join(result.label for result in self.results)[:MAX_NAME_CHARACTERS])

    def restore(self) -> None:
        """Take back everything, as it was before all edits, which can be redone."""
        self.edits.undo(self.edits.listed.done)

    def standing(self, ids: RowIds) -> Gaussians:
        """Return some of the scene's own rows, where they are now."""
        return self.edits.standing.subset(ids)

    def _needed(self) -> RowIds:
        if not len(self.selection):
            raise InputError("nothing is selected: make a query that has a match first")
        return self.selection

    # --- what it looks like ---

    @property
    def colors(self) -> Vectors:
        """Colours of every Gaussian of the scene in the present mode, in [0, 1]."""
        return self.painted(self.edits.colors[: len(self.scene.gaussians)])

    def painted(self, rgb: Vectors, rows: WholeNumbers | None = None) -> Vectors:
        """Paint Gaussians, of some rows of the scene or all, in the present mode. rgb: their own colours."""
        mode, found, count = self.mode, self.results, len(self.scene.rows)
        if mode is Mode.FEATURES:
            return self._feature_colors
        if mode is Mode.CLASSES and self.segmentation is not None:
            labels = self.segmentation.labels if rows is None else self.segmentation.labels[rows]
            return painting.class_painted(rgb, labels, class_colors(len(self.segmentation.names)))
        if mode is Mode.OBJECTS and self.has_objects:
            return painting.object_painted(rgb, self.objects_at(rows), len(objects_of(self.scene.field)))
        if mode is Mode.HEAT and found:
            return heat_colors(results.heat(found, count, rows))
        if mode is Mode.ANSWER and any(len(result.gaussian_ids) for result in found):
            accents = [painting.accent(number) for number in range(len(found))]
            return painting.highlighted(rgb, results.owners(found, count, rows), accents)
        return rgb

    @property
    def drawn(self) -> Shown:
        """Rows that a browser draws: those of the scene as edited, those that edits added behind its own."""
        return self.edits.shown(self.shown, self.budget)

    @property
    def drawn_colors(self) -> Vectors:
        """`colors`, with what edits added in its own."""
        return np.concatenate([self.colors, self.edits.colors[len(self.scene.gaussians) :]])

    def seen(self, view: View) -> Seen:
        """Return what a camera may see, as edited: all rows."""
        splats = self.edits.splats if self.edits.is_edited else self.here.splats
        return Seen(self.edits.everything, splats)

    def seen_colors(self, seen: Seen) -> Vectors:
        """Return the colours in the present mode of what a camera may see."""
        return self.drawn_colors

    @property
    def _feature_colors(self) -> Vectors:
        if not self._features:
            registered = np.zeros(len(self.scene.gaussians), bool)
            registered[self.scene.field.gaussian_ids] = True
            colors = self.edits.colors[: len(registered)]
            self._features.append(painting.feature_colors(self.scene.field, colors, registered))
        return self._features[0]

    def objects_at(self, rows: WholeNumbers | None = None) -> Ids:
        """Return the object's number of some rows or all, -1 for none; only of a field that has objects."""
        if rows is None:
            return self._edits.gaussians.extra[OBJECT_ID]
        own = self.scene.field.rows_of(rows)
        return np.where(own < 0, np.int32(-1), objects_of(self.scene.field).thing_of(own))

    def of_drawn(self, values: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " m"]:
        """Return values of the scene's rows for those that are drawn; 0 for what edits added."""
        return results.taken(values, self.drawn.ids)

    def edited(self, *, selected_only: bool = False) -> tuple[Gaussians, RowIds]:
        """Return the Gaussians after all edits, and their rows: the scene's own, then added ones.

        selected_only: of that, what is selected. Raises: InputError: nothing is left.
        """
        return self.edits.part(self._needed() if selected_only else None)
