"""A scene in tiles for a browser: which parts there are, and those that it asks for."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....errors import InputError
from ..places import rounded
from ..session import Mode
from ..shown import shown_part
from ..tiled import TiledSession
from .arrays import COLOUR_MODES, MAX_OBJECTS, Packed, Rows, as_bytes, packed_rows
from .stage import Stage

MAX_PARTS, MAX_ROWS = 64, 1 << 19  # of one answer


def tiles_document(stage: Stage) -> dict[str, Any] | None:
    """Return the boxes of all tiles, counts of their parts, and how many Gaussians a browser should hold."""
    session = stage.session
    if not isinstance(session, TiledSession):
        return None
    frame, origin = session.shown.frame, session.tiles.origin
    return {
        "budget": session.budget,
        "tiles": [
            {"coarse": session.num_coarse(tile), "rows": tile.num_rows, "low": rounded(frame.shown(tile.low + origin)),
             "high": rounded(frame.shown(tile.high + origin))}
            for tile in session.tiles.tiles
        ],
    }  # fmt: skip


def tile_splats(stage: Stage, parts: Sequence[int]) -> Packed:
    """Return places, shapes, colours and opacities of some parts, one after the other.

    Raises: InputError: no tiles, no such part, or too many. FormatError: a tile is damaged or missing.
    """
    session = _checked(stage, parts)
    read = [shown_part(session.part(number)[0], session.shown.frame) for number in parts]
    centers, covariances, rgb, opacities = (np.concatenate(columns) for columns in zip(*read, strict=True))
    arrays: Rows = {
        "centers": centers, "covariances": covariances.astype(np.float16), "rgb": as_bytes(rgb),
        "opacity": as_bytes(opacities),
    }  # fmt: skip
    return packed_rows(arrays, len(centers))


def tile_paint(stage: Stage, parts: Sequence[int]) -> Packed:
    """Return what the same rows answer, and their colours where only this side knows them. Raises: as `tile_splats`."""
    session = _checked(stage, parts)
    rows = np.concatenate([session.rows_of(number) for number in parts])
    arrays: Rows = {"heat": as_bytes(session.heat_at(rows)), "owner": (session.owners_at(rows) + 1).astype(np.uint8)}
    if session.has_objects:
        arrays["object"] = (np.minimum(session.objects_at(rows), MAX_OBJECTS - 1) + 1).astype(np.uint16)
    if session.mode in COLOUR_MODES and session.mode is Mode.CLASSES:
        own = np.concatenate([shown_part(session.part(number)[0], session.shown.frame)[2] for number in parts])
        arrays["rgb"] = as_bytes(session.colors_at(own, rows))
    return packed_rows(arrays, len(rows))


def _checked(stage: Stage, parts: Sequence[int]) -> TiledSession:
    session = stage.session
    if not isinstance(session, TiledSession):
        raise InputError("parts: this scene is not in tiles")
    if not 1 <= len(parts) <= MAX_PARTS or len(set(parts)) < len(parts):
        raise InputError(f"parts: expected 1 to {MAX_PARTS} different numbers, got {len(parts)}")
    counts = [
        session.num_coarse(tile) if number % 2 == 0 else tile.num_rows - session.num_coarse(tile)
        for number in parts
        for tile in [session.tile_of(number)]
    ]
    if sum(counts) > MAX_ROWS and len(parts) > 1:
        raise InputError(f"parts: {sum(counts):,} Gaussians at once, and up to {MAX_ROWS:,} are sent: ask for fewer")
    return session
