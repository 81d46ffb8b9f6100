"""The list of what was found: one button each, numbered as in the scene."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ..query import Match
from . import painting
from .page import said_of
from .results import Result
from .texts import printable

MOST_FIRST, MOST_LISTED = 12, 100  # buttons; those beyond the first are behind one more press


class Find(NamedTuple):
    """One match of an answer. name: with its number among all that was found, from 1, where it is not alone."""

    name: str
    query: int
    match: Match


def finds_of(results: Sequence[Result]) -> list[Find]:
    matches = [(query, match) for query, result in enumerate(results) for match in result.matches]
    alone = len(matches) == 1
    return [
        Find(results[query].label if alone else f"{number} {results[query].label}", query, match)
        for number, (query, match) in enumerate(matches, start=1)
    ]


class FindList:
    """Buttons in a folder of a panel. They are made when first needed and used again: viser repeats to each new
    page what ever was made, also what is gone.

    fly: what a press does, with the press and the match.
    """

    def __init__(self, gui: Any, folder: Any, fly: Callable[[Any, Match], None]) -> None:
        self.gui, self.folder, self.fly = gui, folder, fly
        self._finds: list[Find] = []
        self._buttons: list[Any] = []
        with folder:
            self._more = gui.add_folder("more", expand_by_default=False, visible=False, order=1e6)
        with self._more:
            self._rest = gui.add_markdown("", visible=False, order=1e6)

    def show(self, finds: Sequence[Find]) -> None:
        self._finds = list(finds[:MOST_LISTED])
        while len(self._buttons) < len(self._finds):
            self._buttons.append(self._new_button(len(self._buttons)))
        for number, button in enumerate(self._buttons):
            button.visible = number < len(self._finds)
            if button.visible:
                self._fill(button, self._finds[number])
        rest = len(finds) - MOST_FIRST
        self._more.label, self._more.visible = f"{rest:,} more", rest > 0
        self._rest.content = f"and {len(finds) - MOST_LISTED:,} that are not listed"
        self._rest.visible = len(finds) > MOST_LISTED

    def _new_button(self, number: int) -> Any:
        with self.folder if number < MOST_FIRST else self._more:
            button = self.gui.add_button("", order=10.0 + number)
        button.on_click(lambda event: self._pressed(event, number))
        return button

    def _fill(self, button: Any, find: Find) -> None:
        button.label = f"{printable(find.name, 60)} · {find.match.score:.2f}"
        button.color = painting.accent(find.query)
        button.hint = f"Fly to {printable(find.name, 60)}: {said_of(find.match)}"

    def _pressed(self, event: Any, number: int) -> None:
        if number < len(self._finds):
            self.fly(event, self._finds[number].match)
