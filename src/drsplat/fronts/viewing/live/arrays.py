"""Arrays that a browser draws, little-endian: splats, and their answers.

Rows go by falling significance, so that the first of them are a coarser picture of all, and come piece by piece.
"""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....errors import InputError
from .. import results
from ..page import as_bytes, packed
from ..session import Mode
from ..shown import rounded, shown_part
from ..tiled import TiledSession
from .stage import Stage

ARRAYS_HEADER, ROWS_HEADER = "x-drsplat-arrays", "x-drsplat-rows"
PIECE_ROWS = 1 << 17  # of an answer
MAX_OBJECTS = 65_534  # that 16 bits tell apart, with a number for none
COLOUR_MODES = (Mode.FEATURES, Mode.CLASSES)
Rows = dict[str, np.ndarray]
"""Arrays by name, each with a row for each Gaussian that is drawn."""
MAX_PARTS, MAX_ROWS = 64, 1 << 19  # of one answer


class Packed(NamedTuple):
    """layout: JSON list of name, kind, offset in bytes and count of each array. rows: of the whole scene."""

    layout: str
    data: bytes
    rows: int


def splats(stage: Stage, begin: int) -> Packed:
    """Return places, shapes, colours and opacities from a row on, as edited and at the time that is shown.

    Raises: InputError: there is no such row.
    """
    drawn, rows = stage.session.drawn, stage.order[begin : begin + PIECE_ROWS]
    part: Rows = {
        "centers": drawn.centers[rows],
        "covariances": drawn.covariances[rows].astype(np.float16),
        "rgb": as_bytes(drawn.rgb[rows]),
        "opacity": as_bytes(drawn.opacities[rows]),
    }
    return _packed(part, begin, len(stage.order))


def piece(arrays: Rows, begin: int) -> Packed:
    """Return `PIECE_ROWS` rows from a row on, or as many as there are. Raises: InputError: there is no such row."""
    part = {name: values[begin : begin + PIECE_ROWS] for name, values in arrays.items()}
    return _packed(part, begin, len(next(iter(arrays.values()))))


def paint(stage: Stage) -> Rows:
    """Return what each row answers: heat, the query that it belongs to, and its object."""
    session = stage.session
    found, count = session.results, len(session.scene.gaussians)
    arrays = {
        "heat": as_bytes(results.heat(found, count)),
        "owner": (results.owners(found, count) + 1).astype(np.uint8),
    }
    if session.has_objects:
        arrays["object"] = (np.minimum(session.object_ids, MAX_OBJECTS - 1) + 1).astype(np.uint16)
    return {name: session.of_drawn(values)[stage.order] for name, values in arrays.items()}


def colors(stage: Stage, mode: str) -> Rows:
    """Return the colours of a mode that only this side can compute. Raises: InputError: another mode."""
    if mode not in COLOUR_MODES:
        raise InputError(f"mode: expected {' or '.join(COLOUR_MODES)}, got {mode!a:.40}")
    session = stage.session
    before, session.mode = session.mode, Mode(mode)
    try:
        painted = session.drawn_colors
    finally:
        session.mode = before
    return {"rgb": as_bytes(painted[session.drawn.ids])[stage.order]}


def nothing() -> Packed:
    """Return no rows at all, where no scene is open."""
    empty = np.empty(0, np.uint8)
    part: Rows = {
        "centers": np.empty(0, np.float32), "covariances": np.empty(0, np.float16), "rgb": empty, "opacity": empty,
        "heat": empty, "owner": empty,
    }  # fmt: skip
    return _packed(part, 0, 0)


def _packed(part: Rows, begin: int, rows: int) -> Packed:
    if not 0 <= begin < max(rows, 1):
        raise InputError(f"from: expected a row below {rows:,}, got {begin:,}")
    layout, data = packed(part)
    return Packed(json.dumps(layout), data, rows)


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
    return _packed(arrays, 0, len(centers))


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
    return _packed(arrays, 0, len(rows))


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
