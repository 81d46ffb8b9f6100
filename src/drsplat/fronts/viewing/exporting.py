"""Pages made of a scene and queries, with its objects and annotations."""

import base64
import io
from collections.abc import Sequence

import numpy as np
from PIL import Image

from ...authoring.editing.edits import KeptEdits, without_kept
from ...authoring.filming.planning import ORBIT, path_named
from ...base.arrays import Arrays, OtherPixels, Vector3
from ...base.contents import AnyPath, Document
from ...errors import InputError
from ...query import Match, Scene
from ...query.sheets import object_picture, object_views
from ...query.suggesting import suggestions
from . import painting, results
from .bare import NO_FIELD
from .client import printable
from .page import MAX_GAUSSIANS, Page, PageAnswer, PageTimes, boxes_of, times_of_page, write_page
from .page_search import search_of
from .session import Mode, Session
from .shown import as_bytes
from .stage import Stage

CARD_SIZE_PIXELS = (200, 150)
MAX_LABELS = 40  # whose objects a page has from the start
MAX_MATCHES = 254  # of one query: a byte per Gaussian says which
MAX_OBJECTS_LISTED = 60  # the largest that photos agree on; and as many of the others, behind "more"
MAX_PICTURES, PICTURE_SIZE_PIXELS, JPEG_QUALITY = 24, (112, 84), 70  # some 3 KB each
NEVER = ("ask_picture", "name", "edit", "time", "photos", "save_dir", "catalogue", "open")
"""Offers of the client that a page lacks: it only answers what it was made with."""


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
    page = page_of(Stage.of(session, up), queries, title, path_name, plays, known)
    write_page(path, page, overwrite=overwrite)
    return page


def export_session(path: AnyPath, session: Session, queries: Sequence[str], *, up: Vector3) -> Page:
    """Write a page of a session's scene as edited there, with the answers to queries; the session stays as it is.

    Raises: as `export_page`.
    """
    page = page_of(Stage.of(session.unasked(MAX_GAUSSIANS), up), queries)
    write_page(path, page)
    return page


def page_of(
    stage: Stage,
    queries: Sequence[str],
    title: str = "",
    path_name: str = ORBIT,
    plays: bool = False,
    known: Sequence[str] = (),
) -> Page:
    """Make a page of a session that was not asked anything; arguments and errors as of `export_page`."""
    session, scene = stage.session, stage.session.scene
    if queries and not session.is_askable:
        raise InputError(NO_FIELD)
    film = path_named(path_name, scene.gaussians, scene.views, up=stage.up)
    asked = queries or (suggestions(scene, session.words) if session.is_askable else ())
    labels = [label.name for label in scene.labels.by_node.values()][:MAX_LABELS]
    times, shown = times_of_page(session), session.drawn
    stage.names = stage.object_names()
    session.mode = Mode.FEATURES
    rows: Arrays = {"features": as_bytes(session.drawn_colors[shown.ids])}
    objects = _objects(stage, times, rows)
    answers = [_answer(stage, text, times, rows) for text in dict.fromkeys((*asked, *labels))]
    search = search_of(session, known)
    answered = ["answer", "heat map"] if answers or search else []
    header = stage.look_document() | {
        "title": printable(title or scene.name),
        "about": " ".join(f"{len(shown):,} Gaussians. {times.summary if times else ''} {shown.summary}".split()),
        "words": [printable(answer.text) for answer in answers],
        "modes": [*answered, "as it is", *(["features"] if answered else []), *(["objects"] if objects else [])],
        "can": dict.fromkeys(NEVER, False) | {"ask": bool(answered), "objects": bool(objects), "film_formats": []},
        "objects": objects, "photos": [], "times": None, "plays": plays,
        "annotations": [stage.annotation_document(one) for one in session.edits.annotations],
        "answers": [answer.document for answer in answers],
    }  # fmt: skip
    best, target = next((answer for answer in answers if answer.matches), None), stage.first_look[1]
    if best is not None:
        first, target = best.document["matches"][0], best.matches[0].center
        header |= {"eye": first["eye"], "target": first["center"]}
    header["film"] = stage.film_document(film, target)
    edits = session.edits
    return Page(header, rows, edits.part(shown.ids)[0], shown, answers, times, search, edits.listed.done)


def _answer(stage: Stage, text: str, times: PageTimes | None, rows: Arrays) -> PageAnswer:
    """Return the answer to a text, and add what each shown Gaussian answers to some arrays."""
    session, count = stage.session, len(stage.session.scene.gaussians)
    number = sum(name.startswith("heat") for name in rows)
    result = results.result_of(session.scene, text, session.scene.ask(text), MAX_MATCHES)
    rows[f"heat{number}"] = as_bytes(session.of_drawn(results.heat([result], count)))
    rows[f"owner{number}"] = session.of_drawn((results.match_ids([result], count) + 1).astype(np.uint8))
    matches = [stage.placed(match) for match in result.matches]
    boxes = boxes_of(session, times, matches)
    document: Document = {
        "text": printable(text), "summary": "", "doubt": result.notes(), "accent": painting.accent(number),
        "matches": [stage.match_document(one) | {"boxes": box} for one, box in zip(matches, boxes, strict=True)],
        "num_matches": len(matches), "threshold": 0, "automatic": 0, "limits": [0, 1], "measure": "",
        "threshold_rule": "", "exact": True, "instead": list(result.instead),
    }  # fmt: skip
    return PageAnswer(text, matches, document)


def _objects(stage: Stage, times: PageTimes | None, rows: Arrays) -> list[Document]:
    """Return the objects that a page lists, those that photos agree on first; [] without objects.

    The first ones have a picture. Per shown Gaussian, rows get 0, or 1 for the first object that is listed.
    """
    session, scene = stage.session, stage.session.scene
    if not session.has_objects:
        return []
    sure, unsure = (numbers[:MAX_OBJECTS_LISTED] for numbers in stage.agreed)
    numbers = [*sure, *unsure]
    place_of = np.zeros(len(scene.objects) + 1, np.uint16)  # the last is of -1: no object
    place_of[numbers] = np.arange(1, len(numbers) + 1)
    rows["objects"] = session.of_drawn(place_of[session.objects_at()])
    matches = [stage.placed(scene.objects[number]) for number in numbers]
    pictures = [_data_url(picture) for picture in pictures_of(scene, matches[:MAX_PICTURES])]
    pictures += [""] * (len(matches) - len(pictures))
    boxes = boxes_of(session, times, matches)
    documents = stage.object_documents(numbers, matches)
    return [
        document | {"picture": picture, "boxes": box}
        for document, picture, box in zip(documents, pictures, boxes, strict=True)
    ]


def pictures_of(scene: Scene, matches: list[Match]) -> list[OtherPixels | None]:
    """Return each cut out of the photo, or the rendering, that shows it best; none of a scene without views."""
    if not scene.views:
        return [None] * len(matches)
    views = object_views(scene, matches)
    return [object_picture(scene, match, view, CARD_SIZE_PIXELS) for match, view in zip(matches, views, strict=True)]


def _data_url(pixels: OtherPixels | None) -> str:
    if pixels is None:
        return ""
    out = io.BytesIO()
    picture = Image.fromarray(pixels).resize(PICTURE_SIZE_PIXELS, Image.Resampling.LANCZOS)
    picture.save(out, "JPEG", quality=JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
