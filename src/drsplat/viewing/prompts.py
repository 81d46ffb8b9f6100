"""A field that something is typed into, by viser."""

from collections.abc import Callable
from typing import Any


def prompt(gui: Any, label: str, hint: str, pressed: Callable[[Any], None]) -> Any:
    """A field whose text ends in a new line when enter is pressed.

    viser's page sends the latest of many changes only: what a form submits overtakes the text that was typed
    just before, and that is lost. This comes with the text, or not at all.
    """
    field = gui.add_text(label, "", hint=hint, multiline=True)
    field.on_update(lambda event: pressed(event) if "\n" in field.value else None)
    return field
