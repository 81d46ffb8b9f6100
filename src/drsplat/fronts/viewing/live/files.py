"""Pictures and files that a browser gets: photos, what is shown, scenes with what is known of them, films and paths."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path as FilePath
from threading import Event
from typing import Annotated, Any, Literal

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
from ...serving.query_fields import Strict
from ...serving.replies import jpeg, png
from .. import results
from ..exporting import export_session, pictures_of
from ..naming import photo_of
from ..saving import Saves, flight_gif, picture_of, save_scene, write_bytes
from ..session import Session
from ..stage import Stage
from ..tiled import UNEDITED
from .cameras import FILM_SIZE_PIXELS, FPS, Camera, Path, path_document, path_through, view_of
from .state import film_formats

SPLIT_SIDE_PIXELS = 960  # longer side of before, and of after
MAX_PICTURES_KEPT = 256  # of objects
MAX_PAGE_QUERIES = 6  # suggested words that a page answers, where nothing was asked
Saved = tuple[FilePath, bytes]
"""Path of a file, or its name, and its content: nothing where that is too large to send."""


class Save(Strict):
    """camera: of a swing, for where nothing is found. format: of a scene or a selection."""

    what: Literal["scene", "selection", "swing"]
    format: Literal[".ply", ".glb", ".spz"] = ".ply"
    camera: Camera | None = None


class Film(Path):
    """A film along a path. job: a name to ask with how far it is; none where it is empty."""

    format: Literal[".mp4", ".webm", ".webp", ".gif"]
    job: Annotated[str, StringConstraints(max_length=64)] = ""


# --- pictures ---


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
    session, view = stage.session, view_of(stage, camera, SPLIT_SIDE_PIXELS)
    after = session.edited()[0]
    sides = session.here.gaussians, after
    return png(
        np.concatenate([as_pixels(render(one, view, threads=session.scene.threads).rgb) for one in sides], axis=1)
    )


def draw_pictures(stage: Stage, is_ending: Callable[[], bool]) -> None:
    """Draw the pictures of objects that are kept, those listed first, until the viewer ends."""
    for number in stage.listed[:MAX_PICTURES_KEPT]:
        if is_ending():
            return
        object_picture(stage, number)


def object_picture(stage: Stage, number: int) -> bytes:
    """Return an object's picture as JPEG, which is kept; those listed together are drawn together.

    Raises: InputError: no such object, or no photos of it.
    """
    kept, listed = stage.pictures, stage.listed
    if number not in kept:
        if number not in listed:
            raise InputError(f"there is no object {number} of {len(listed)}")
        begin = listed.index(number) // OBJECTS_AT_ONCE * OBJECTS_AT_ONCE
        numbers, scene = listed[begin : begin + OBJECTS_AT_ONCE], stage.session.scene
        drawn = pictures_of(scene, [scene.objects[one] for one in numbers])
        for one, pixels in zip(numbers, drawn, strict=True):
            if pixels is None:
                raise InputError("this scene has no photos: open it with its capture to see its objects")
            kept[one] = jpeg(np.ascontiguousarray(pixels))
            while len(kept) > MAX_PICTURES_KEPT:
                del kept[next(iter(kept))]
    return kept[number]


# --- files ---


def saved(saves: Saves, stage: Stage, asked: Save, _: Event) -> Saved:
    """Write what was asked for. Raises: InputError: nothing is selected; as `Saves.save`."""
    if asked.what == "swing":
        data = _swing(stage, asked.camera)
        return saves.save("found", ".gif", lambda path: write_bytes(path, data))
    only, stem = (True, "selection") if asked.what == "selection" else (False, "found")
    if asked.format == ".ply":
        return saves.save(stem, ".ply", lambda path: save_scene(path, stage.session, selected_only=only))
    scene = carried(stage.session, selected_only=only)
    return saves.save(stem, asked.format, lambda path: write_scene(path, scene))


def film(saves: Saves, stage: Stage, asked: Film, is_gone: Event) -> Saved:
    """Draw a film in the colours of the moment. is_gone: ends it early, as when nobody waits for it any more.

    Raises: InputError: a format that cannot be written here; as `Saves.save`.
    """
    if asked.format not in film_formats():
        raise InputError(f"{asked.format} needs the program ffmpeg: expected {' or '.join(film_formats())}")
    path, count = path_through(stage, asked), frame_count(asked.seconds, FPS)

    def pictures() -> Iterator[Pixels]:
        for number, view in enumerate(path.views(count, FILM_SIZE_PIXELS)):
            if is_gone.is_set():
                raise InputError("the film was not waited for")
            if asked.job:
                saves.films[asked.job] = number, count
            yield picture_of(stage.session, view)

    try:
        return saves.save("film", asked.format, lambda file: write_film(file, pictures(), FPS))
    finally:
        saves.films.pop(asked.job, None)


def path_file(saves: Saves, stage: Stage, asked: Path, _: Event) -> Saved:
    path = path_through(stage, asked)
    return saves.save("path", ".json", lambda file: write_path(file, path))


def loaded_path(stage: Stage, body: bytes) -> dict[str, Any]:
    """Read a path of ours, or nerfstudio's, of the scene's world. Raises: FormatError, InputError: it is none."""
    return path_document(stage, path_of(document_in(body, "the path"), "the path"))


def page_file(saves: Saves, stage: Stage, *_: object) -> Saved:
    """Export the scene with the queries that are answered now, else with the words that are suggested.

    Raises: InputError: nothing was asked, and no word has a match.
    """
    session = stage.session
    if session.scene.tiles is not None:
        raise InputError(UNEDITED)
    queries = (session.asked or stage.words[:MAX_PAGE_QUERIES]) if session.is_askable else ()
    return saves.save("page", ".html", lambda path: export_session(path, session, queries, up=stage.up))


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
    scene, edits, count = session.scene, session.edits, len(session.scene.gaussians)
    gaussians, ids = session.edited(selected_only=selected_only)
    placing = Placing(scene.gaussians, _after(session), scene.up)
    things = placing.objects(things_of(scene))
    owners = gaussians.extra.get(OBJECT_ID) if things else None
    found = [match for result in session.results for match in result.matches]
    matches = [match_thing(scene, number, match) for number, match in enumerate(found)]
    x, y, z = up_direction(scene).tolist()
    whole = LabelledScene(
        replace(gaussians, extra={name: own for name, own in gaussians.extra.items() if name != OBJECT_ID}),
        scene.name,
        tuple(things),
        groups_of(scene),
        None if owners is None else rows_of(things, owners),
        "; ".join(result.label for result in session.results),
        results.taken(results.relevancy(session.results, count), ids) if session.results else None,
        placing.matches(found, matches),
        edits.annotations,
        (x, y, z),
        num_edits=edits.listed.done,
    )
    return only_used(whole) if selected_only else whole


def _after(session: Session) -> After:
    """Return all rows of the edits on show, those that they added behind the scene's own."""
    everything = session.edits.everything
    present: Flags = np.zeros(len(everything), bool)
    present[session.edited()[1]] = True
    owners = everything.extra.get(OBJECT_ID)
    known = len(session.scene.field.objects or ())
    added = [] if owners is None else np.unique(owners[owners >= known]).tolist()
    return After(everything, present, dict.fromkeys(added, -1))
