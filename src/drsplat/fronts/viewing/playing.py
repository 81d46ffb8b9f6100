"""Places of matches at the time that is shown."""

from dataclasses import replace

import numpy as np

from ...kernels.boxes import box_of
from ...query import Match
from ...scene.boxes import solid
from .session import Session


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
