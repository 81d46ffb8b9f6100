"""Acts of people: each is one JSON object, and one call or a few of the session.

Source of the names and shapes: docs/viewer_service.md, "For other clients".
"""

from collections.abc import Callable, Hashable, Iterator
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field, TypeAdapter

from ....authoring.editing import Duplicate, Fill, Isolate, Move, Opacity, Palette, Recolour, Remove, Turn
from ....authoring.editing.draft import MAX_COLORS, color_of
from ....authoring.editing.edits import Change
from ....authoring.editing.replacement import scaled_on_its_foot
from ....errors import InputError
from ....kernels.boxes import box_of
from ....query.schema import Place
from ....scene.labelled import Annotation
from ...serving.query_fields import Strict, asking, values_of
from ..session import Mode, Session
from ..stage import Stage
from .cameras import Camera, Finite, Number, Point, Span, Text, view_of
from .shared import Shared

T = TypeVar("T")
LASSO_SIDE_PIXELS = 640
Steps = Iterator[str | None]
"""A slow act: up to its first `yield` in the session's thread, up to the second beside it, the rest in it again.

Beside the session it touches nothing that is shown. At last it yields what is to be said, as `Act.do` returns it.
"""


class Act(Strict):
    """An act. One with a `key` is left out where another of the same key came before its turn."""

    @property
    def key(self) -> Hashable | None:
        return None

    def do(self, shared: Shared) -> str | None:
        """Do it; returns what is to be said, None for what the session says of its answers."""
        raise NotImplementedError


class SlowAct(Act):
    """An act whose work is done beside the session, which answers meanwhile as it was before."""

    def steps(self, shared: Shared) -> Steps:
        """Do it in three steps."""
        raise NotImplementedError


class EditAct(SlowAct):
    """A change of the list of edits."""

    def steps(self, shared: Shared) -> Steps:
        session, stage = shared.session, shared.stage.copied()
        ahead = stage.session
        yield None
        ahead.take_edits(session)  # as edits before this one have left them
        self.apply(stage)
        _ = ahead.drawn  # what browsers ask for next
        yield None
        session.take_edits(ahead)
        if session.results is ahead.results:
            session.mode = ahead.mode
        yield None

    def apply(self, stage: Stage) -> None:
        """Change the edits of a copy of the session. Raises: InputError: it cannot be done."""
        raise NotImplementedError


@asking(Place.VIEWER)
class Ask(Act):
    act: Literal["ask"]
    text: Text

    def do(self, shared: Shared) -> str | None:
        asked = values_of(vars(self))
        during = asked.pop("during", None)
        if "during" in self.model_fields_set:
            _set_during(shared.session, during)
        shared.session.clear()  # also where the words are refused: it would be read as their answer
        return shared.session.ask(**asked)


class Press(Act):
    """An act that the session has under the same name, and that needs to be told nothing."""

    act: Literal["more_like_this", "clear", "smaller", "larger"]

    def do(self, shared: Shared) -> None:
        getattr(shared.session, self.act)()


class Threshold(Act):
    act: Literal["threshold"]
    query: Number
    value: Finite

    @property
    def key(self) -> Hashable:
        return "threshold", self.query

    def do(self, shared: Shared) -> str | None:
        return shared.session.set_threshold(self.query, self.value)


class Classify(Act):
    act: Literal["classify"]
    text: Text

    def do(self, shared: Shared) -> None:
        shared.session.classify(self.text.split(","))


class SetMode(Act):
    act: Literal["mode"]
    mode: str

    def do(self, shared: Shared) -> None:
        modes = [mode.value for mode in shared.session.modes]
        if self.mode not in modes:
            raise InputError(f"mode: expected one of {', '.join(modes)}; got {self.mode!a:.40}")
        shared.session.mode = Mode(self.mode)


class Click(Act):
    act: Literal["click"]
    origin: Point
    direction: Point

    def do(self, shared: Shared) -> str | None:
        return _click(shared.session, np.array(self.origin, np.float64), np.array(self.direction, np.float64))


class ClickPhoto(Act):
    act: Literal["click_photo"]
    photo: Text
    x: Finite
    y: Finite

    def do(self, shared: Shared) -> str | None:
        session = shared.session
        view = session.scene.view(self.photo)
        if not (0 <= self.x <= view.width and 0 <= self.y <= view.height):
            raise InputError(f"photo: expected a pixel of {view.width} x {view.height}, got {self.x:g}, {self.y:g}")
        ahead = view.cam_from_world[:3, :3].T @ np.linalg.solve(view.K, [self.x, self.y, 1.0])
        return _click(session, session.shown.frame.shown(view.center), ahead)


class Choose(Act):
    act: Literal["choose"]
    number: Number

    def do(self, shared: Shared) -> None:
        shared.session.choose_object(self.number)


class Name(Act):
    act: Literal["name"]
    text: Text

    def do(self, shared: Shared) -> None:
        shared.session.name(self.text)
        shared.stage.rename()
        shared.counters.header += 1


class Lasso(Act):
    act: Literal["lasso"]
    polygon: Annotated[list[Span], Field(min_length=3, max_length=1000)]
    camera: Camera

    def do(self, shared: Shared) -> str | None:
        view = view_of(shared.stage, self.camera, LASSO_SIDE_PIXELS)
        scale = np.array([view.width / self.camera.width, view.height / self.camera.height])
        return shared.session.lasso(view, np.array(self.polygon, np.float64) * scale)


class EditSelection(EditAct):
    """A change of the selection and its numbers. color, colors: as of CSS. by: scene units along the world's axes.

    number: a factor, of opacity or size; degrees of a turn.
    """

    act: Literal["edit"]
    change: Literal[
        "remove", "isolate", "fill", "recolour", "palette", "opacity", "move", "duplicate", "turn", "scale"
    ]  # fmt: skip
    color: Text | None = None
    colors: Annotated[list[Text], Field(min_length=1, max_length=MAX_COLORS)] | None = None
    by: Point | None = None
    number: Finite | None = None

    def apply(self, stage: Stage) -> None:
        stage.session.edit(self._made(stage))

    def _made(self, stage: Stage) -> Change:
        """Return the change. Raises: InputError: what it needs was not given, or makes no sense."""
        match self.change:
            case "remove":
                return Remove()
            case "isolate":
                return Isolate()
            case "fill":
                return Fill()
            case "recolour":
                return Recolour(color_of(_given(self.color, "recolour: expected a color such as #2060ff")))
            case "palette":
                colors = _given(self.colors, "palette: expected colors such as #203040")
                return Palette(tuple(color_of(one) for one in colors))
            case "move" | "duplicate":
                by = _given(self.by, f"{self.change}: expected by, three numbers in scene units")
                return (Move if self.change == "move" else Duplicate)(by)
        number = _given(self.number, f"{self.change}: expected a number")
        if self.change == "opacity":
            return Opacity(number)
        if self.change == "turn":
            x, y, z = stage.up.tolist()
            return Turn(number, (x, y, z))
        return scaled_on_its_foot(stage.session.edited(selected_only=True)[0], number, stage.up)


def _given(value: T | None, expected: str) -> T:
    """Return a value of a request. Raises: InputError: there is none."""
    if value is None:
        raise InputError(expected)
    return value


class Reverse(EditAct):
    act: Literal["undo", "redo", "restore"]

    def apply(self, stage: Stage) -> None:
        session = stage.session
        {"undo": session.edits.undo, "redo": session.edits.redo, "restore": session.restore}[self.act]()


class Annotate(Act):
    act: Literal["annotate"]
    text: Text
    at: Literal["selection", "click"]

    def do(self, shared: Shared) -> None:
        shared.session.edits.annotate(*_notes(shared.session, self.text, self.at))


class DropAnnotation(Act):
    act: Literal["drop_annotation"]
    number: Number

    def do(self, shared: Shared) -> None:
        shared.session.edits.drop(self.number)


class Time(Act):
    act: Literal["time"]
    at: Finite

    @property
    def key(self) -> Hashable:
        return "time"

    def do(self, shared: Shared) -> None:
        times = shared.session.scene.moving.times
        shared.session.time = float(np.clip(self.at, times[0], times[-1]))


class During(Act):
    act: Literal["during"]
    span: Span | None

    def do(self, shared: Shared) -> None:
        _set_during(shared.session, self.span)


class Open(SlowAct):
    act: Literal["open"]
    batch: Text

    def steps(self, shared: Shared) -> Steps:
        return shared.open_batch(self.batch)


class OpenEntry(SlowAct):
    act: Literal["open_entry"]
    number: Number

    def steps(self, shared: Shared) -> Steps:
        return shared.open_entry(self.number)


AnyAct = (
    Ask | Press | Threshold | Classify | SetMode | Click | ClickPhoto | Choose | Name | Lasso | EditSelection | Reverse
    | Annotate | DropAnnotation | Time | During | Open | OpenEntry
)  # fmt: skip
_ADAPTER: TypeAdapter[AnyAct] = TypeAdapter(Annotated[AnyAct, Field(discriminator="act")])


def read_act(body: bytes) -> AnyAct:
    """Read an act. Raises: pydantic.ValidationError: it is none."""
    return _ADAPTER.validate_json(body)


def done(shared: Shared, act: Act) -> dict[str, object]:
    """Do an act and return the state after it. Raises: as the session's calls."""
    return _noted(shared, lambda: act.do(shared))


def begun(shared: Shared, act: SlowAct) -> Callable[[], Callable[[], dict[str, object]]]:
    """Do the first step of a slow act; returns the second, which returns the last, as `Lanes.take_change` takes them.

    The last one returns the state after it to whose turn this is.
    """
    steps, visit = act.steps(shared), shared.visit
    next(steps)

    def shown() -> dict[str, object]:
        shared.enter(visit)
        return _noted(shared, lambda: next(steps))

    def beside() -> Callable[[], dict[str, object]]:
        next(steps)
        return shown

    return beside


def _noted(shared: Shared, do: Callable[[], str | None]) -> dict[str, object]:
    """Do something and return the state after it, with what it says; what it has changed counts even if it fails."""
    try:
        said = do()
    finally:
        shared.note()
    return shared.state(said)


def _click(session: Session, origin: np.ndarray, direction: np.ndarray) -> str | None:
    """Return what is said of a click in the browser's frame."""
    return "Nothing with a feature is there." if session.click(origin, direction) is None else None


def _set_during(session: Session, span: Span | None) -> None:
    """Let queries ask of a span of time. Raises: InputError: the scene stands still, or a span without length."""
    times = session.scene.moving.times
    if span is not None and not span[0] <= span[1]:
        raise InputError(f"during: expected a start before its end, got {span[0]:g} to {span[1]:g}")
    session.during = None if span is None or (span[0] <= times[0] and span[1] >= times[-1]) else span


def _notes(session: Session, text: str, at: str) -> list[Annotation]:
    """Return a text at the click, or at the box of each match. Raises: InputError: there is none."""
    if at == "click":
        if session.clicked is None:
            raise InputError("click something in the scene first")
        return [Annotation.at(text, session.clicked.point)]
    here = [  # where a match is now: it may have been moved
        box_of(session.standing(match.gaussian_ids), np.arange(len(match)), session.scene.up)
        for result in session.results
        for match in result.matches
    ]
    if not here:
        raise InputError("nothing is selected: make a query that has a match first, or click an object")
    return [Annotation.box(text, box.center, box.axes, np.maximum(box.extent, 1e-6)) for box in here]
