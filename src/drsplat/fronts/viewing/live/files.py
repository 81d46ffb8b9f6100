"""Pictures and files that a browser gets: photos, what is shown, scenes with what is known of them, films and paths."""

from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from threading import Event
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import StringConstraints

from ....authoring.editing.draft import OBJECT_ID
from ....authoring.exporting.placing import After, Placing, groups_of, match_thing, only_used, rows_of, things_of
from ....authoring.filming.looking import up_direction
from ....authoring.filming.paths import frame_count, path_of, write_path
from ....authoring.filming.writing import write_film
from ....base.arrays import Flags, Pixels
from ....drawing.pictures import as_pixels
from ....drawing.rendering import render
from ....errors import InputError
from ....formats.json_files import document_in
from ....formats.known import write_scene
from ....query.sheets import OBJECTS_AT_ONCE
from ....scene.labelled import LabelledScene
from ...serving.replies import jpeg, png
from .. import results
from ..exporting import export_session, pictures_of
from ..naming import photo_of
from ..saving import Saves, flight_gif, picture_of, save_scene, write_bytes
from ..session import Session
from ..tiled import UNEDITED
from .stage import FILM_SIZE_PIXELS, FPS, Body, Camera, Path, Stage, path_document, path_through, view_of
from .state import film_formats

SPLIT_SIDE_PIXELS = 960  # longer side of before, and of after
MAX_PICTURES_KEPT = 256  # of objects
MAX_PAGE_QUERIES = 6  # suggested words that a page answers, where nothing was asked


class Saved(NamedTuple):
    """path: where a file is, or what it is called. data: what is in it, empty where that is too large to send."""

    path: FilePath
    data: bytes


class Save(Body):
    """camera: of a swing, for where nothing is found. format: of a scene or a selection."""

    what: Literal["scene", "selection", "swing"]
    format: Literal[".ply", ".glb", ".spz"] = ".ply"
    camera: Camera | None = None


class Film(Path):
    """A film along a path. job: a name to ask with how far it is; none where it is empty."""

    format: Literal[".mp4", ".webm", ".webp", ".gif"]
    job: Annotated[str, StringConstraints(max_length=64)] = ""


# --- pictures ---


def photo(stage: Stage, name: str, side: int) -> bytes:
    """Return a photo as JPEG, or a rendering where it is not at hand. Raises: InputError: no such view."""
    return jpeg(stage.session.scene.picture(name, photo=True, max_side=side))


def clicked_photo(stage: Stage) -> bytes:
    """Return the photo of most support of what was clicked, as JPEG. Raises: InputError: there is none."""
    clicked = stage.session.clicked
    picture = None if clicked is None else photo_of(stage.session.scene, clicked)
    if picture is None:
        raise InputError("no photo shows what was clicked: click something else")
    return jpeg(picture)


def shown_picture(stage: Stage, camera: Camera) -> bytes:
    """Return what the viewer shows as PNG, by this package's own renderer."""
    return png(picture_of(stage.session, view_of(stage, camera)))


def before_after(stage: Stage, camera: Camera) -> bytes:
    """Return the scene before its edits and after them, side by side, as PNG. Raises: InputError: nothing is left."""
    session = stage.session
    view = view_of(stage, camera, SPLIT_SIDE_PIXELS)
    after = session.edited()[0]
    sides = session.here.gaussians, after
    drawn = [as_pixels(render(one, view, threads=session.scene.threads).rgb) for one in sides]
    return png(np.concatenate(drawn, axis=1))


@dataclass(eq=False)
class ObjectPictures:
    """Pictures of objects as JPEG, kept once they are drawn; those listed together are drawn together."""

    _stage: Stage | None = None
    _kept: OrderedDict[int, bytes] = field(default_factory=OrderedDict)

    def known(self, stage: Stage, number: int) -> bytes | None:
        """Return an object's picture where it is drawn already."""
        return self._kept.get(number) if stage is self._stage else None

    def draw(self, stage: Stage, is_ending: Callable[[], bool]) -> None:
        """Draw all that are kept, those listed first, until the viewer ends. Raises: as `picture`."""
        for number in stage.listed[:MAX_PICTURES_KEPT]:
            if is_ending():
                return
            self.picture(stage, number)

    def picture(self, stage: Stage, number: int) -> bytes:
        """Return an object's picture. Raises: InputError: no such object, or no photos of it."""
        if stage is not self._stage:
            self._stage, self._kept = stage, OrderedDict()
        if number not in self._kept:
            if number not in stage.listed:
                raise InputError(f"there is no object {number} of {len(stage.listed)}")
            begin = stage.listed.index(number) // OBJECTS_AT_ONCE * OBJECTS_AT_ONCE
            numbers = stage.listed[begin : begin + OBJECTS_AT_ONCE]
            objects = stage.session.scene.objects
            for one, pixels in zip(numbers, pictures_of(stage.session, [objects[one] for one in numbers]), strict=True):
                if pixels is None:
                    raise InputError("this scene has no photos: open it with its capture to see its objects")
                self._kept[one] = jpeg(np.ascontiguousarray(pixels))
                while len(self._kept) > MAX_PICTURES_KEPT:
                    self._kept.popitem(last=False)
        return self._kept[number]


# --- files ---


def saved(saves: Saves, stage: Stage, asked: Save) -> Saved:
    """Write what was asked for. Raises: InputError: nothing is selected; as `Saves.save`."""
    if asked.what == "swing":
        data = _swing(stage, asked.camera)
        return _save(saves, "found", ".gif", lambda path: write_bytes(path, data))
    only, stem = (True, "selection") if asked.what == "selection" else (False, "found")
    if asked.format == ".ply":
        return _save(saves, stem, ".ply", lambda path: save_scene(path, stage.session, selected_only=only))
    scene = carried(stage.session, selected_only=only)
    return _save(saves, stem, asked.format, lambda path: write_scene(path, scene))


def film(saves: Saves, stage: Stage, asked: Film, is_gone: Event, progress: "Progress") -> Saved:
    """Draw a film in the colours of the moment. is_gone: ends it early, as when nobody waits for it any more.

    Raises: InputError: a format that cannot be written here; as `Saves.save`.
    """
    if asked.format not in film_formats():
        raise InputError(f"{asked.format} needs the program ffmpeg: expected {' or '.join(film_formats())}")
    path, count = path_through(stage, asked), frame_count(asked.seconds, FPS)
    views = path.views(count, FILM_SIZE_PIXELS)

    def pictures() -> Iterator[Pixels]:
        for number, view in enumerate(views):
            if is_gone.is_set():
                raise InputError("the film was not waited for")
            progress.note(asked.job, number, count)
            yield picture_of(stage.session, view)

    try:
        return _save(saves, "film", asked.format, lambda file: write_film(file, pictures(), FPS))
    finally:
        progress.forget(asked.job)


class Progress:
    """How many pictures of films that are being drawn are done, by the names that browsers gave them."""

    def __init__(self) -> None:
        self._jobs: dict[str, tuple[int, int]] = {}

    def note(self, job: str, done: int, count: int) -> None:
        if job:
            self._jobs[job] = done, count

    def forget(self, job: str) -> None:
        self._jobs.pop(job, None)

    def document(self, job: str) -> dict[str, int]:
        """Return pictures that are done, and all of them; 0 of 0 where the film waits for its turn or is whole."""
        done, count = self._jobs.get(job, (0, 0))
        return {"done": done, "count": count}


def path_file(saves: Saves, stage: Stage, asked: Path) -> Saved:
    path = path_through(stage, asked)
    return _save(saves, "path", ".json", lambda file: write_path(file, path))


def loaded_path(stage: Stage, body: bytes) -> dict[str, Any]:
    """Read a path of ours, or nerfstudio's, of the scene's world. Raises: FormatError, InputError: it is none."""
    return path_document(stage, path_of(document_in(body, "the path"), "the path"))


def page_file(saves: Saves, stage: Stage) -> Saved:
    """Export the scene with the queries that are answered now, else with the words that are suggested.

    Raises: InputError: nothing was asked, and no word has a match.
    """
    session = stage.session
    if session.scene.tiles is not None:
        raise InputError(UNEDITED)
    queries = (session.asked or stage.words[:MAX_PAGE_QUERIES]) if session.is_askable else ()
    return _save(saves, "page", ".html", lambda path: export_session(path, session, queries, up=stage.up))


def _save(saves: Saves, stem: str, suffix: str, write: Callable[[FilePath], object]) -> Saved:
    return Saved(*saves.save(stem, suffix, write))


def _swing(stage: Stage, camera: Camera | None) -> bytes:
    """Return a swing around the best match, else about what a camera looks at, as GIF."""
    session = stage.session
    found = [match for result in session.results for match in result.matches]
    if found:
        match = stage.placed(found[0])
        return flight_gif(session, stage.eye_before(match.center, match.extent), match.center, stage.up)
    if camera is None:
        raise InputError("swing: expected a match to swing about, or a camera")
    eye, target = (session.shown.frame.world(np.array(at, np.float64)) for at in (camera.eye, camera.target))
    return flight_gif(session, eye, target, stage.up)


def carried(session: Session, *, selected_only: bool = False) -> LabelledScene:
    """Return what is not hidden with all that is known of it; the answers are those that are shown, together.

    Raises: InputError: nothing is selected where `selected_only`, or nothing is left.
    """
    scene = session.scene
    gaussians, ids = session.edited(selected_only=selected_only)
    placing = Placing(scene.gaussians, _after(session), scene.up)
    things = placing.objects(things_of(scene))
    owners = gaussians.extra.get(OBJECT_ID) if things else None
    found = [(result, match) for result in session.results for match in result.matches]
    matches = [match_thing(scene, number, match) for number, (_, match) in enumerate(found)]
    up = up_direction(scene)
    whole = LabelledScene(
        replace(gaussians, extra={name: own for name, own in gaussians.extra.items() if name != OBJECT_ID}),
        scene.name,
        tuple(things),
        groups_of(scene),
        None if owners is None else rows_of(things, owners),
        "; ".join(result.label for result in session.results),
        _relevancy(session, ids) if session.results else None,
        placing.matches([match for _, match in found], matches),
        session.edits.annotations,
        (float(up[0]), float(up[1]), float(up[2])),
        num_edits=session.edits.listed.done,
    )
    return only_used(whole) if selected_only else whole


def _after(session: Session) -> After:
    """Return all rows of the edits on show, those that they added behind the scene's own."""
    everything, rows = session.edits.part(np.arange(len(session.edits.opacities)))
    present: Flags = np.zeros(len(rows), bool)
    present[session.edited()[1]] = True
    owners = everything.extra.get(OBJECT_ID)
    known = len(session.scene.field.objects or ())
    added = [] if owners is None else np.unique(owners[owners >= known]).tolist()
    return After(everything, present, dict.fromkeys(added, -1))


def _relevancy(session: Session, ids: np.ndarray) -> np.ndarray:
    """Return the highest relevancy of the answers on show; 0 of what edits added."""
    values = np.zeros(len(ids), np.float32)
    own = ids < len(session.scene.gaussians)
    values[own] = results.relevancy(session.results, len(session.scene.gaussians))[ids[own]]
    return values
