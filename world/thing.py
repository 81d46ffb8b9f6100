"""A thing: named parts of surface, standing on z = 0 and facing +x."""

from dataclasses import dataclass
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
        return np.asarray(high - low)


def build(name: str, shade: Color, material: str, *pieces: tuple[Look, Mesh], ledges: tuple[Ledge, ...] = ()) -> Thing:
    """The pieces as a thing, centred on the z axis and standing on z = 0; those of one look become
    one part."""
    grouped: dict[int, list[Mesh]] = {}
    looks = {id(look): look for look, _ in pieces}
    for look, mesh in pieces:
        grouped.setdefault(id(look), []).append(mesh)
    points = np.concatenate([mesh.vertices for _, mesh in pieces])
    low, high = points.min(0), points.max(0)
    x, y, z = (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])
    parts = [Part(joined(*meshes).moved(x, y, z), looks[key]) for key, meshes in grouped.items()]
    shifted = tuple(
        Ledge(ledge.z + z, (ledge.center[0] + x, ledge.center[1] + y), ledge.size, ledge.clearance) for ledge in ledges
    )
    return Thing(name, shade.word, material, tuple(parts), shifted)
