"""Objects and groups of a field as named boxes."""

from collections.abc import Sequence

import numpy as np

from ...base.arrays import Float32
from ...field.forest import GROUP, Objects
from ...query import Match, Scene
from ...query.objects import object_of, objects_of
from ...scene.labelled import Thing


def things_of(scene: Scene, embeddings: bool = False) -> list[Thing]:
    """Return the objects of a scene by number, as `drsplat objects` lists them; none where nobody has looked.

    Their names are the labels that people gave, else the words that the encoder is sure of, else "object 7".
    """
    if scene.field.objects is None:
        return []
    objects = objects_of(scene.field)
    place = {node: number for number, node in enumerate(_group_nodes(objects))}
    return [
        Thing(
            match.label or name or f"object {number}",
            match.score,
            match.center,
            match.axes,
            match.extent,
            place.get(int(objects.parents[node]), -1),
            _embedding(objects, node) if embeddings else None,
            number,
        )
        for number, (node, match, name) in enumerate(
            zip(objects.things.tolist(), scene.objects, scene.object_names(), strict=True)
        )
    ]


def groups_of(scene: Scene) -> tuple[Thing, ...]:
    """Return the groups of a scene's objects, which are numbered in the order of their nodes."""
    if scene.field.objects is None:
        return ()
    objects, labels = objects_of(scene.field), scene.labels.by_node
    nodes = _group_nodes(objects)
    place = {node: number for number, node in enumerate(nodes)}
    return tuple(
        Thing(
            labels[node].name if node in labels else f"group {number}",
            float(objects.sure[node]),
            objects.centers[node],
            objects.axes[node],
            objects.extents[node],
            place.get(int(objects.parents[node]), -1),
        )
        for number, node in enumerate(nodes)
    )


def match_thing(scene: Scene, number: int, match: Match) -> Thing:
    """Return a match as a named box: by its label, else by its number and that of its object."""
    owner = object_of(scene.field, match)
    name = f"match {number}" if owner is None else f"match {number}, object {owner}"
    return Thing(match.label or name, match.score, match.center, match.axes, match.extent)


def _group_nodes(objects: Objects) -> Sequence[int]:
    nodes: list[int] = np.flatnonzero(objects.levels == GROUP).tolist()
    return nodes


def _embedding(objects: Objects, node: int) -> Float32[np.ndarray, " d"] | None:
    """Return the descriptor of most of an object's masks, None where it has none."""
    found = objects.descriptors_of(node)
    return found[0] if len(found) else None
