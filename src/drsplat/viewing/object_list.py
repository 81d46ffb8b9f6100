"""The objects of a scene with their pictures: each is selected, and flown to, by a press."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..drawing.pictures import OtherPixels
from ..query import Match
from ..query.sheets import object_picture, object_views
from .session import Session
from .texts import printable

AT_ONCE = 12  # pictures that one press makes
SIZE = (200, 150)


def pictures_of(session: Session, matches: list[Match]) -> list[OtherPixels | None]:
    """Each cut out of the photo, or the rendering, that shows it best; none of a scene without views."""
    if not session.scene.views:
        return [None] * len(matches)
    views = object_views(session.scene, matches)
    return [
        object_picture(session.scene, match, view, SIZE) for match, view in zip(matches, views, strict=True)
    ]  # fmt: skip


def names_of(session: Session) -> list[str]:
    """Label, else the word for it, and the number of each object; "object 7" where no word is sure."""
    words = session.scene.object_names(words=session.words or ())
    return [
        f"{match.label or word} · {match.object_id}" if match.label or word else f"object {match.object_id}"
        for match, word in zip(session.scene.objects, words, strict=True)
    ]


def in_order(session: Session) -> tuple[list[int], list[int]]:
    """The numbers of the objects that photos agree on, or that have a label, and those of the others."""
    agreed = session.scene.agreed
    return np.flatnonzero(agreed).tolist(), np.flatnonzero(~agreed).tolist()


class ObjectList:
    """A folder of a panel. They are made when they are asked for: a browser keeps what ever was made.

    button: who makes one that does something when pressed. chosen: what a press on an object does.
    """

    def __init__(
        self, session: Session, gui: Any, button: Callable[[str, Callable[[Any], None]], Any],
        chosen: Callable[[Any, int], None],
    ) -> None:  # fmt: skip
        self.session, self.gui, self.button, self.chosen, self.listed = session, gui, button, chosen, 0
        self.folder = gui.add_folder("Objects", expand_by_default=False)
        with self.folder:
            self.more = button("List them", self._list)

    def _list(self, _: Any) -> None:
        objects, names = self.session.scene.objects, names_of(self.session)
        sure, unsure = in_order(self.session)
        part = sure if self.listed < len(sure) else [*sure, *unsure]
        numbers = part[self.listed : self.listed + AT_ONCE]
        some = [objects[number] for number in numbers]
        for number, match, picture in zip(numbers, some, pictures_of(self.session, some), strict=True):
            self._row(number, match, names[number], picture)
        self.more.label = _more_said(len(sure) - self.listed, len(objects) - self.listed)
        self.more.visible = self.listed < len(objects)

    def _row(self, number: int, match: Match, name: str, picture: OtherPixels | None) -> None:
        place = self.listed
        with self.folder:
            if picture is not None:
                self.gui.add_image(np.ascontiguousarray(picture), order=10.0 + place)
            button = self.button(printable(name, 60), lambda event: self.chosen(event, number))
            button.order, button.hint = 10.5 + place, f"{len(match):,} Gaussians"
            self.more.order = 1e6
        self.listed += 1


def _more_said(sure: int, every: int) -> str:
    """Return the label of the button that lists further objects: how many are left of those photos agree on, of all."""
    if sure > 0:
        return f"{min(sure, AT_ONCE)} more of {sure}"
    return f"{min(every, AT_ONCE)} of {every} that photos agree less on"
