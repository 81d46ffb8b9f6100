"""Places of names in a picture, so that none lies over another where there is room."""

from collections.abc import Sequence

import numpy as np

from ..base.arrays import Float64

MAX_DODGING_NAMES = 200  # that make room for each other; further ones are placed as if alone
PLATE_HEIGHTS = (0, 1, 2, 3)  # between an object and its name
PLATE_WIDTHS = (0.0, -0.5, 0.5, -1.0, 1.0)  # by which a name moves aside
Box = Float64[np.ndarray, " 4"]  # left, top, right, bottom, in pixels


def plates_of(
    things: Sequence[Box], sizes: Sequence[tuple[float, float]], margin: float, picture: tuple[int, int]
) -> list[Box]:
    """Return a plate for each name, in order: above its object, else at the nearest free place above or below.

    things: boxes of the objects' visible parts. sizes: of their plates, width and height. margin: between both. Where
    no place is free it is the one that hides least.
    """
    taken = np.empty((0, 4))
    for number, (thing, size) in enumerate(zip(things, sizes, strict=True)):
        places = _places(thing, size, margin, picture)
        hidden = _shared(places, taken if number < MAX_DODGING_NAMES else taken[:0]).sum(1)
        taken = np.concatenate([taken, places[[int(np.argmin(hidden))]]])
    return list(taken)


def _places(
    thing: Box, size: tuple[float, float], margin: float, picture: tuple[int, int]
) -> Float64[np.ndarray, "c 4"]:
    """Return all candidate places, nearest first, within the picture."""
    (wide, high), (left, top, right, bottom) = size, thing.tolist()
    rows = [(float(step), top - margin - (step + 1) * high) for step in PLATE_HEIGHTS]
    rows += [(step + 0.5, bottom + margin + step * high) for step in PLATE_HEIGHTS]
    ways = sorted(((step + abs(aside), aside, y) for step, y in rows for aside in PLATE_WIDTHS), key=lambda way: way[0])
    x = np.array([(left + right - wide) / 2 + aside * wide for _, aside, _ in ways])
    y = np.array([y for *_, y in ways])
    x, y = x.clip(0, max(picture[0] - wide, 0)), y.clip(0, max(picture[1] - high, 0))
    return np.stack([x, y, x + wide, y + high], axis=1)


def _shared(places: Float64[np.ndarray, "c 4"], taken: Float64[np.ndarray, "t 4"]) -> Float64[np.ndarray, "c t"]:
    """Return the number of pixels that each place shares with each taken plate."""
    a, b = places[:, None], taken[None]
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    return np.asarray(sides.clip(0).prod(-1))
