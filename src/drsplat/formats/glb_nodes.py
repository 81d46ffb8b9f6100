"""Nodes of a glTF, from the roots of the scene down, which place its meshes."""

from collections.abc import Iterator

import numpy as np

from ..base.arrays import Float64
from ..errors import FormatError
from ..scene.rotations import rotation_matrices
from .axes import HALF_TURN, standing_up
from .glb_layout import OURS
from .gltf import Entry, Gltf, inner, listed, whole_number
from .json_files import as_vector

TURN_ABOUT_Z = np.diag([-1.0, -1.0, 1.0])
SAME_ROTATION_TOLERANCE = 1e-6  # between the entries of a rotation as stored and as computed
Matrix = Float64[np.ndarray, "4 4"]


def placed_meshes(gltf: Gltf) -> Iterator[tuple[int, Matrix]]:
    """Yield each mesh that a node of the scene shows, and the matrix from its own axes to those of a PLY's world.

    Raises: FormatError: a node that is in two places or within itself, or whose numbers are none.
    """
    to_ply = np.eye(4)
    to_ply[:3, :3] = _turn_to_ply(gltf)
    waiting = [(number, to_ply) for number in reversed(_roots(gltf))]
    seen: set[int] = set()
    while waiting:
        number, above = waiting.pop()
        node = gltf.entry("nodes", number)
        if number in seen:
            raise FormatError(f"glTF: node {number} is in two places, or within itself: damaged")
        seen.add(number)
        here = np.eye(4) if above is to_ply and is_world(node) else above @ local_matrix(node, number)
        if not np.isfinite(here).all():
            raise FormatError(f"glTF: node {number} stands beyond all numbers: damaged")
        if "mesh" in node:
            yield whole_number(node["mesh"], "mesh", len(gltf.entries("meshes"))), here
        waiting += [(child, here) for child in reversed(_numbers(gltf, node, "children"))]


def _turn_to_ply(gltf: Gltf) -> Float64[np.ndarray, "3 3"]:
    """Return the half turn that makes y down: about x, or about z for splat-transform, which undoes what it did."""
    generator = inner(gltf.document, "asset").get("generator")
    return TURN_ABOUT_Z if isinstance(generator, str) and generator.startswith("splat-transform") else HALF_TURN


def is_world(node: Entry) -> bool:
    """Return whether drsplat wrote this node to stand a scene's world up, and nobody has turned it since."""
    said = inner(node, "extras", OURS)
    up, rotation = said.get("up"), node.get("rotation")
    if said.get("frame") != "world" or {"matrix", "translation", "scale"} & node.keys():
        return False
    try:
        direction = as_vector(up, 3, "up")
        given = _rotation(as_vector(rotation, 4, "rotation"))
    except FormatError:
        return False
    length = float(np.linalg.norm(direction))
    return 1e-6 < length < 1e6 and bool(np.abs(given - standing_up(direction)).max() < SAME_ROTATION_TOLERANCE)


def local_matrix(node: Entry, number: int) -> Matrix:
    """Return the matrix of a node, from its axes to those above it. Raises: FormatError: no numbers."""
    where = f"glTF: node {number}"
    if "matrix" in node:
        return np.asarray(as_vector(node["matrix"], 16, f"{where}: matrix").reshape(4, 4).T)
    matrix = np.eye(4)
    rotation = _rotation(as_vector(node.get("rotation", [0, 0, 0, 1]), 4, f"{where}: rotation"))
    matrix[:3, :3] = rotation * as_vector(node.get("scale", [1, 1, 1]), 3, f"{where}: scale")
    matrix[:3, 3] = as_vector(node.get("translation", [0, 0, 0]), 3, f"{where}: translation")
    return matrix


def _rotation(xyzw: Float64[np.ndarray, " 4"]) -> Float64[np.ndarray, "3 3"]:
    return np.asarray(rotation_matrices(xyzw[None, [3, 0, 1, 2]] / np.linalg.norm(xyzw))[0])


def _roots(gltf: Gltf) -> list[int]:
    scenes = gltf.entries("scenes")
    if scenes:
        return _numbers(gltf, gltf.entry("scenes", gltf.document.get("scene", 0)), "nodes")
    nodes = gltf.entries("nodes")
    below = {child for node in nodes for child in _numbers(gltf, node, "children")}
    return [number for number in range(len(nodes)) if number not in below]


def _numbers(gltf: Gltf, entry: object, name: str) -> list[int]:
    count = len(gltf.entries("nodes"))
    return [whole_number(number, name, count) for number in listed(entry, name, "glTF")]
