"""State shared by all browsers of a viewer: the scene, its edits, counters of changes; other scenes in its place."""

import re
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

from ....base.arrays import Vector3
from ....base.contents import Document
from ....base.terminal import counted
from ....errors import DrSplatError, InputError
from ....query import Scene
from ....query.catalogue import Catalogue, Entry
from ....scene.views import View
from ...serving.scene_folder import without_paths
from ..client import printable
from ..saving import Saves
from ..session import Session
from ..stage import Stage
from ..tiled import session_of
from . import arrays
from .arrays import Packed, Rows
from .state import MAX_SENTENCE_CHARACTERS, film_formats, header_of, state_of
from .turns import Visit, Visits
from .uploads import Uploads, root_of

MAX_ENTRIES, MAX_PAINTED = 12, 4  # of an answer of the catalogue; arrays of visits that are kept
NOTHING_OPEN = "no scene is open: search the catalogue and open one, or open a file"
FOLDERS = re.compile(r"(?<![\w.])/(?:[^/\s'\",:;]+/)+")
CLOSED_STATE = {
    "mode": "as it is", "asked": [], "present": False, "selection": 0, "results": [], "clicked": None, "chosen": None,
    "classes": None, "annotations": [], "time": None, "edits": [], "can_undo": False, "can_redo": False, "kept": False,
}  # fmt: skip
"""The state where no scene is open."""


@dataclass
class Counters:
    """Numbers that grow when something changes for all: anything, the scene, its header."""

    revision: int = 0
    scene: int = 0
    header: int = 0


@dataclass(eq=False)
class Shared:
    """Not safe for several threads at once.

    saves: where files go. open_path: opens a scene's file or folder. budget, words: as of `Session`. catalogue: to
    search, None for none. tell: is called after each change, with the visit that alone it concerns, None for all.
    home: the session that a browser finds when it comes. entry: name and field's fingerprint of the catalogue's scene
    that is open. visit: whose turn it is.
    """

    saves: Saves
    open_path: Callable[[Path], Scene]
    budget: int = 1_000_000
    words: Sequence[str] | None = None
    catalogue: Catalogue | None = None
    uploads: Uploads = field(default_factory=Uploads)
    tell: Callable[[Visit | None], None] = lambda _: None
    counters: Counters = field(default_factory=Counters)
    visits: Visits = field(default_factory=Visits)
    home: Session | None = None
    entry: tuple[str, str] = ("", "")
    visit: Visit = field(init=False)
    _stage: Stage | None = None
    _told: Sequence[Any] = ()
    _rows: OrderedDict[tuple[Visit, str], tuple[object, Rows]] = field(default_factory=OrderedDict)

    def __post_init__(self) -> None:
        self.visit = self.visits.common

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

    def without_folders(self, message: str) -> str:
        """Return a message for others than the one who started the viewer: it names no folder of this machine."""
        path = None if self._stage is None else self.session.scene.path
        own = [] if path is None else [path.parent, path.resolve().parent]
        saves = [] if self.saves.folder is None else [self.saves.folder]
        return FOLDERS.sub("", without_paths(message, [*self.uploads.roots, *own, *saves]))

    # --- the catalogue ---

    @property
    def _needed_catalogue(self) -> Catalogue:
        if self.catalogue is None:
            raise InputError("there is no catalogue here")
        return self.catalogue

    def search(self, text: str) -> Document:
        """Search the catalogue. Raises: InputError: none is open, no words, or such as its encoder does not know."""
        answer = self._needed_catalogue.answer(text, top=MAX_ENTRIES)
        self.visit.entries = answer.entries
        matches = counted(len(answer.entries), "match", "matches")
        entries = [
            {"number": number, "title": printable(entry.title, 60), "scene": printable(entry.scene, 60),
             "score": round(entry.score, 4), "picture": entry.thumbnail is not None}
            for number, entry in enumerate(answer.entries)
        ]  # fmt: skip
        return {"summary": f"{matches} by {answer.measure}, threshold {answer.threshold:.3g}", "entries": entries}

    def _found(self, number: int) -> tuple[Catalogue, Entry]:
        """Return an entry of the catalogue that was found last. Raises: InputError: no such entry, or no catalogue."""
        catalogue, entries = self._needed_catalogue, self.visit.entries
        if not 0 <= number < len(entries):
            raise InputError(f"there is no entry {number} of {len(entries)}: search the catalogue first")
        return catalogue, entries[number]

    def entry_picture(self, number: int) -> bytes:
        """Return the thumbnail of an entry as JPEG. Raises: InputError: it has none, or there is no such entry."""
        entry = self._found(number)[1]
        if entry.thumbnail is None:
            raise InputError(f"entry {number} has no picture")
        entry.picture()  # or the error that says that it is damaged
        return entry.thumbnail

    # --- changing ---

    def enter(self, visit: Visit) -> None:
        """Let a browser have its turn: what is asked and found from now on is its own.

        Where it has not seen the open scene yet, it finds it as whoever started the viewer has asked it.
        """
        if visit.scene != self.counters.scene:
            visit.scene, visit.session = self.counters.scene, None if self.home is None else self.home.visited()
        self.visit = visit
        if self._stage is not None and visit.session is not None:
            self._stage.session = visit.session
        self._look()

    def show(self, session: Session, up: Vector3 | None = None) -> None:
        """Show another session in place of the one that is open, to all."""
        self._stage, self.home = Stage.of(session, up), session
        self.counters.scene += 1
        self.counters.header += 1
        self.enter(self.visit)

    def begin(self, text: str) -> None:
        """Ask what all find who come, before anybody has. Raises: as `Session.ask`."""
        if self.home is not None:
            self.home.ask(text)
        self.visit.scene = -1  # so that it finds this, too

    def prepare(self) -> Callable[[], None]:
        """Find names of objects and words to suggest, which may load a model, beside the session.

        Returns: what shows them, in the session's thread.
        """
        take = None if self._stage is None else self._stage.prepare()

        def show() -> None:
            if take is not None:
                take()
            self.counters.header += 1
            self.note()

        return show

    def note(self) -> None:
        """Count what has changed since the last time, and tell those whom it concerns."""
        self.counters.revision += 1
        self._look()
        common: list[Any] = [self.counters.scene, self.counters.header]
        if self._stage is not None:
            self.visit.num_bytes = self.session.num_bytes
            common += [self.session.edits.listed, self.session.edits.annotations]
        self.tell(self.visit if list(map(id, common)) == list(map(id, self._told)) else None)
        self._told = common

    def _look(self) -> None:
        """Count what has changed for whose turn it is, others' edits among it."""
        visit = self.visit
        seen: tuple[Any, ...] = ()
        if self._stage is not None:
            session = self.session
            seen = session.edits.listed, session.time, session.results, session.segmentation
        changed = [one is not other for one, other in zip_longest(seen, visit.seen)]
        visit.geometry += any(changed[:2])
        visit.paint += any(changed)
        visit.seen = seen

    # --- what a browser is told ---

    def header(self) -> Document:
        session = None if self._stage is None else self.session
        is_open, askable = session is not None, session is not None and session.is_askable
        objects = session is not None and session.has_objects
        can = {
            "ask": askable,
            "ask_picture": askable,
            "objects": objects,
            "name": session is not None and objects and session.can_name,
            "edit": session is not None and session.scene.tiles is None,
            "time": session is not None and session.scene.motion is not None,
            "photos": session is not None and bool(session.scene.views),
            "save_dir": self.saves.folder is not None,
            "catalogue": self.catalogue is not None,
            "film_formats": list(film_formats()),
            "open": True,
        }
        counters = {"scene": self.counters.scene, "header": self.counters.header}
        return counters | {"can": can} | (header_of(self.stage) if is_open else {})

    def state(self, said: str | None = None) -> Document:
        """Return the state of whose turn it is. said: of an act; None: what the session says of its answers."""
        visit, stage = self.visit, self._stage
        if said is None:
            said = "" if stage is None else stage.session.summary
        lines = [printable(line.strip(), MAX_SENTENCE_CHARACTERS) for line in said.splitlines()]
        own = {"geometry": visit.geometry, "paint": visit.paint, "message": "\n".join(lines)}
        return vars(self.counters) | own | (CLOSED_STATE if stage is None else state_of(stage))

    def splats(self, begin: int = 0) -> Packed:
        """Return a piece of what is drawn, from a row on. Raises: InputError: there is no such row."""
        return arrays.splats(self.stage, begin) if self._has_rows else arrays.nothing()

    def paint(self, begin: int = 0) -> Packed:
        """Return what the same rows answer. Raises: as `splats`."""
        return self._piece("paint", arrays.paint, begin)

    def colors(self, mode: str, begin: int = 0) -> Packed:
        """Return the colours of the same rows. Raises: as `splats`; InputError: another mode."""
        return self._piece("colors", lambda stage: arrays.colors(stage, mode), begin, mode)

    @property
    def _has_rows(self) -> bool:
        """True if a scene is open that is not in tiles, whose parts are asked for."""
        return self._stage is not None and self.session.scene.tiles is None

    def _piece(self, name: str, make: Callable[[Stage], Rows], begin: int, mode: str = "") -> Packed:
        """Return a piece of arrays as they were made for the piece before it, where nothing has changed since."""
        if not self._has_rows:
            return arrays.nothing()
        version = self.visit.geometry, self.visit.paint, mode
        known = self._rows.pop((self.visit, name), None)
        if known is None or known[0] != version:
            known = version, make(self.stage)
        self._rows[self.visit, name] = known
        if len(self._rows) > MAX_PAINTED:
            self._rows.popitem(last=False)
        return arrays.piece(known[1], begin)

    # --- opening: steps of slow acts, see `acts.Steps` ---

    def open_batch(self, name: str) -> Iterator[str | None]:
        """Open the scene of a batch of files, and show it; yields what is said of it.

        On failure what was open stays, and the files go. Edits are kept in memory: a stranger's list of edits could
        name files of this machine.

        Raises: InputError: no such batch. FormatError, MismatchError: as the readers of scenes.
        """
        folder = self.uploads.batch(name).folder
        yield None
        try:
            scene = self.open_path(root_of(folder))
            scene.views = tuple(confined(view, folder) for view in scene.views)  # type: ignore[misc]
            session = session_of(scene, self.budget, edits_kept=False)
            _ = session.shown
            yield None
            self.show(session)
        except BaseException as error:
            self.uploads.drop(name)
            if isinstance(error, DrSplatError):
                error.args = (without_paths(str(error), [folder]),)
            raise
        self.uploads.keep_opened(name)
        self.entry = ("", "")
        yield f"opened {printable(scene.name, 60)}: {counted(len(scene.rows), 'Gaussian')}"

    def open_entry(self, number: int) -> Iterator[str | None]:
        """Open the scene of an entry of the catalogue's last answer, and select its object; yields what is said.

        Raises: InputError: no such entry, or its scene is no longer there.
        """
        catalogue, entry = self._found(number)
        session = None
        yield None
        if self.entry != (entry.scene, entry.field):
            scene = catalogue.scene(entry.scene)
            _ = scene.rows  # or the error that says what is missing
            session = session_of(scene, self.budget, self.words)
            _ = session.shown
        yield None
        if session is not None:
            self.show(session)
            self.uploads.keep_opened(None)
            self.entry = entry.scene, entry.field
        title = f"{printable(entry.title, 60)} of '{printable(entry.scene, 60)}'"
        field = self.session.scene.field
        if field.fingerprint != entry.field or field.objects is None:
            title += ", which has changed since it was added"
        else:
            self.session.choose_object(entry.object_id)
        yield title


def confined(view: View, folder: Path) -> View:
    """Return a view without the photo and the mask that lie outside of a folder: who sent it may have named any."""
    paths = [path for path in (view.image_path, view.mask_path) if path is not None]
    inside = all(path.resolve().is_relative_to(folder.resolve()) for path in paths)
    return view if inside else replace(view, image_path=None, mask_path=None)
