"""Nodes of the forest as people meet them: what is chosen at a place, the next smaller and larger, and a name."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Float, Integer
from ..field.objects import GROUP, THING, Objects
from ..terminal import counted
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
        """The next node that this one is in, None for none."""
        return Chosen(self.path, self.at + 1) if self.at + 1 < len(self.path) else None

    def smaller(self, objects: Objects) -> "Chosen | None":
        """The next node on the way back to the place; where that ends, the heaviest part. None for none."""
        if self.at:
            return Chosen(self.path, self.at - 1)
        parts = objects.below(self.node)
        return Chosen((max(parts, key=lambda part: objects.masses[part]), *self.path), 0) if parts else None


def chosen_at(scene: Scene, gaussian_ids: Integer[np.ndarray, " h"], weights: Float[np.ndarray, " h"]) -> Chosen | None:
    """The object that most is seen of where some Gaussians with features are met; None where that is in none.

    weights: of each in what is seen there. Raises: InputError: the field has no objects.
    """
    objects = objects_of(scene.field)
    path = objects.path(most_seen(objects, scene.field.rows_of(gaussian_ids), weights))
    things = [at for at, node in enumerate(path) if objects.levels[node] == THING]
    return Chosen(tuple(path), things[0]) if things else None


def name_of(scene: Scene, node: int, words: Sequence[str] = ()) -> str:
    """What people call a node: its label, else the word that the encoder is sure of, else "object 7".

    words: to choose from; where there are none, those of an encoder that knows a list. Raises: InputError: no such
    node, or no objects.
    """
    label = scene.labels.by_node.get(node)
    word = scene.object_names([node], words)[0] if label is None else label.name
    return word or numbered(objects_of(scene.field), node)


def numbered(objects: Objects, node: int) -> str:
    """A node by numbers: "object 7", "part of object 7", "group of 3 objects"; "part" where that is of no object."""
    number, level = int(objects.number_of[node]), int(objects.levels[node])
    if level == GROUP:
        return f"group of {counted(len(things_in(objects, node)), 'object')}"
    if level == THING:
        return f"object {number}"
    return f"part of object {number}" if number >= 0 else "part"


def things_in(objects: Objects, node: int) -> list[int]:
    """Numbers of the objects in a node, ascending. Raises: InputError: no such node."""
    numbers: Any = np.unique(objects.thing_of()[objects.rows(node)])
    return [number for number in numbers.tolist() if number >= 0]
