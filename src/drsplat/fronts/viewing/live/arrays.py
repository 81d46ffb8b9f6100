"""Arrays that a browser draws, little-endian: splats, and their answers.

Rows go by falling significance, so that the first of them are a coarser picture of all, and come piece by piece.
"""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....base.arrays import RowIds
from ....errors import InputError
from .. import results
from ..page import packed
from ..session import Mode, Session
from ..shown import as_bytes, base_colors, rounded, shown_part
from ..stage import Stage
from ..tiled import TiledSession

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
    part = drawn.centers[rows], drawn.covariances[rows], drawn.rgb[rows], drawn.opacities[rows]
    return _packed(_splats(*part), begin, len(stage.order))


def _splats(centers: np.ndarray, covariances: np.ndarray, rgb: np.ndarray, opacities: np.ndarray) -> Rows:
    return {
        "centers": centers, "covariances": covariances.astype(np.float16), "rgb": as_bytes(rgb),
        "opacity": as_bytes(opacities),
    }  # fmt: skip


def piece(arrays: Rows, begin: int) -> Packed:
    """Return `PIECE_ROWS` rows from a row on, or as many as there are. Raises: InputError: there is no such row."""
    part = {name: values[begin : begin + PIECE_ROWS] for name, values in arrays.items()}
    return _packed(part, begin, len(next(iter(arrays.values()))))


def paint(stage: Stage) -> Rows:
    """Return what each row answers: heat, the query that it belongs to, and its object."""
    return {name: stage.session.of_drawn(values)[stage.order] for name, values in _paint(stage.session).items()}


def _paint(session: Session, rows: RowIds | None = None) -> Rows:
    """Return what some rows of the scene answer, or all."""
    found, count = session.results, len(session.scene.rows)
    arrays = {
        "heat": as_bytes(results.heat(found, count, rows)),
        "owner": (results.owners(found, count, rows) + 1).astype(np.uint8),
    }
    if session.has_objects:
        arrays["object"] = (np.minimum(session.objects_at(rows), MAX_OBJECTS - 1) + 1).astype(np.uint16)
    return arrays


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
    none = np.empty(0, np.float32)
    empty = as_bytes(none)
    return _packed(_splats(none, none, none, none) | {"heat": empty, "owner": empty}, 0, 0)


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
    read = [shown_part(session.part(number), session.shown.frame) for number in parts]
    arrays = _splats(*(np.concatenate(columns) for columns in zip(*read, strict=True)))
    return _packed(arrays, 0, len(arrays["centers"]))


def tile_paint(stage: Stage, parts: Sequence[int]) -> Packed:
    """Return what the same rows answer, and the colours of classes. Raises: as `tile_splats`."""
    session = _checked(stage, parts)
    rows = np.concatenate([session.rows_of(number) for number in parts])
    arrays = _paint(session, rows)
    if session.mode is Mode.CLASSES:
        own = np.concatenate([base_colors(session.part(number)) for number in parts])
        arrays["rgb"] = as_bytes(session.painted(own, rows))
    return _packed(arrays, 0, len(rows))


def _checked(stage: Stage, parts: Sequence[int]) -> TiledSession:
    session = stage.session
    if not isinstance(session, TiledSession):
        raise InputError("parts: this scene is not in tiles")
    if not 1 <= len(parts) <= MAX_PARTS or len(set(parts)) < len(parts):
        raise InputError(f"parts: expected 1 to {MAX_PARTS} different numbers, got {len(parts)}")
    count = sum(map(session.num_rows_of, parts))
    if count > MAX_ROWS and len(parts) > 1:
        raise InputError(f"parts: {count:,} Gaussians at once, and up to {MAX_ROWS:,} are sent: ask for fewer")
    return session
