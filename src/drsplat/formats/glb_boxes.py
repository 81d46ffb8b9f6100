"""Named nodes of a GLB at the boxes of matches and annotations."""

from typing import Any, NamedTuple

import numpy as np

from ..base.arrays import Float64
from ..scene.annotations import Annotation
from ..scene.labelled import LabelledScene, Thing
from .glb_layout import rotation_xyzw


class NamedNodes(NamedTuple):
    """Nodes of boxes. roots: numbers of those that hang at the world's node."""

    nodes: list[dict[str, Any]]
    roots: list[int]


def named_nodes(scene: LabelledScene, first: int) -> NamedNodes:
    """Return a node "matches" and a node "annotations", where there are some, with a child for each.

    A child is a unit cube about zero that its rotation, scale and translation make the box; a point has a translation
    alone. first: number of the first node.
    """
    kinds = {
        "matches": [_match(match, scene.query) for match in scene.matches],
        "annotations": [_annotation(one) for one in scene.annotations],
    }
    nodes: list[dict[str, Any]] = []
    roots: list[int] = []
    for name, children in kinds.items():
        if children:
            number = first + len(nodes)
            roots.append(number)
            nodes += [{"name": name, "children": list(range(number + 1, number + 1 + len(children)))}, *children]
    return NamedNodes(nodes, roots)


def _match(match: Thing, query: str) -> dict[str, Any]:
    said: dict[str, Any] = {"kind": "match", "score": match.score} | ({"query": query} if query else {})
    return {"name": match.name, **_box(match.center, match.axes, match.extent), "extras": said}


def _annotation(one: Annotation) -> dict[str, Any]:
    if one.outline is None:
        box: dict[str, Any] = {"translation": one.center.tolist()}
    else:
        box = _box(one.center, one.outline.axes, one.outline.extent)
    return {"name": one.text, **box, "extras": {"kind": "annotation"}}


def _box(
    center: Float64[np.ndarray, " 3"], axes: Float64[np.ndarray, "3 3"], extent: Float64[np.ndarray, " 3"]
) -> dict[str, Any]:
    """Return what makes the cube of side 1 about zero a box; columns of the rotation are the box's directions."""
    columns = axes.T * [1.0, 1.0, np.sign(np.linalg.det(axes))]  # people may write a left-handed box, which is the same
    return {"translation": center.tolist(), "rotation": rotation_xyzw(columns), "scale": extent.tolist()}
