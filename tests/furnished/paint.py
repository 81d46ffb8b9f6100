"""What things are made of: parts with colours that belong to the place, not to a random state."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from .surfaces import Number, Surface, Vector

Color = tuple[Number, Number, Number]
Colors = Float64[np.ndarray, "n 3"]

WOOD, DARK_WOOD, PALE_WOOD = (0.55, 0.33, 0.17), (0.36, 0.20, 0.10), (0.70, 0.51, 0.32)


@dataclass(frozen=True, eq=False)
class Part:
    """A surface and its colours in [0, 1]. glow: it shines, so that no light or shadow falls on it."""

    surface: Surface
    colors: Colors
    glow: bool = False


Thing = list[Part]


def painted(surface: Surface, color: Color, grain: Number = 0.03, glow: bool = False) -> Part:
    """One colour, with noise that belongs to the place and not to a random state."""
    return Part(surface, np.clip(np.array(color) + grain * speckle(surface.points)[:, None], 0, 1), glow)


def patterned(surface: Surface, pattern: Callable[[Float64[np.ndarray, "n 3"]], Colors], glow: bool = False) -> Part:
    return Part(surface, np.clip(pattern(surface.points) + 0.02 * speckle(surface.points)[:, None], 0, 1), glow)


def speckle(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Noise in [-1, 1) that is a function of the place."""
    value: np.ndarray = np.sin(points @ [127.1, 311.7, 74.7]) * 43758.5453
    noise: np.ndarray = 2 * (value - np.floor(value)) - 1
    return noise


def placed(thing: Thing, at: Vector, yaw: Number = 0.0, pitch: Number = 0.0) -> Thing:
    return [replace(part, surface=part.surface.placed(at, yaw, pitch)) for part in thing]


def stripes(points: np.ndarray, axis: int, width: Number, colors: tuple[Color, ...]) -> Colors:
    index = np.floor(points[:, axis] / width).astype(int) % len(colors)
    striped: np.ndarray = np.array(colors)[index]
    return striped


def wood_grain(color: Color, axis: int = 0) -> Callable[[np.ndarray], Colors]:
    """Fine lines along `axis`."""

    def pattern(points: np.ndarray) -> Colors:
        across, along = points[:, (axis + 1) % 3] + points[:, (axis + 2) % 3], points[:, axis]
        lines = np.sin(90 * across + 3 * np.sin(2.5 * along)) * 0.5 + np.sin(37 * across) * 0.5
        grained: np.ndarray = np.array(color) * (1 + 0.10 * lines[:, None])
        return grained

    return pattern
