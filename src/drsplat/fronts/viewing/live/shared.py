"""State shared by all windows of the viewer: the open scene, what was found in it, and counters of changes."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ....base.terminal import counted
from ....errors import InputError
from ....query import Scene
from ....query.catalogue import Catalogue, Entry
from ....query.documents import Document
from ...serving.scene_folder import without_paths
from ..bare import NO_FIELD
from ..saving import Saves
from ..session import Session
from ..texts import printable
from . import arrays
from .arrays import Packed, Rows
from .stage import Stage, Vector
from .state import MAX_SENTENCE_CHARACTERS, film_formats, header_of, state_of
from .uploads import Uploads

MAX_ENTRIES = 12
NOTHING_OPEN = "no scene is open: search the catalogue and open one, or open a file"
FOLDERS = re.compile(r"(?<![\w.])/(?:[^/\s'\",:;]+/)+")
CLOSED_STATE = {
    "mode": "as it is", "selection": 0, "results": [], "clicked": None, "chosen": None, "classes": None,
    "annotations": [], "time": None, "edits": [], "can_undo": False, "can_redo": False, "kept": False,
}  # fmt: skip
"""The state where no scene is open."""


@dataclass(eq=False)
class Shelf:
    """entries: of the last answer, best first. opened: name and field's fingerprint of the scene that is open."""

    catalogue: Catalogue
    entries: Sequence[Entry] = ()
    opened: tuple[str, str] = ("", "")

    def ask(self, text: str) -> Document:
        """Search all scenes. Raises: InputError: no words, or such as the encoder does not know."""
        answer = self.catalogue.answer(text, top=MAX_ENTRIES)
        self.entries = answer.entries
        matches = counted(len(self.entries), "match", "matches")
        return {
            "summary": f"{matches} by {answer.measure}, threshold {answer.threshold:.3g}",
            "entries": [_entry(number, entry) for number, entry in enumerate(self.entries)],
        }

    def entry(self, number: int) -> Entry:
        """Return an entry by its number. Raises: InputError: there is none of that number."""
        if not 0 <= number < len(self.entries):
            raise InputError(f"there is no entry {number} of {len(self.entries)}: search the catalogue first")
        return self.entries[number]

    def picture(self, number: int) -> bytes:
        """Return the thumbnail of an entry as JPEG. Raises: InputError: it has none."""
        entry = self.entry(number)
        if entry.thumbnail is None:
            raise InputError(f"entry {number} has no picture")
        entry.picture()  # or the error that says that it is damaged
        return entry.thumbnail


def _entry(number: int, entry: Entry) -> Document:
    return {
        "number": number,
        "title": printable(entry.title, 60),
        "scene": printable(entry.scene, 60),
        "score": round(entry.score, 4),
        "picture": entry.thumbnail is not None,
    }


@dataclass
class Counters:
    """Numbers that grow when something changes: anything, the scene, its header, its splats, what these answer."""

    revision: int = 0
    scene: int = 0
    header: int = 0
    geometry: int = 0
    paint: int = 0


@dataclass(eq=False)
class Shared:
    """Not safe for several threads at once.

    saves: where files go. open_path: opens a scene's file or folder. budget, words: as of `Session`. shelf: the
    catalogue, None for none. tell: is called after each change.
    """

    saves: Saves
    open_path: Callable[[Path], Scene]
    budget: int = 1_000_000
    words: Sequence[str] | None = None
    shelf: Shelf | None = None
    uploads: Uploads = field(default_factory=Uploads)
    message: str = ""
    tell: Callable[[], None] = lambda: None
    _stage: Stage | None = None
    counters: Counters = field(default_factory=Counters)
    _seen: tuple[Any, ...] = (None, None, None)
    _sent_state: tuple[int, Document] | None = None
    _rows: dict[str, tuple[object, Rows]] = field(default_factory=dict)

    @property
    def stage(self) -> Stage:
        """Raises: InputError: no scene is open."""
        if self._stage is None:
            raise InputError(NOTHING_OPEN)
        return self._stage

    @property
    def session(self) -> Session:
        """Raises: InputError: no scene is open."""
        return self.stage.session

    @property
    def needed_shelf(self) -> Shelf:
        """Raises: InputError: no catalogue was opened."""
        if self.shelf is None:
            raise InputError("there is no catalogue here")
        return self.shelf

    def say(self, text: str | None) -> None:
        """Say something to all, safe to show; None: what the session says of its answers."""
        own = "" if self._stage is None else self._stage.session.summary
        lines = (own if text is None else text).splitlines()
        self.message = "\n".join(printable(line.strip(), MAX_SENTENCE_CHARACTERS) for line in lines)

    def without_folders(self, message: str) -> str:
        """Return a message for others than the one who started the viewer: it names no folder of this machine."""
        scene = None if self._stage is None else self._stage.session.scene
        own = [] if scene is None or scene.path is None else [scene.path.parent, scene.path.resolve().parent]
        saves = [] if self.saves.folder is None else [self.saves.folder]
        return FOLDERS.sub("", without_paths(message, [*self.uploads.roots, *own, *saves]))

    # --- changing ---

    def show(self, session: Session, up: Vector | None = None) -> None:
        """Show another session in place of the one that is open."""
        self._stage = Stage.of(session, up)
        self.counters.scene += 1
        self.counters.header += 1
        self.say("" if session.is_askable else NO_FIELD)

    def search(self, text: str) -> Document:
        """Search the catalogue. Raises: InputError: there is none; as `Shelf.ask`."""
        answer = self.needed_shelf.ask(text)
        self.say(answer["summary"])
        self.note()
        return answer

    def prepare(self) -> Callable[[], None]:
        """Find names of objects and words to suggest, which may load a model, beside the session.

        Returns: what shows them, in the session's thread.
        """
        stage = self._stage
        take = None if stage is None else stage.prepare()

        def show() -> None:
            if take is not None:
                take()
            self.renew_header()
            self.note()

        return show

    def renew_header(self) -> None:
        """Count that the header is another one, as after an object was named."""
        self.counters.header += 1

    def note(self) -> None:
        """Count what has changed since the last time, and tell whoever listens."""
        counters = self.counters
        seen = self._seen_now()
        changed = [one is not other for one, other in zip(seen, self._seen, strict=True)]
        counters.geometry += changed[0]
        counters.paint += any(changed)
        self._seen = seen
        counters.revision += 1
        self.tell()

    def _seen_now(self) -> tuple[Any, ...]:
        if self._stage is None:
            return None, None, None
        session = self._stage.session
        return session.drawn, session.results, session.segmentation

    # --- what a browser is told ---

    def header(self) -> Document:
        counters = {"scene": self.counters.scene, "header": self.counters.header}
        return counters | {"can": self._can()} | ({} if self._stage is None else header_of(self._stage))

    def state(self) -> Document:
        """Return the state, made once after each change: all pages ask for it then."""
        revision = self.counters.revision
        if self._sent_state is None or self._sent_state[0] != revision:
            state = CLOSED_STATE if self._stage is None else state_of(self._stage)
            self._sent_state = revision, vars(self.counters) | {"message": self.message, "fault": None} | state
        return self._sent_state[1]

    def _can(self) -> Document:
        session = None if self._stage is None else self._stage.session
        askable = session is not None and session.is_askable
        return {
            "ask": askable,
            "ask_picture": askable,
            "objects": session is not None and session.has_objects,
            "name": session is not None and session.has_objects and session.can_name,
            "edit": session is not None and session.scene.tiles is None,
            "time": session is not None and session.scene.motion is not None,
            "photos": session is not None and bool(session.scene.views),
            "save_dir": self.saves.folder is not None,
            "catalogue": self.shelf is not None,
            "film_formats": list(film_formats()),
            "open": True,
        }

    def splats(self, begin: int = 0) -> Packed:
        """Return a piece of what is drawn, from a row on. Raises: InputError: there is no such row."""
        stage = self._stage
        is_empty = stage is None or stage.session.scene.tiles is not None  # whose parts are asked for
        return arrays.nothing() if is_empty else arrays.splats(self.stage, begin)

    def paint(self, begin: int = 0) -> Packed:
        """Return what the same rows answer. Raises: as `splats`."""
        return self._piece("paint", (self.counters.geometry, self.counters.paint), arrays.paint, begin)

    def colors(self, mode: str, begin: int = 0) -> Packed:
        """Return the colours of the same rows. Raises: as `splats`; InputError: another mode."""
        key = self.counters.geometry, self.counters.paint, mode
        return self._piece("colors", key, lambda stage: arrays.colors(stage, mode), begin)

    def _piece(self, name: str, version: object, make: Callable[[Stage], Rows], begin: int) -> Packed:
        """Return a piece of arrays as they were made for somebody else, where nothing has changed since."""
        if self._stage is None or self._stage.session.scene.tiles is not None:
            return arrays.nothing()
        known = self._rows.get(name)
        if known is None or known[0] != version:
            known = self._rows[name] = version, make(self._stage)
        return arrays.piece(known[1], begin)
