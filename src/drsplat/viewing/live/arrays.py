"""What a browser draws, as little-endian arrays: splats, and what they answer.

Rows go by falling significance, so that the first of them are a coarser picture of all.
"""

import json
from typing import NamedTuple

import numpy as np

from ...arrays import Shaped, UInt8
from ...errors import InputError
from .. import results
from ..page import packed
from ..session import Mode
from .stage import Stage

HEADER = "x-drsplat-arrays"
MOST_NUMBER = 65_534  # of matches and objects that 16 bits tell apart, with one for none
COLOURED = (Mode.FEATURES, Mode.CLASSES)


class Packed(NamedTuple):
    """layout: JSON list of name, kind, offset in bytes and count of each array."""

    layout: str
    data: bytes


def splats(stage: Stage) -> Packed:
    """Return places, shapes, colours and opacities, as edited and at the time that is shown."""
    drawn, order = stage.session.drawn, stage.order
    return _packed(
        centers=drawn.centers[order],
        covariances=drawn.covariances[order].astype(np.float16),
        rgb=_bytes(drawn.rgb)[order],
        opacity=_bytes(drawn.opacities)[order],
    )


def paint(stage: Stage) -> Packed:
    """Return what each row answers: heat, the query and the match that it belongs to, and its object."""
    session = stage.session
    found, count = session.results, len(session.scene.gaussians)
    arrays = {
        "heat": _bytes(results.heat(found, count)),
        "owner": (results.owners(found, count) + 1).astype(np.uint8),
        "match": _numbered(results.match_ids(found, count)),
    }
    if session.has_objects:
        arrays["object"] = _numbered(session.object_ids)
    return _packed(**{name: _drawn(stage, values) for name, values in arrays.items()})


def colors(stage: Stage, mode: str) -> Packed:
    """Return the colours of a mode that only this side can compute. Raises: InputError: another mode."""
    if mode not in COLOURED:
        raise InputError(f"mode: expected {' or '.join(COLOURED)}, got {mode!a:.40}")
    session = stage.session
    before, session.mode = session.mode, Mode(mode)
    try:
        painted = session.drawn_colors
    finally:
        session.mode = before
    return _packed(rgb=_bytes(painted[session.drawn.ids])[stage.order])


def nothing() -> Packed:
    """Return no rows at all, where no scene is open."""
    empty = np.empty(0, np.uint8)
    return _packed(
        centers=np.empty(0, np.float32), covariances=np.empty(0, np.float16), rgb=empty, opacity=empty, heat=empty,
        owner=empty, match=np.empty(0, np.uint16),
    )  # fmt: skip


def _drawn(stage: Stage, values: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " m"]:
    """Return values of the scene's rows for those that are drawn; 0 for what edits added."""
    session = stage.session
    added = np.zeros(len(session.edits.opacities) - len(values), values.dtype)
    return np.asarray(np.concatenate([values, added])[session.drawn.ids][stage.order])


def _numbered(ids: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " n"]:
    return (np.minimum(ids, MOST_NUMBER - 1) + 1).astype(np.uint16)


def _bytes(values: Shaped[np.ndarray, "*any"]) -> UInt8[np.ndarray, "*any"]:
    return np.asarray(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def _packed(**arrays: np.ndarray) -> Packed:
    layout, data = packed(arrays)
    return Packed(json.dumps(layout), data)
