"""Boxes and matches as documents in the browser's frame, for a page and for a running viewer."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...base.arrays import Matrix3, Shaped, Vector
from ...query import Match, documents
from .shown import Frame
from .texts import printable

MAX_NAME_CHARACTERS = 60
DECIMALS = 5  # a browser's unit is a twentieth of the scene


def box_document(
    frame: Frame, center: Vector, axes: Matrix3,
    extent: Vector,
) -> dict[str, Any]:  # fmt: skip
    """Return an oriented box of the world in the browser's frame."""
    return documents.box_document(frame.shown(center), axes, extent * frame.scale, DECIMALS)


def match_document(frame: Frame, match: Match, eye: Vector, name: str = "") -> dict[str, Any]:
    """Return a match with its box, a place to see it from, and its numbers in scene units. eye: in the world."""
    shown = replace(match, center=frame.shown(match.center), extent=match.extent * frame.scale)
    document = documents.match_document(shown, DECIMALS)
    del document["support"]  # many masks, which the client does not list
    return document | {
        "eye": rounded(frame.shown(eye)),
        "size": size_text(match.extent),
        "place": place_text(match.center),
        "name": printable(name, MAX_NAME_CHARACTERS),
    }


def rounded(values: Shaped[np.ndarray, "*any"]) -> list[Any]:
    return documents.rounded(values, DECIMALS)


def size_text(extent: Vector) -> str:
    """Return the lengths of a box in scene units, such as "0.12 x 0.08 x 0.09"."""
    return " x ".join(f"{x:.3g}" for x in extent)


def place_text(point: Vector) -> str:
    """Return a place in the world, such as "0.30, 0.14, 0.82"."""
    return ", ".join(f"{round(float(x), 2) + 0.0:.2f}" for x in point)
