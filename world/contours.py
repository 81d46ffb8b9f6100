"""Masks -> polygons whose filling (border included, as cv2.fillPoly does it) gives the mask back, but
for its holes."""

import numpy as np
from scipy import ndimage

from drsplat.base.arrays import Mask

SMALLEST = 12  # pixels; smaller specks are left out
# clockwise on a screen with y down, beginning in the west
_AROUND = ((-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1))


def polygons(mask: Mask) -> list[list[tuple[int, int]]]:
    """The outline of each connected piece as (x, y) pixels, the largest piece first."""
    pieces, count = ndimage.label(mask, np.ones((3, 3)))
    sizes = np.bincount(pieces.ravel(), minlength=count + 1)[1:]
    order = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= SMALLEST]
    return [_outline(pieces == k + 1) for k in order]


def _outline(piece: Mask) -> list[tuple[int, int]]:
    """Moore's tracing of one 8-connected piece, without the points that lie on straight runs."""
    padded = np.pad(piece, 1)
    y, x = (int(v) for v in np.argwhere(padded)[0])
    first, heading, trail, turns = (x, y), 0, [], []
    entered: set[tuple[int, int, int]] = set()
    while (x, y, heading) not in entered:
        entered.add((x, y, heading))
        step = next(k % 8 for k in range(heading, heading + 8) if padded[y + _AROUND[k % 8][1], x + _AROUND[k % 8][0]])
        trail.append((x - 1, y - 1))
        turns.append(step)
        x, y = x + _AROUND[step][0], y + _AROUND[step][1]
        heading = (step + 5) % 8 if step % 2 else (step + 6) % 8  # from the last empty neighbour on
        if (x, y) == first and heading == 0:
            break
    corners = [point for k, point in enumerate(trail) if turns[k] != turns[k - 1]]
    return corners if len(corners) > 2 else [*corners, corners[-1]]  # a strip one pixel wide
