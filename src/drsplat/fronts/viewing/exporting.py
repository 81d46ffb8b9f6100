"""Pages made of a scene and queries, with its objects and annotations."""

import base64
import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image

from ...authoring.editing.edits import KeptEdits, without_kept
from ...authoring.filming.looking import before, up_direction
from ...authoring.filming.paths import CameraPath
from ...authoring.filming.planning import ORBIT, path_named
from ...base.arrays import OtherPixels, SmallIds, Vector3
from ...base.contents import AnyPath, Document
from ...drawing.heat import heat_of
from ...errors import InputError
from ...kernels.boxes import box_of
from ...query import Match, Scene
from ...query.sheets import object_picture, object_views
from ...query.suggesting import suggestions
from ...scene.boxes import solid
from ...scene.labelled import Annotation
from .bare import NO_FIELD
from .client import printable
from .page import MAX_GAUSSIANS, Page, PageAnswer, PageTimes, boxes_of, times_of_page, write_page
from .page_search import search_of
from .results import result_of
from .session import Mode, Session
from .shown import box_document, first_look, size_text

CARD_SIZE_PIXELS = (200, 150)


def pictures_of(session: Session, matches: list[Match]) -> list[OtherPixels | None]:
    """Return each cut out of the photo, or the rendering, that shows it best; none of a scene without views."""
    if not session.scene.views:
        return [None] * len(matches)
    views = object_views(session.scene, matches)
    return [
        object_picture(session.scene, match, view, CARD_SIZE_PIXELS) for match, view in zip(matches, views, strict=True)
    ]


def names_of(session: Session) -> list[str]:
    """Label, else the word for it, and the number of each object; "object 7" or "surface 7" where no word is sure."""
    scene = session.scene
    words, flat = scene.object_names(words=session.words or ()), scene.surfaces
    return [
        f"{match.label or word} · {number}"
        if match.label or word
        else f"{'surface' if flat and flat[number] else 'object'} {number}"
        for number, (match, word) in enumerate(zip(scene.objects, words, strict=True))
    ]


def in_order(session: Session) -> tuple[list[int], list[int]]:
    """Return the numbers of the objects that photos agree on or that have a label, and those of the others."""
    agreed = session.scene.agreed
    return np.flatnonzero(agreed).tolist(), np.flatnonzero(~agreed).tolist()


def placed_now(session: Session, match: Match) -> Match:
    """Return a match with its box where its Gaussians are now, at the session's time and after its edits."""
    if session.scene.tiles is not None:
        return match
    ids = match.gaussian_ids
    now = session.standing(ids)
    if session.time is None and np.array_equal(now.means, session.scene.rows.shapes_of(ids).means):
        return match
    box = box_of(now, solid(now, np.arange(len(ids))), session.scene.up)
    return replace(match, center=box.center, axes=box.axes, extent=box.extent)


MAX_LABELS = 40  # whose objects a page has from the start
MAX_MATCHES = 254  # of one query: a byte per Gaussian says which
POINT_SIZE = 1.0  # of the browser's units
MAX_OBJECTS_LISTED = 60  # the largest that photos agree on; and as many of the others, behind "more"
MAX_PICTURES, PICTURE_SIZE_PIXELS, JPEG_QUALITY = 24, (112, 84), 70  # some 3 KB each


def export_page(
    path: AnyPath,
    scene: Scene,
    queries: Sequence[str],
    *,
    words: Sequence[str] | None = None,
    up: Vector3 | None = None,
    max_gaussians: int | None = None,
    path_name: str = ORBIT,
    plays: bool = False,
    title: str = "",
    edits: KeptEdits = "kept",
    known: Sequence[str] = (),
    overwrite: bool = False,
) -> Page:
    """Write a scene to one HTML file that answers words, and needs nothing but a browser; returns what is in it.

    queries: whose answers it has from the start; none: words that find something. known: words and phrases that it
    answers besides those that the field keeps and the encoder's own.

    words: what a click on the page can say; None: the encoder's own. up: a unit direction, None: as the photos were
    held. max_gaussians: the most significant ones are shown, 200,000 at most. path_name: of the film that it plays, as
    `authoring.filming.planning.path_named` has it. plays: plays it when it is opened. title: the scene's name if
    empty. edits: "kept" shows the scene with the edits kept beside it, `num_edits` of the page; "none" as its file has
    it.

    Raises: InputError: queries of a scene that cannot be asked any; the file exists and not `overwrite`; words
    that the encoder does not know; more that moves than a page has room for. MismatchError: another encoder.

    >>> page = ds.export_page("page.html", scene, ["red mug"])
    """
    session = Session(
        scene,
        min(max_gaussians or MAX_GAUSSIANS, MAX_GAUSSIANS),
        words,
        edits_kept=not without_kept(edits, changes=False, saves=False),
    )
    up = up_direction(scene) if up is None else up
    page = _filmed_page(session, queries, up, title, path_name)
    page = replace(page, plays=plays, search=search_of(session, known))
    write_page(path, page, overwrite=overwrite)
    return page


def export_session(path: AnyPath, session: Session, queries: Sequence[str], *, up: Vector3) -> Page:
    """Write a page of a session's scene as edited there, with the answers to queries; the session stays as it is.

    Raises: as `export_page`.
    """
    session = session.unasked(MAX_GAUSSIANS)
    page = replace(_filmed_page(session, queries, up, "", ORBIT), search=search_of(session))
    write_page(path, page)
    return page


def _filmed_page(session: Session, queries: Sequence[str], up: Vector3, title: str, path_name: str) -> Page:
    """Return a page of a session that was not asked anything, with a film."""
    if queries and not session.is_askable:
        raise InputError(NO_FIELD)
    film = path_named(path_name, session.scene.gaussians, session.scene.views, up=up)
    asked = queries or (suggestions(session.scene, session.words) if session.is_askable else ())
    labels = [label.name for label in session.scene.labels.by_node.values()][:MAX_LABELS]
    return page_of(session, tuple(dict.fromkeys((*asked, *labels))), None, up, title, film)


def page_of(
    session: Session,
    texts: Sequence[str],
    look: tuple[Vector3, Vector3] | None,
    up: Vector3,
    title: str = "",
    path: CameraPath | None = None,
) -> Page:
    """Make a page of the scene with the answers to some texts.

    look: eye and target of the first look, in the world; None: before the best match of the first text that has one,
    else as the viewer begins.

    Raises: InputError: words that the encoder does not know; too much that moves. MismatchError: another encoder.
    """
    times = times_of_page(session)
    scene, shown = session.scene, session.drawn
    answers = [_answer(session, text, up, times) for text in texts]
    session.mode = Mode.FEATURES
    features = session.drawn_colors[shown.ids]
    numbers = object_numbers(session)
    best_look = next(((answer.eyes[0], answer.matches[0].center) for answer in answers if answer.matches), None)
    look = look or best_look or first_look(scene.views, session.shown.frame, up)
    return Page(
        title or scene.name, shown, session.edits.part(shown.ids)[0], answers, *look, up, features,
        objects=objects_of_page(session, up, times), annotations=annotations_of_page(session, up),
        object_numbers=None if numbers is None else session.of_drawn(numbers), path=path, times=times,
        num_edits=session.edits.listed.done,
    )  # fmt: skip


def _answer(session: Session, text: str, up: Vector3, times: PageTimes | None) -> PageAnswer:
    scene = session.scene
    result = result_of(scene, text, scene.ask(text))
    matches = [placed_now(session, match) for match in result.matches[:MAX_MATCHES]]
    warm = heat_of(result.answer.values, result.threshold)
    owners = np.zeros(len(scene.gaussians), np.uint8)
    for number, one in enumerate(result.matches[:MAX_MATCHES]):
        owners[one.gaussian_ids] = number + 1
    return PageAnswer(
        text,
        session.of_drawn(scene.field.dense(warm, fill=0.0)),
        session.of_drawn(owners),
        matches,
        [before(match, scene.gaussians, scene.views, up) for match in matches],
        boxes_of(session, times, matches),
        result.notes(),
        result.instead,
    )


def objects_of_page(session: Session, up: Vector3, times: PageTimes | None = None) -> list[Document]:
    """Return each object's name, box, a place to see it from, whether photos agree less on it; [] without objects.

    The first objects also have a picture.
    """
    if not session.has_objects:
        return []
    scene, frame = session.scene, session.shown.frame
    every, names, agreed, numbers = scene.objects, names_of(session), scene.agreed, listed_numbers(session)
    matches = [placed_now(session, every[number]) for number in numbers]
    pictures = [_data_url(picture) for picture in pictures_of(session, matches[:MAX_PICTURES])]
    pictures += [""] * (len(matches) - len(pictures))
    return [
        box_document(frame, match.center, match.axes, match.extent)
        | {
            "number": number,
            "size": size_text(match.extent),
            "num_gaussians": len(match),
            "name": printable(names[number], 60),
            "unsure": not agreed[number],
            "picture": picture,
            "eye": frame.shown(before(match, scene.gaussians, scene.views, up)).tolist(),
            "boxes": boxes,
        }
        for number, match, picture, boxes in zip(
            numbers, matches, pictures, boxes_of(session, times, matches), strict=True
        )
    ]


def listed_numbers(session: Session) -> list[int]:
    """Return the numbers of the objects that a page lists, those that photos agree on first."""
    sure, unsure = in_order(session)
    return [*sure[:MAX_OBJECTS_LISTED], *unsure[:MAX_OBJECTS_LISTED]]


def object_numbers(session: Session) -> SmallIds | None:
    """Return per Gaussian of the scene 0, or 1 for the first object that is listed; None where there are none."""
    if not session.has_objects:
        return None
    numbers = listed_numbers(session)
    place_of = np.zeros(len(session.scene.agreed) + 1, np.uint16)  # the last is of -1: no object
    place_of[numbers] = np.arange(1, len(numbers) + 1)
    return place_of[session.scene.object_ids()]


def annotations_of_page(session: Session, up: Vector3) -> list[Document]:
    """Return text and place of each, and its box where it has one."""
    frame = session.shown.frame
    return [
        {"text": printable(one.text, 200), "center": frame.shown(one.center).tolist(), "eye": _eye(session, one, up)}
        | ({} if one.outline is None else box_document(frame, one.center, one.outline.axes, one.outline.extent))
        for one in session.edits.annotations
    ]


def _eye(session: Session, one: Annotation, up: Vector3) -> list[float]:
    """Return a place to see an annotation from, as a match of its size is seen."""
    scene, frame = session.scene, session.shown.frame
    axes, extent = (np.eye(3), np.full(3, POINT_SIZE / frame.scale)) if one.outline is None else one.outline
    place = Match(one.center, axes, extent, 1.0, np.empty(0, np.int64))
    return frame.shown(before(place, scene.gaussians, scene.views, up)).tolist()


def _data_url(pixels: np.ndarray | None) -> str:
    if pixels is None:
        return ""
    out = io.BytesIO()
    Image.fromarray(pixels).resize(PICTURE_SIZE_PIXELS, Image.Resampling.LANCZOS).save(
        out, "JPEG", quality=JPEG_QUALITY
    )
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
