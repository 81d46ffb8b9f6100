"""Other scenes in place of the one that is open: of files that a browser sent, and of a catalogue's entries."""

from dataclasses import replace
from pathlib import Path

from ...errors import DrSplatError
from ...query import Scene
from ...scene.views import View
from ...serving.scene_folder import without_paths
from ...terminal import counted
from ..session import Session
from ..texts import printable
from .shared import Shared
from .uploads import root_of


def open_batch(shared: Shared, name: str) -> str:
    """Show the scene of a batch of files. On failure what was open stays, and the files go.

    Edits are kept in memory: a stranger's list of edits could name files of this machine.

    Raises: InputError: no such batch. FormatError, MismatchError: as the readers of scenes.
    """
    batch = shared.uploads.batch(name)
    try:
        scene = shared.open_path(root_of(batch.folder))
        scene.views = tuple(confined(view, batch.folder) for view in scene.views)  # type: ignore[misc]
        session = Session(scene, shared.budget, edits_kept=False)
        shared.show(session)
    except BaseException as error:
        shared.uploads.drop(name)
        if isinstance(error, DrSplatError):
            error.args = (without_paths(str(error), [batch.folder]),)
        raise
    shared.uploads.keep_opened(name)
    if shared.shelf is not None:
        shared.shelf.opened = ("", "")
    return f"opened {printable(scene.name, 60)}: {counted(len(scene.gaussians), 'Gaussian')}"


def confined(view: View, folder: Path) -> View:
    """Return a view without the photo and the mask that lie outside of a folder: who sent it may have named any."""
    inside = [path is None or path.resolve().is_relative_to(folder.resolve()) for path in _files_of(view)]
    return view if all(inside) else replace(view, image_path=None, mask_path=None)


def _files_of(view: View) -> tuple[Path | None, Path | None]:
    return view.image_path, view.mask_path


def open_entry(shared: Shared, number: int) -> str:
    """Show the scene of an entry of the catalogue's last answer, with its object selected.

    Raises: InputError: no such entry, or its scene is no longer there.
    """
    shelf = shared.needed_shelf
    entry = shelf.entry(number)
    title, name = printable(entry.title, 60), printable(entry.scene, 60)
    if shelf.opened != (entry.scene, entry.field):
        shared.show(_session(shared, shelf.catalogue.scene(entry.scene)))
        shared.uploads.keep_opened(None)
        shelf.opened = (entry.scene, entry.field)
    field = shared.session.scene.field
    if field.fingerprint != entry.field or field.objects is None:
        return f"{title} of '{name}', which has changed since it was added"
    shared.session.choose_object(entry.object_id)
    return f"{title} of '{name}'"


def _session(shared: Shared, scene: Scene) -> Session:
    _ = scene.gaussians  # or the error that says what is missing
    return Session(scene, shared.budget, shared.words)
