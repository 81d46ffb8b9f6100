"""Parts of a page beside its answers: the scene's objects with their pictures, and its annotations."""

import base64
import io
from typing import Any

import numpy as np
from PIL import Image

from ...authoring.filming.looking import before
from ...base.arrays import Float64, UInt16
from ...query import Match
from ...scene.annotations import Annotation
from .object_list import in_order, names_of, pictures_of
from .page_times import PageTimes, boxes_of
from .places import box_document, size_text
from .playing import placed_now
from .session import Session
from .texts import printable

POINT_SIZE = 1.0  # of the browser's units
MAX_OBJECTS_LISTED = 60  # the largest that photos agree on; and as many of the others, behind "more"
MAX_PICTURES, PICTURE_SIZE_PIXELS, JPEG_QUALITY = 24, (112, 84), 70  # some 3 KB each


def objects_of_page(
    session: Session, up: Float64[np.ndarray, " 3"], times: PageTimes | None = None
) -> list[dict[str, Any]]:
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


def object_numbers(session: Session) -> UInt16[np.ndarray, " n"] | None:
    """Return per Gaussian of the scene 0, or 1 for the first object that is listed; None where there are none."""
    if not session.has_objects:
        return None
    numbers = listed_numbers(session)
    place_of = np.zeros(len(session.scene.agreed) + 1, np.uint16)  # the last is of -1: no object
    place_of[numbers] = np.arange(1, len(numbers) + 1)
    return np.asarray(place_of[session.scene.object_ids()])


def annotations_of_page(session: Session, up: Float64[np.ndarray, " 3"]) -> list[dict[str, Any]]:
    """Return text and place of each, and its box where it has one."""
    frame = session.shown.frame
    return [
        {"text": printable(one.text, 200), "center": frame.shown(one.center).tolist(), "eye": _eye(session, one, up)}
        | ({} if one.outline is None else box_document(frame, one.center, one.outline.axes, one.outline.extent))
        for one in session.edits.annotations
    ]


def _eye(session: Session, one: Annotation, up: Float64[np.ndarray, " 3"]) -> list[float]:
    """Return a place to see an annotation from, as a match of its size is seen."""
    scene, frame = session.scene, session.shown.frame
    axes, extent = (np.eye(3), np.full(3, POINT_SIZE / frame.scale)) if one.outline is None else one.outline
    place = Match(one.center, axes, extent, 1.0, np.empty(0, np.int64))
    eye: list[float] = frame.shown(before(place, scene.gaussians, scene.views, up)).tolist()
    return eye


def _data_url(pixels: np.ndarray | None) -> str:
    if pixels is None:
        return ""
    out = io.BytesIO()
    Image.fromarray(pixels).resize(PICTURE_SIZE_PIXELS, Image.Resampling.LANCZOS).save(
        out, "JPEG", quality=JPEG_QUALITY
    )
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
