"""How long a metre is, told by people: a factor, or a distance between two places that they see in photos."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from ..errors import InputError
from .program import ask_colmap

NEAR_SHARE = 0.05  # of the photo's diagonal: points further from the pixel say nothing about it
NEAREST = 12  # points whose surface is the place's
FEWEST_OF_A_PLANE = 5
GAP_SHARE = 0.05  # of the depth: what lies further behind is another surface
FEWEST_IN_FRONT = 2


class Place(NamedTuple):
    """A pixel (x right, y down, from the upper left corner) of an upright photo in its full size."""

    photo: str
    x: float
    y: float


@dataclass(frozen=True)
class KnownDistance:
    """Two places and the metres between them.

    Raises: InputError: a distance that is not above 0.
    """

    one: Place
    other: Place
    metres: float

    def __post_init__(self) -> None:
        if not 0 < self.metres < np.inf:
            raise InputError(f"known_distance: expected metres above 0, got {self.metres:g}")


def units_between(known: KnownDistance, model: Path, log: Path, names: dict[str, str]) -> float:
    """Return the distance of two places in the units of a model.

    names: in the model, by the names of photos that people use.

    Raises: InputError: a photo without a pose, a pixel that is not on it or near no point, or a distance of 0.
    """
    one, other = (_position(place, model, log, names) for place in (known.one, known.other))
    units = float(np.linalg.norm(one - other))
    if not units > 0:
        raise InputError("known_distance: both places are one: name two that are apart")
    return units


def _position(place: Place, model: Path, log: Path, names: dict[str, str]) -> Float64[np.ndarray, " 3"]:
    """Return the world position of what a pixel shows: on its ray, as far away as the points around it."""
    if place.photo not in names:
        raise InputError(f"known_distance: the photo '{place.photo}' has no pose: name one that has")
    seen = ask_colmap("look", log, model=str(model), name=names[place.photo], pixel=[place.x, place.y])
    width, height = seen["size"]
    if not (0 <= place.x <= width and 0 <= place.y <= height):
        raise InputError(
            f"known_distance: ({place.x:g}, {place.y:g}) is not on {place.photo}, which is {width}x{height} upright"
        )
    pixels = np.array(seen["pixels"], np.float64).reshape(-1, 2)
    away = np.linalg.norm(pixels - (place.x, place.y), axis=1)
    near = np.argsort(away, kind="stable")[:NEAREST]
    near = near[away[near] <= NEAR_SHARE * np.hypot(width, height)]
    if not len(near):
        raise InputError(
            f"known_distance: no point of the capture is near ({place.x:g}, {place.y:g}) of {place.photo}: choose a "
            "place with texture"
        )
    depth = _depth(pixels[near] - (place.x, place.y), np.array(seen["depths"])[near])
    return np.array(seen["center"]) + depth * np.array(seen["ray"])


def _depth(offsets: Float64[np.ndarray, "n 2"], depths: Float64[np.ndarray, " n"]) -> float:
    """Return the depth at a pixel of the surface that points around it lie on, in front of others.

    On a plane the inverse of the depth is linear in the pixel; no further than the points are it is not continued.
    """
    front = _front(depths)
    inverse, offsets = 1 / depths[front], offsets[front]
    if len(inverse) < FEWEST_OF_A_PLANE:
        return float(1 / np.median(inverse))
    terms = np.column_stack([np.ones(len(offsets)), offsets])
    at_pixel = float(np.linalg.lstsq(terms, inverse, rcond=None)[0][0])
    return 1 / float(np.clip(at_pixel, inverse.min(), inverse.max()))


def _front(depths: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return which depths are of the first surface: people point at things, not at the wall behind."""
    ascending = np.sort(depths)
    ends = np.flatnonzero(np.diff(ascending) > GAP_SHARE * ascending[:-1]) + 1
    end = next((int(end) for end in ends if end >= FEWEST_IN_FRONT), len(depths))
    return np.asarray(depths <= ascending[end - 1])
