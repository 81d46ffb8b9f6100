"""Nodes of the forest as people meet them: what is chosen at a place, the next smaller and larger, and a name."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.arrays import Float, WholeNumbers
from ..base.terminal import counted
from ..field.forest import GROUP, THING, Objects
from .objects import most_seen, objects_of
from .scene import Scene


@dataclass(frozen=True)
class Chosen:
    """A node, and the way on which people came to it. path: nodes that lie in each other, smallest first."""

    path: tuple[int, ...]
    at: int

    @property
    def node(self) -> int:
        return self.path[self.at]

    def larger(self) -> "Chosen | None":
        """Return the next node that contains this one, None at the top."""
        return Chosen(self.path, self.at + 1) if self.at + 1 < len(self.path) else None

    def smaller(self, objects: Objects) -> "Chosen | None":
        """Return the next node on the way back to the place, then the heaviest part; None at the bottom."""
        if self.at:
            return Chosen(self.path, self.at - 1)
        parts = objects.below(self.node)
        return Chosen((max(parts, key=lambda part: objects.masses[part]), *self.path), 0) if parts else None


def chosen_at(scene: Scene, gaussian_ids: WholeNumbers, weights: Float[np.ndarray, " n"]) -> Chosen | None:
    """Return the object that is seen most where some Gaussians are met, None where that belongs to no object.

    weights: the blending weight of each Gaussian there. Raises: InputError: the field has no objects.
    """
    objects = objects_of(scene.field)
    path = objects.path(most_seen(objects, scene.field.rows_of(gaussian_ids), weights))
    things = [at for at, node in enumerate(path) if objects.levels[node] == THING]
    return Chosen(tuple(path), things[0]) if things else None


def name_of(scene: Scene, node: int, words: Sequence[str] = ()) -> str:
    """Return what people call a node: its label, else the word that the encoder is sure of, else "object 7".

    words: to choose from; where there are none, those of an encoder that knows a list. Raises: InputError: no such
    node, or no objects.
    """
    label = scene.labels.by_node.get(node)
    word = scene.object_names([node], words)[0] if label is None else label.name
    return word or numbered(objects_of(scene.field), node)


def numbered(objects: Objects, node: int) -> str:
    """Name a node by its number: "object 7", "part of object 7", "group of 3 objects", or "part" outside any object."""
    number, level = int(objects.number_of[node]), int(objects.levels[node])
    if level == GROUP:
        return f"group of {counted(len(things_in(objects, node)), 'object')}"
    if level == THING:
        return f"object {number}"
    return f"part of object {number}" if number >= 0 else "part"


def things_in(objects: Objects, node: int) -> list[int]:
    """Return the numbers of the objects in a node, ascending. Raises: InputError: no such node."""
    numbers: Any = np.unique(objects.thing_of()[objects.rows(node)])
    return [number for number in numbers.tolist() if number >= 0]
