"""Arrays that a browser draws, little-endian: splats, and their answers.

Rows go by falling significance, so that the first of them are a coarser picture of all, and come piece by piece.
"""

import json
from typing import NamedTuple

import numpy as np

from ....base.arrays import Shaped, UInt8
from ....errors import InputError
from .. import results
from ..page import packed
from ..session import Mode
from .stage import Stage

ARRAYS_HEADER, ROWS_HEADER = "x-drsplat-arrays", "x-drsplat-rows"
PIECE_ROWS = 1 << 17  # of an answer
MAX_OBJECTS = 65_534  # that 16 bits tell apart, with a number for none
COLOUR_MODES = (Mode.FEATURES, Mode.CLASSES)


class Packed(NamedTuple):
    """layout: JSON list of name, kind, offset in bytes and count of each array. rows: of the whole scene."""

    layout: str
    data: bytes
    rows: int


Rows = dict[str, np.ndarray]
"""Arrays by name, each with a row for each Gaussian that is drawn."""


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
        arrays["object"] = _numbered(session.object_ids)
    return {name: _drawn(stage, values) for name, values in arrays.items()}


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


def _drawn(stage: Stage, values: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " m"]:
    """Return values of the scene's rows for those that are drawn; 0 for what edits added."""
    session = stage.session
    added = np.zeros(len(session.edits.opacities) - len(values), values.dtype)
    return np.asarray(np.concatenate([values, added])[session.drawn.ids][stage.order])


def _numbered(ids: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " n"]:
    return (np.minimum(ids, MAX_OBJECTS - 1) + 1).astype(np.uint16)


def as_bytes(values: Shaped[np.ndarray, "*any"]) -> UInt8[np.ndarray, "*any"]:
    """Return numbers in [0, 1] as bytes."""
    return np.asarray(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def packed_rows(part: Rows, rows: int) -> Packed:
    """Return all rows of an answer as bytes."""
    return _packed(part, 0, rows)


def _packed(part: Rows, begin: int, rows: int) -> Packed:
    if not 0 <= begin < max(rows, 1):
        raise InputError(f"from: expected a row below {rows:,}, got {begin:,}")
    layout, data = packed(part)
    return Packed(json.dumps(layout), data, rows)
