"""Many scenes in a browser, by viser: a query, thumbnails of its answers, and the scene of the one that is pressed."""

import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..catalogue import Catalogue, Entry
from ..errors import DrSplatError, FormatError, InputError
from ..filming.looking import up_direction
from ..query import Match
from ..terminal import counted
from . import painting
from .actions import Actions
from .panel import Panel
from .prompts import prompt
from .session import Session
from .texts import escaped, paragraphs, printable
from .window import Window, served

MOST_SHOWN = 12
HINT = "Press enter. Exclude: mug, not red."


@dataclass(eq=False)
class CataloguePage:
    """All who open the page see the same scene. budget: as of `Session`. folder: as of `Panel`.

    Raises: MissingExtraError: viser is not installed. InputError: nothing can listen there, or an empty catalogue.
    """

    catalogue: Catalogue
    budget: int = 1_000_000
    folder: Path | None = None
    host: str = "127.0.0.1"
    port: int = 8080
    panel: Panel | None = None
    entries: Sequence[Entry] = ()
    _opened: tuple[str, str] = ("", "")
    _rows: list[tuple[Any, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        _ = self.catalogue.encoder  # or the error that says that nothing is in it
        self.served = served(self.host, self.port)
        self.server: Any = self.served.server
        self.actions, gui = Actions(), self.server.gui
        with gui.add_folder("All scenes"):
            self.text = prompt(gui, "Search all scenes", HINT, lambda _: self._do("ask", self._ask))
            self.told = gui.add_html(paragraphs(f"{counted(len(self.catalogue), 'object')}. Enter a query."))
            self._rows += [self._row(number) for number in range(MOST_SHOWN)]
        self._scene_folder: Any = None

    def stop(self) -> None:
        self.actions.stop()
        if self.panel is not None:
            self.panel.close()
        self.server.stop()

    def ask(self, text: str) -> None:
        """As if it had been typed."""
        self.text.value = text
        self._do("ask", self._ask)

    # --- doing what was pressed ---

    def _do(self, key: str, act: Callable[[], None]) -> None:
        self.actions.do(key, lambda: self._done(act))

    def _done(self, act: Callable[[], None]) -> None:
        """What goes wrong is said, and leaves what is shown as it was."""
        try:
            act()
        except (DrSplatError, OSError, MemoryError) as error:
            self._say(str(error) or type(error).__name__)
        except Exception as error:  # ours: the next press must find this thread alive
            traceback.print_exc(file=sys.stderr)
            self._say(f"this went wrong here: {type(error).__name__}")

    def _say(self, text: str) -> None:
        self.told.content = paragraphs(escaped(text, 600))

    # --- asking ---

    def _ask(self) -> None:
        self.text.value = self.text.value.replace("\n", "")
        answer = self.catalogue.answer(self.text.value, top=MOST_SHOWN)
        self.entries = answer.entries
        found = counted(len(self.entries), "match", "matches")
        self._say(f"{found} by {answer.measure}, threshold {answer.threshold:.3g}; press one to open its scene")
        for number, row in enumerate(self._rows):
            _fill(row, self.entries[number] if number < len(self.entries) else None)

    def _row(self, number: int) -> tuple[Any, Any]:
        """A thumbnail and the button below it; viser repeats to new pages what ever was made, so they stay."""
        image = self.server.gui.add_image(np.zeros((2, 2, 3), np.uint8), visible=False)
        button = self.server.gui.add_button("", visible=False, color=painting.accent(0))
        button.on_click(lambda event: self._do("open", lambda: self._open(event, number)))
        return image, button

    # --- opening ---

    def _open(self, event: Any, number: int) -> None:
        """The scene of an answer, with the object selected, and the camera of who pressed before it."""
        if number >= len(self.entries):
            return
        entry = self.entries[number]
        self._say(f"opening '{entry.scene}'")
        panel = self._panel_of(entry)
        field = panel.session.scene.field
        if field.fingerprint == entry.field and field.objects is not None:
            panel.choose(entry.object_id)
            self._say(f"{entry.title} of '{entry.scene}'")
        else:
            self._say(f"{entry.title} of '{entry.scene}', which has changed since: this is where it was")
        panel.fly(event, Match(entry.center, entry.axes, entry.extent, entry.score, np.empty(0, np.int64)))

    def _panel_of(self, entry: Entry) -> Panel:
        """The scene that is shown, or another in its place."""
        if self.panel is None or self._opened != (entry.scene, entry.field):
            session = Session(self.catalogue.scene(entry.scene), self.budget)
            up = up_direction(session.scene)
            self._close()
            window = Window(session, up, server=self.served)
            self._scene_folder = self.server.gui.add_folder(printable(entry.scene, 60))
            with self._scene_folder:
                self.panel = Panel(window, self.folder)
            self._opened = (entry.scene, entry.field)
        return self.panel

    def _close(self) -> None:
        if self.panel is not None:
            self.panel.close()
            self._scene_folder.remove()
            self.server.scene.reset()


def _fill(row: tuple[Any, Any], entry: Entry | None) -> None:
    image, button = row
    image.visible, button.visible = False, entry is not None
    if entry is None:
        return
    try:
        image.image, image.visible = entry.picture(), True
    except (InputError, FormatError):  # none, or a damaged one: the words are enough
        image.visible = False
    button.label = f"{entry.score:.2f} {printable(entry.title, 40)} · {printable(entry.scene, 40)}"
    button.hint = f"Open {printable(entry.scene, 60)} at {printable(entry.title, 60)}"
