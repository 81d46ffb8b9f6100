"""State of a scene for a browser, as JSON: a header for as long as it is open, and a state after each act.

Places are in the browser's frame, texts are safe to show, and sizes in texts are in scene units.
"""

import numpy as np

from ....authoring.editing.edits import NAMES
from ....authoring.filming.looking import FOV_DEGREES
from ....authoring.filming.writing import ffmpeg
from ....base.arrays import Matrix3, Vector3
from ....base.contents import Document
from ....drawing.heat import HEAT, class_colors
from ....query import Match
from ....query.documents import support_document
from ....query.nodes import numbered
from ....query.objects import objects_of
from ....scene.labelled import Annotation
from ....scene.views import View
from .. import painting
from ..bare import NO_FIELD
from ..client import printable
from ..exporting import POINT_SIZE
from ..naming import This, best_photo
from ..page import playing_seconds
from ..results import Result
from ..session import Session
from ..shown import DECIMALS, box_document, match_document, place_text, rounded, size_text
from .arrays import tiles_document
from .stage import MAX_TEXT_CHARACTERS, Stage

MAX_PHOTOS, MAX_OBJECTS, MAX_MATCHES, MAX_LISTED = 200, 500, 100, 100
MAX_SENTENCE_CHARACTERS = 600
FILM_FORMATS = (".mp4", ".webm", ".webp", ".gif")


def film_formats() -> tuple[str, ...]:
    """Return the suffixes of films that can be written here; MP4 and WebM need the program ffmpeg."""
    return FILM_FORMATS if ffmpeg() else FILM_FORMATS[2:]


# --- for as long as the scene is open ---


def header_of(stage: Stage) -> Document:
    session, frame, views = stage.session, stage.session.shown.frame, stage.session.scene.views
    eye, target = stage.first_look
    # the words that are offered while somebody types: suggestions, then names of objects, each once
    names = [name for number in stage.listed if (name := stage.names[number].rpartition(" · ")[0])]
    return {
        "title": printable(session.scene.name, 60),
        "about": about(session),
        "eye": rounded(frame.shown(eye)),
        "target": rounded(frame.shown(target)),
        "up": rounded(stage.up),
        "fov": FOV_DEGREES,
        "heat": rounded(HEAT),
        "look": painting.LOOK,
        "antialiased": session.shown.antialiased,
        "scale": frame.scale,
        "words": list(dict.fromkeys(printable(word, 60) for word in (*stage.words, *names)))[:MAX_LISTED],
        "modes": [mode.value for mode in session.modes],
        "objects": _objects(stage),
        "photos": [_photo(stage, view) for view in views[:: -(-len(views) // MAX_PHOTOS) or 1]],
        "times": _times(session),
        "tiles": tiles_document(stage),
    }


def about(session: Session) -> str:
    scene = session.scene
    note = "" if session.is_askable else f" {NO_FIELD}"
    counts = f"{len(scene.rows):,} Gaussians, {len(scene.field):,} with a feature."
    return f"{counts} {session.shown.summary}".strip() + note


def _objects(stage: Stage) -> list[Document]:
    if not stage.listed:
        return []
    objects, agreed = stage.session.scene.objects, stage.session.scene.agreed
    return [
        _object(stage, number, objects[number]) | {"unsure": not bool(agreed[number])}
        for number in stage.listed[:MAX_OBJECTS]
    ]


def _object(stage: Stage, number: int, match: Match) -> Document:
    placed = stage.placed(match)
    return _box(stage, placed.center, placed.axes, placed.extent) | {
        "number": number,
        "name": printable(stage.names[number], 60),
        "size": size_text(placed.extent),
        "num_gaussians": len(match),
    }


def _photo(stage: Stage, view: View) -> Document:
    frame, ahead = stage.session.shown.frame, view.cam_from_world[2, :3]
    eye = frame.shown(view.center)
    return {
        "name": view.name,
        "eye": rounded(eye),
        "target": rounded(eye + ahead),
        "up": rounded(-view.cam_from_world[1, :3]),
        "fov": float(np.degrees(2 * np.arctan(view.height / (2 * view.K[1, 1])))),
        "width": view.width,
        "height": view.height,
    }


def _times(session: Session) -> Document | None:
    if session.scene.motion is None:
        return None
    (first, last), count = session.scene.motion.span, len(session.scene.motion.times)
    return {"first": first, "last": last, "count": count, "seconds": playing_seconds(count)}


# --- after each act ---


def state_of(stage: Stage) -> Document:
    session = stage.session
    return {
        "mode": session.mode.value,
        "asked": [printable(text, MAX_TEXT_CHARACTERS) for text in session.asked],
        "present": session.present,
        "selection": len(session.selection),
        "results": [_result(stage, number, result) for number, result in enumerate(session.results)],
        "clicked": None if session.clicked is None else _clicked(session, session.clicked),
        "chosen": _chosen(session),
        "classes": _classes(session),
        "annotations": [_annotation(stage, annotation) for annotation in session.edits.annotations[:MAX_LISTED]],
        "time": None if session.time is None else {"at": session.time, "during": session.during},
        **_edits(session),
    }


def _result(stage: Stage, number: int, result: Result) -> Document:
    answer = result.answer
    return {
        "text": printable(result.label),
        "summary": printable(result.summary, MAX_SENTENCE_CHARACTERS),
        "doubt": printable(result.notes(), MAX_SENTENCE_CHARACTERS),
        "instead": list(result.instead),
        "threshold": result.threshold,
        "automatic": answer.threshold,
        "limits": list(result.limits),
        "measure": answer.measure,
        "threshold_rule": answer.rule,
        "exact": answer.is_exact,
        "accent": list(painting.accent(number)),
        "matches": [_match(stage, result, match) for match in result.matches[:MAX_MATCHES]],
        "num_matches": len(result.matches),
    }


def _match(stage: Stage, result: Result, match: Match) -> Document:
    placed = stage.placed(match)
    eye = stage.eye_before(placed.center, placed.extent)
    return match_document(stage.session.shown.frame, placed, eye, match.label or result.label)


def _clicked(session: Session, this: This) -> Document:
    return {
        "name": printable(this.name, 60),
        "words": [{"text": printable(word.text, 60), "score": round(word.score, 4)} for word in this.words],
        "place": place_text(this.point),
        "center": rounded(session.shown.frame.shown(this.point)),
        "support": support_document(this.evidence, DECIMALS),
        "photo": best_photo(session.scene, this) is not None,
    }


def _chosen(session: Session) -> Document | None:
    chosen = session.chosen
    if chosen is None:
        return None
    objects, node = objects_of(session.scene.field), chosen.node
    number = int(objects.number_of[node])
    return {
        "name": printable(session.results[0].label, 60),
        "what": numbered(objects, node),
        "number": number if number >= 0 and objects.things[number] == node else None,
        "smaller": chosen.smaller(objects) is not None,
        "larger": chosen.larger() is not None,
        "num_gaussians": int(objects.sizes[node]),
        "photos": int(objects.num_views[node]),
        "sure": round(float(objects.sure[node]), 4),
        "label": node in session.scene.labels.by_node,
    }


def _classes(session: Session) -> list[Document] | None:
    if session.segmentation is None:
        return None
    names, counts = session.segmentation.names, session.segmentation.counts
    return [
        {"name": printable(name, 60), "count": int(count), "color": color}
        for name, count, color in zip(names, counts, class_colors(len(names)).tolist(), strict=True)
    ]


def _edits(session: Session) -> Document:
    listed = session.edits.listed
    shown = [
        {"number": number, "what": NAMES[type(edit.change)], "target": printable(str(edit.target), 60),
         "done": number <= listed.done}
        for number, edit in enumerate(listed.edits, start=1)
    ]  # fmt: skip
    return {
        "edits": shown[-MAX_LISTED:],
        "can_undo": listed.done > 0,
        "can_redo": listed.done < len(listed.edits),
        "kept": session.edits.file is not None,
    }


def _annotation(stage: Stage, annotation: Annotation) -> Document:
    text, center, outline = {"text": printable(annotation.text)}, annotation.center, annotation.outline
    if outline is not None:
        return text | _box(stage, center, outline.axes, outline.extent)
    frame = stage.session.shown.frame
    eye = stage.eye_before(center, np.full(3, POINT_SIZE / frame.scale))
    return text | {"center": rounded(frame.shown(center)), "eye": rounded(frame.shown(eye))}


# --- numbers and words ---


def _box(stage: Stage, center: Vector3, axes: Matrix3, extent: Vector3) -> Document:
    frame = stage.session.shown.frame
    return box_document(frame, center, axes, extent) | {"eye": rounded(frame.shown(stage.eye_before(center, extent)))}
