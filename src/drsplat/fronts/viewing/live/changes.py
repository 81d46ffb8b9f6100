"""The change of an edit as browsers ask for it."""

from collections.abc import Callable, Mapping
from typing import Annotated, Literal

from pydantic import Field

from ....authoring.editing import Duplicate, Fill, Isolate, Move, Opacity, Palette, Recolour, Remove, Turn
from ....authoring.editing.colouring import MAX_COLORS, color_of
from ....authoring.editing.edits import Change
from ....authoring.editing.making import scaled_on_its_foot
from ....errors import InputError
from .cameras import Body, Finite, Point, Text
from .stage import Stage


class ChangeRequest(Body):
    """A change and its numbers. color, colors: as of CSS. by: scene units along the world's axes.

    number: a factor, of opacity or size; degrees of a turn.
    """

    change: Literal[
        "remove", "isolate", "fill", "recolour", "palette", "opacity", "move", "duplicate", "turn", "scale"
    ]  # fmt: skip
    color: Text | None = None
    colors: Annotated[list[Text], Field(min_length=1, max_length=MAX_COLORS)] | None = None
    by: Point | None = None
    number: Finite | None = None

    def made(self, stage: Stage) -> Change:
        """Return the change. Raises: InputError: what it needs was not given, or makes no sense."""
        return MAKERS[self.change](self, stage)

    @property
    def needed_number(self) -> float:
        """Raises: InputError: none was given."""
        if self.number is None:
            raise InputError(f"{self.change}: expected a number")
        return self.number

    @property
    def needed_place(self) -> Point:
        """Raises: InputError: none was given."""
        if self.by is None:
            raise InputError(f"{self.change}: expected by, three numbers in scene units")
        return self.by

    def recolour(self) -> Recolour:
        """Return the change of colour. Raises: InputError: no colour was given."""
        if self.color is None:
            raise InputError("recolour: expected a color such as #2060ff")
        return Recolour(color_of(self.color))

    def palette(self) -> Palette:
        """Return the change to a palette. Raises: InputError: no colours were given."""
        if self.colors is None:
            raise InputError("palette: expected colors such as #203040")
        return Palette(tuple(color_of(one) for one in self.colors))

    def turn(self, stage: Stage) -> Turn:
        x, y, z = stage.up.tolist()
        return Turn(self.needed_number, (x, y, z))


MAKERS: Mapping[str, Callable[[ChangeRequest, Stage], Change]] = {
    "remove": lambda asked, _: Remove(),
    "isolate": lambda asked, _: Isolate(),
    "fill": lambda asked, _: Fill(),
    "recolour": lambda asked, _: asked.recolour(),
    "palette": lambda asked, _: asked.palette(),
    "opacity": lambda asked, _: Opacity(asked.needed_number),
    "move": lambda asked, _: Move(asked.needed_place),
    "duplicate": lambda asked, _: Duplicate(asked.needed_place),
    "turn": lambda asked, stage: asked.turn(stage),
    "scale": lambda asked, stage: scaled_on_its_foot(
        stage.session.edited(selected_only=True)[0], asked.needed_number, stage.up
    ),
}
"""By name, what makes a change of what was asked for."""
