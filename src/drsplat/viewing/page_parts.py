"""What a page has beside its answers: the scene's objects with their pictures, and its annotations."""

import base64
import io
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt16
from PIL import Image

from ..filming.looking import before
from ..query import Match
from ..scene.annotations import Annotation
from .object_list import names_of, pictures_of
from .page_times import PageTimes, boxes_of
from .playing import placed_now
from .session import Session
from .shown import Frame
from .texts import printable

POINT = 1.0  # of the browser's units: how large a point is taken to be
MOST_OBJECTS = 60  # listed: the largest
PICTURES, PICTURE_SIZE, QUALITY = 24, (112, 84), 70  # some 3 KB each


def objects_of_page(
    session: Session, up: Float64[np.ndarray, " 3"], times: PageTimes | None = None
) -> list[dict[str, Any]]:
    """Name, box, a place to see it from and, of the first, a picture; [] of a field without objects."""
    if not session.has_objects:
        return []
    scene, frame = session.scene, session.shown.frame
    matches = [placed_now(session, match) for match in scene.objects[:MOST_OBJECTS]]
    pictures = [_data_url(picture) for picture in pictures_of(session, matches[:PICTURES])]
    pictures += [""] * (len(matches) - len(pictures))
    return [
        _box(frame, match.center, match.axes, match.extent)
        | {
            "name": printable(name, 60),
            "picture": picture,
            "eye": frame.shown(before(match, scene.gaussians, scene.views, up)).tolist(),
            "boxes": boxes,
        }
        for match, name, picture, boxes in zip(
            matches, names_of(session), pictures, boxes_of(session, times, matches), strict=False
        )
    ]


def object_numbers(session: Session) -> UInt16[np.ndarray, " n"] | None:
    """Per Gaussian of the scene 0, or 1 for the first object that is listed; None where there are none."""
    if not session.has_objects:
        return None
    ids = session.scene.object_ids()
    return np.where(ids < MOST_OBJECTS, ids + 1, 0).astype(np.uint16)


def annotations_of_page(session: Session, up: Float64[np.ndarray, " 3"]) -> list[dict[str, Any]]:
    """Text and place of each, and its box where it has one."""
    frame = session.shown.frame
    return [
        {"text": printable(one.text, 200), "center": frame.shown(one.center).tolist(), "eye": _eye(session, one, up)}
        | ({} if one.outline is None else _box(frame, one.center, one.outline.axes, one.outline.extent))
        for one in session.edits.annotations
    ]


def _eye(session: Session, one: Annotation, up: Float64[np.ndarray, " 3"]) -> list[float]:
    """A place to see it from, as a match of its size is seen."""
    scene, frame = session.scene, session.shown.frame
    axes, extent = (np.eye(3), np.full(3, POINT / frame.scale)) if one.outline is None else one.outline
    place = Match(one.center, axes, extent, 1.0, np.empty(0, np.int64))
    eye: list[float] = frame.shown(before(place, scene.gaussians, scene.views, up)).tolist()
    return eye


def _box(
    frame: Frame, center: Float64[np.ndarray, " 3"], axes: Float64[np.ndarray, "3 3"],
    extent: Float64[np.ndarray, " 3"],
) -> dict[str, Any]:  # fmt: skip
    shown = frame.shown(center).tolist()
    return {"center": shown, "axes": axes.tolist(), "extent": (extent * frame.scale).tolist()}


def _data_url(pixels: np.ndarray | None) -> str:
    if pixels is None:
        return ""
    out = io.BytesIO()
    Image.fromarray(pixels).resize(PICTURE_SIZE, Image.Resampling.LANCZOS).save(out, "JPEG", quality=QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode()}"
