"""The objects of a scene as people see them listed: in which order, by which names, with which pictures, and where."""

from dataclasses import replace

import numpy as np

from ...drawing.pictures import OtherPixels
from ...kernels.boxes import box_of
from ...query import Match
from ...query.sheets import object_picture, object_views
from ...scene.boxes import solid
from .session import Session

PICTURE_SIZE_PIXELS = (200, 150)


def pictures_of(session: Session, matches: list[Match]) -> list[OtherPixels | None]:
    """Return each cut out of the photo, or the rendering, that shows it best; none of a scene without views."""
    if not session.scene.views:
        return [None] * len(matches)
    views = object_views(session.scene, matches)
    return [
        object_picture(session.scene, match, view, PICTURE_SIZE_PIXELS)
        for match, view in zip(matches, views, strict=True)
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
