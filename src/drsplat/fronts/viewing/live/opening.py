"""Other scenes in place of the one that is open: of files that a browser sent, and of a catalogue's entries."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ....base.terminal import counted
from ....errors import DrSplatError
from ....query import Scene
from ....query.catalogue import Entry
from ....scene.views import View
from ...serving.scene_folder import without_paths
from ..session import Session
from ..texts import printable
from ..tiled import session_of
from .shared import Shared
from .uploads import Batch, root_of


def open_batch(shared: Shared, name: str) -> Callable[[], Callable[[], str]]:
    """Return what opens the scene of a batch of files, which returns what shows it.

    On failure what was open stays, and the files go. Edits are kept in memory: a stranger's list of edits could name
    files of this machine.

    Raises: InputError: no such batch. FormatError, MismatchError: as the readers of scenes.
    """
    batch = shared.uploads.batch(name)

    def work() -> Callable[[], str]:
        try:
            session = _session_of_batch(shared, batch)
        except BaseException as error:
            shared.uploads.drop(name)
            if isinstance(error, DrSplatError):
                error.args = (without_paths(str(error), [batch.folder]),)
            raise
        return lambda: _show_batch(shared, name, session)

    return work


def _session_of_batch(shared: Shared, batch: Batch) -> Session:
    scene = shared.open_path(root_of(batch.folder))
    scene.views = tuple(confined(view, batch.folder) for view in scene.views)  # type: ignore[misc]
    session = session_of(scene, shared.budget, edits_kept=False)
    _ = session.shown
    return session


def _show_batch(shared: Shared, name: str, session: Session) -> str:
    """Show a scene that was sent, and return what is said of it."""
    scene = session.scene
    try:
        shared.show(session)
    except BaseException:
        shared.uploads.drop(name)
        raise
    shared.uploads.keep_opened(name)
    if shared.shelf is not None:
        shared.shelf.opened = ("", "")
    return f"opened {printable(scene.name, 60)}: {counted(len(scene.rows), 'Gaussian')}"


def confined(view: View, folder: Path) -> View:
    """Return a view without the photo and the mask that lie outside of a folder: who sent it may have named any."""
    inside = [
        path is None or path.resolve().is_relative_to(folder.resolve()) for path in (view.image_path, view.mask_path)
    ]
    return view if all(inside) else replace(view, image_path=None, mask_path=None)


def open_entry(shared: Shared, number: int) -> Callable[[], Callable[[], str]]:
    """Return what opens the scene of an entry of the catalogue's last answer, which returns what shows its object.

    Raises: InputError: no such entry, or its scene is no longer there.
    """
    shelf, entry = shared.needed_shelf, shared.entry(number)

    def work() -> Callable[[], str]:
        is_open = shelf.opened == (entry.scene, entry.field)
        session = None if is_open else _session(shared, shelf.catalogue.scene(entry.scene))
        return lambda: _show_entry(shared, entry, session)

    return work


def _show_entry(shared: Shared, entry: Entry, session: Session | None) -> str:
    """Select the object of an entry and return what is said of it. session: of its scene, None where it is open."""
    title, name = printable(entry.title, 60), printable(entry.scene, 60)
    if session is not None:
        shared.show(session)
        shared.uploads.keep_opened(None)
        shared.needed_shelf.opened = (entry.scene, entry.field)
    field = shared.session.scene.field
    if field.fingerprint != entry.field or field.objects is None:
        return f"{title} of '{name}', which has changed since it was added"
    shared.session.choose_object(entry.object_id)
    return f"{title} of '{name}'"


def _session(shared: Shared, scene: Scene) -> Session:
    _ = scene.rows  # or the error that says what is missing
    session = session_of(scene, shared.budget, shared.words)
    _ = session.shown
    return session
