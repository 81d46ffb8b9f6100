"""A thing: named parts of surface, standing on z = 0 and facing +x."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drsplat.base.arrays import Vector3

from .looks import Color, Look
from .meshes import Mesh, joined


@dataclass(frozen=True, eq=False)
class Part:
    mesh: Mesh
    look: Look


@dataclass(frozen=True)
class Ledge:
    """A rectangle of a thing where others can stand, in the thing's own frame.

    clearance: the height that is free above it, in metres.
    """

    z: float
    center: tuple[float, float]
    size: tuple[float, float]
    clearance: float = 10.0


@dataclass(frozen=True, eq=False)
class Thing:
    """name, color, material: for captions, a word each but for names like "toy duck"."""

    name: str
    color: str
    material: str
    parts: tuple[Part, ...]
    ledges: tuple[Ledge, ...] = ()

    @cached_property
    def bounds(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner, in metres."""
        points = np.concatenate([part.mesh.vertices for part in self.parts])
        return points.min(0), points.max(0)

    @property
    def size(self) -> Vector3:
        low, high = self.bounds
        return high - low


def build(
    name: str,
    shade: Color,
    material: str,
    *pieces: tuple[Look, *tuple[Mesh, ...]],
    turns: Sequence[tuple[str, float]] = (),
    scale: float = 1.0,
    ledges: Sequence[Ledge] = (),
) -> Thing:
    """The pieces as a thing: turned, scaled, centred on the z axis and standing on z = 0.

    pieces: a look and its meshes; those of one look become one part. turns: (axis, degrees), one after another.
    """
    grouped: dict[Look, list[Mesh]] = {}
    for look, *meshes in pieces:
        mesh = joined(*meshes)
        for axis, degrees in turns:
            mesh = mesh.turned(axis, degrees)
        grouped.setdefault(look, []).append(mesh.scaled(scale, scale, scale))
    points = np.concatenate([mesh.vertices for meshes in grouped.values() for mesh in meshes])
    low, high = points.min(0), points.max(0)
    x, y, z = (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])
    parts = tuple(Part(joined(*meshes).moved(x, y, z), look) for look, meshes in grouped.items())
    shifted = tuple(
        replace(ledge, z=ledge.z + z, center=(ledge.center[0] + x, ledge.center[1] + y)) for ledge in ledges
    )
    return Thing(name, shade.word, material, parts, shifted)
