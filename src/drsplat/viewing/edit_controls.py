"""What people press to edit: one change at a time, undo and redo, before and after, and annotations."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..drawing.pictures import as_pixels
from ..drawing.rendering import render
from ..editing import Duplicate, Fill, Isolate, Move, Opacity, Palette, Recolour, Remove, Turn
from ..editing.colouring import color_of
from ..editing.edits import Change
from ..editing.making import scaled_on_its_foot
from ..editing.stored import NAMES
from ..errors import InputError
from ..kernels.boxes import box_of
from ..query import Match
from ..scene.annotations import Annotation
from . import painting
from .session import Session
from .texts import escaped, paragraphs, printable
from .window import Window

REMOVE, KEEP, FILL, RECOLOUR, PALETTE, OPACITY = "remove", "keep only this", "fill", "recolour", "palette", "opacity"
MOVE, DUPLICATE, TURN, SCALE = "move", "duplicate", "turn", "scale"
CHANGES = (RECOLOUR, REMOVE, KEEP, FILL, MOVE, DUPLICATE, TURN, SCALE, OPACITY, PALETTE)
NUMBERS = {TURN: ("Degrees", 45.0), SCALE: ("Factor", 1.5), OPACITY: ("Factor", 0.3)}
SPLIT_SIZE = (640, 480)
LISTED = 12  # the last of the list
HINT = "Of the matches, or of the object that was clicked; kept beside the scene, as `drsplat edit` does"
Act = Callable[[Any], None]


@runtime_checkable
class Owner(Protocol):
    """The panel: it makes controls whose presses are done one after the other, and shows what came of it."""

    window: Window
    session: Session
    gui: Any

    def _button(self, label: str, act: Act) -> Any: ...

    def _prompt(self, label: str, hint: str, act: Act) -> Any: ...

    def _by_hand(self, control: Any, what: str, act: Act) -> None: ...

    def _follow(self) -> None: ...


class EditControls:
    """Two folders of a panel: Edit and Annotations."""

    def __init__(self, owner: Owner) -> None:
        self.owner, self.session, self.gui = owner, owner.session, owner.gui
        self._sides: tuple[np.ndarray, np.ndarray] | None = None
        with self.gui.add_folder("Edit", expand_by_default=False):
            self._build_change()
            self._build_split()
        with self.gui.add_folder("Annotations", expand_by_default=False):
            self._build_notes()
        self.show()

    # --- making the controls ---

    def _build_change(self) -> None:
        button = self.owner._button
        self.what = self.gui.add_dropdown("Change", CHANGES, initial_value=RECOLOUR, hint=HINT)
        self.owner._by_hand(self.what, "what", lambda _: self._show_inputs())
        self.color = self.gui.add_rgb("Colour", painting.accent(1))
        self.palette = self.gui.add_text("Colours", "#203040, #d0c0a0")
        self.by = self.gui.add_vector3("By", (0.0, 0.0, 0.3), step=0.05, hint="Scene units, along the world's axes")
        self.number = self.gui.add_number("Degrees", 45.0, step=0.1)
        self.apply = button("Apply", self._apply)
        self.undo = button("Undo", lambda _: self._did(self.session.edits.undo))
        self.redo = button("Redo", lambda _: self._did(self.session.edits.redo))
        self.told = self.gui.add_html("")
        self._show_inputs()

    def _build_split(self) -> None:
        self.compare = self.owner._button("Before and after", self._compare)
        self.compare.hint = "Both from where you look now, with a border that you move"
        self.border = self.gui.add_slider("Before | after", 0.0, 1.0, 0.01, 0.5, visible=False)
        self.owner._by_hand(self.border, "border", lambda _: self._show_split())
        self.split = self.gui.add_image(np.zeros((2, 2, 3), np.uint8), visible=False)

    def _build_notes(self) -> None:
        self.text = self.owner._prompt("Text", "Enter: at the match or the object", self._annotate)
        self.here = self.owner._button("At the match", self._annotate)
        self.there = self.owner._button("At the click", self._annotate_click)
        self.noted = self.gui.add_dropdown("Listed", ("-",), visible=False)
        self.drop = self.owner._button("Drop it", self._drop)
        self.marks = self.gui.add_checkbox("Show them", True)
        self.owner._by_hand(self.marks, "notes", self._show_marks)

    # --- showing ---

    def show(self) -> None:
        """The list, and what can be undone."""
        listed = self.session.edits.listed
        self.undo.disabled, self.redo.disabled = not listed.done, listed.done == len(listed.edits)
        self.compare.disabled = not listed.done
        lines = [
            f"{number}. {NAMES[type(edit.change)]} {escaped(str(edit.target), 60)}"
            + ("" if number <= listed.done else " <i>(undone)</i>")
            for number, edit in enumerate(listed.edits, start=1)
        ]
        self.told.content = paragraphs(*lines[-LISTED:]) if lines else paragraphs("No edits yet.")
        if self._sides is not None:
            self._sides, self.split.visible, self.border.visible = None, False, False
        self._show_notes()

    def _show_notes(self) -> None:
        names = tuple(f"{n} {printable(one.text, 50)}" for n, one in enumerate(self.session.edits.annotations, start=1))
        self.noted.options = names or ("-",)
        self.noted.value = self.noted.options[-1]
        self.noted.visible = self.drop.visible = self.marks.visible = bool(names)

    def _show_inputs(self) -> None:
        what = self.what.value
        self.color.visible, self.palette.visible = what == RECOLOUR, what == PALETTE
        self.by.visible, self.number.visible = what in (MOVE, DUPLICATE), what in NUMBERS
        if what in NUMBERS:
            self.number.label, self.number.value = NUMBERS[what]

    # --- editing ---

    def _did(self, act: Callable[[], object]) -> None:
        act()
        self.owner.window.repaint()
        self.owner._follow()
        self.show()

    def _apply(self, _: Any) -> None:
        self._did(lambda: self.session.edit(self._change()))

    def _change(self) -> Change:
        what, number, up = self.what.value, float(self.number.value), self.owner.window.up
        x, y, z = (float(part) for part in self.by.value)
        made: dict[str, Callable[[], Change]] = {
            REMOVE: Remove, KEEP: Isolate, FILL: Fill,
            RECOLOUR: lambda: Recolour(_share(self.color.value)),
            PALETTE: lambda: Palette(tuple(color_of(one) for one in self.palette.value.split(","))),
            OPACITY: lambda: Opacity(number),
            MOVE: lambda: Move((x, y, z)), DUPLICATE: lambda: Duplicate((x, y, z)),
            TURN: lambda: Turn(number, tuple(up.tolist())),
            SCALE: lambda: scaled_on_its_foot(self.session.edited(selected_only=True)[0], number, up),
        }  # fmt: skip
        return made[what]()

    # --- before and after ---

    def _compare(self, event: Any) -> None:
        scene, view = self.session.scene, self.owner.window.seen_by(event.client, SPLIT_SIZE)
        after = self.session.edited()[0]
        sides = (self.session.here.gaussians, after)
        before, now = (as_pixels(render(one, view, threads=scene.threads).rgb) for one in sides)
        self._sides = before, now
        self._show_split()

    def _show_split(self) -> None:
        if self._sides is None:
            return
        before, after = self._sides
        column = round(float(self.border.value) * before.shape[1])
        picture = np.where((np.arange(before.shape[1]) < column)[None, :, None], before, after)
        picture[:, max(column - 1, 0) : column + 1] = 255
        self.split.image, self.split.visible, self.border.visible = picture, True, True

    # --- annotations ---

    def _annotate(self, _: Any) -> None:
        boxes = [match for result in self.session.results for match in result.matches]
        if not boxes:
            raise InputError("nothing is selected: make a query that has a match first, or click an object")
        text = self._text()
        self._noted(*(self._boxed(text, match) for match in boxes))

    def _boxed(self, text: str, match: Match) -> Annotation:
        """Where it is now: it may have been moved."""
        box = box_of(self.session.edits.standing, match.gaussian_ids, self.session.scene.up)
        return Annotation.box(text, box.center, box.axes, np.maximum(box.extent, 1e-6))

    def _annotate_click(self, _: Any) -> None:
        clicked = self.session.clicked
        if clicked is None:
            raise InputError("click something in the scene first")
        self._noted(Annotation.at(self._text(), clicked.point))

    def _text(self) -> str:
        text = str(self.text.value).replace("\n", "").strip()
        if not text:
            raise InputError("an annotation is a text: type one first")
        return text

    def _noted(self, *annotations: Annotation) -> None:
        self.session.edits.annotate(*annotations)
        self.text.value = ""
        self._show_notes()
        self.owner.window.repaint()

    def _drop(self, _: Any) -> None:
        self.session.edits.drop(self.noted.options.index(self.noted.value) + 1)
        self._show_notes()
        self.owner.window.repaint()

    def _show_marks(self, _: Any) -> None:
        self.owner.window.notes = self.marks.value
        self.owner.window.repaint()


def _share(rgb: tuple[int, int, int]) -> tuple[float, float, float]:
    red, green, blue = (part / 255 for part in rgb)
    return red, green, blue
