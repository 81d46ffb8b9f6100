"""Places of matches at the time that is shown."""

from dataclasses import replace

import numpy as np

from ...kernels.boxes import box_of
from ...query import Match
from ...scene.boxes import solid
from .session import Session


def placed_now(session: Session, match: Match) -> Match:
    """Return a match with its box where its Gaussians are now, at the session's time and after its edits."""
    now, ids = session.edits.standing, match.gaussian_ids
    if session.time is None and np.array_equal(now.means[ids], session.scene.gaussians.means[ids]):
        return match
    box = box_of(now, solid(now, ids), session.scene.up)
    return replace(match, center=box.center, axes=box.axes, extent=box.extent)
