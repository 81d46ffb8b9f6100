"""State of a scene for a browser, as JSON: a header for as long as it is open, and a state after each act.

Places are in the browser's frame, texts are safe to show, and sizes in texts are in scene units.
"""

import numpy as np

from ....authoring.editing.edits import NAMES
from ....authoring.filming.writing import ffmpeg
from ....base.contents import Document
from ....drawing.heat import class_colors
from ....query.documents import support_document
from ....query.nodes import numbered
from ....query.objects import objects_of
from ....scene.views import View
from .. import painting
from ..bare import NO_FIELD
from ..client import printable
from ..naming import This, best_photo
from ..page import playing_seconds
from ..results import Result
from ..session import Session
from ..shown import DECIMALS, place_text, rounded
from ..stage import Stage
from .arrays import tiles_document
from .cameras import MAX_TEXT_CHARACTERS

MAX_PHOTOS, MAX_OBJECTS, MAX_MATCHES, MAX_LISTED = 200, 500, 100, 100
MAX_SENTENCE_CHARACTERS = 600
FILM_FORMATS = (".mp4", ".webm", ".webp", ".gif")


def film_formats() -> tuple[str, ...]:
    """Return the suffixes of films that can be written here; MP4 and WebM need the program ffmpeg."""
    return FILM_FORMATS if ffmpeg() else FILM_FORMATS[2:]


# --- for as long as the scene is open ---


def header_of(stage: Stage) -> Document:
    session, scene = stage.session, stage.session.scene
    # the words that are offered while somebody types: suggestions, then names of objects, each once
    names = [name for number in stage.listed if (name := stage.names[number].rpartition(" · ")[0])]
    note = "" if session.is_askable else f" {NO_FIELD}"
    counts = f"{len(scene.rows):,} Gaussians, {len(scene.field):,} with a feature."
    numbers, views, motion = stage.listed[:MAX_OBJECTS], scene.views, scene.motion
    return stage.look_document() | {
        "title": printable(scene.name, 60),
        "about": f"{counts} {session.shown.summary}".strip() + note,
        "scale": session.shown.frame.scale,
        "words": list(dict.fromkeys(printable(word, 60) for word in (*stage.words, *names)))[:MAX_LISTED],
        "modes": [mode.value for mode in session.modes],
        "objects": stage.object_documents(numbers, [stage.placed(scene.objects[number]) for number in numbers]),
        "photos": [_photo(stage, view) for view in views[:: -(-len(views) // MAX_PHOTOS) or 1]],
        "times": None if motion is None else {
            "first": motion.span[0], "last": motion.span[1], "count": len(motion.times),
            "seconds": playing_seconds(len(motion.times)),
        },
        "tiles": tiles_document(stage),
    }  # fmt: skip


def _photo(stage: Stage, view: View) -> Document:
    eye = stage.session.shown.frame.shown(view.center)
    return {
        "name": view.name,
        "eye": rounded(eye),
        "target": rounded(eye + view.cam_from_world[2, :3]),
        "up": rounded(-view.cam_from_world[1, :3]),
        "fov": float(np.degrees(2 * np.arctan(view.height / (2 * view.K[1, 1])))),
        "width": view.width,
        "height": view.height,
    }


# --- after each act ---


def state_of(stage: Stage) -> Document:
    session, listed = stage.session, stage.session.edits.listed
    shown = [
        {"number": number, "what": NAMES[type(edit.change)], "target": printable(str(edit.target), 60),
         "done": number <= listed.done}
        for number, edit in enumerate(listed.edits, start=1)
    ]  # fmt: skip
    return {
        "mode": session.mode.value,
        "asked": [printable(text, MAX_TEXT_CHARACTERS) for text in session.asked],
        "present": session.present,
        "selection": len(session.selection),
        "results": [_result(stage, number, result) for number, result in enumerate(session.results)],
        "clicked": None if session.clicked is None else _clicked(stage, session.clicked),
        "chosen": _chosen(session),
        "classes": _classes(session),
        "annotations": [stage.annotation_document(one) for one in session.edits.annotations[:MAX_LISTED]],
        "time": None if session.time is None else {"at": session.time, "during": session.during},
        "edits": shown[-MAX_LISTED:],
        "can_undo": listed.done > 0,
        "can_redo": listed.done < len(listed.edits),
        "kept": session.edits.file is not None,
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
        "matches": [
            stage.match_document(stage.placed(match), match.label or result.label)
            for match in result.matches[:MAX_MATCHES]
        ],
        "num_matches": len(result.matches),
    }


def _clicked(stage: Stage, this: This) -> Document:
    return {
        "name": printable(this.name, 60),
        "words": [{"text": printable(word.text, 60), "score": round(word.score, 4)} for word in this.words],
        "place": place_text(this.point),
        "center": stage.at(this.point),
        "support": support_document(this.evidence, DECIMALS),
        "photo": best_photo(stage.session.scene, this) is not None,
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
