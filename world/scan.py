"""Points on the surfaces of a room that the photos see, with colours: what a scanner would bring home."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, UInt8

from .meshes import Mesh, areas
from .render import Shot
from .rooms import Room


class Points(NamedTuple):
    """World positions, RGB, and the instance id of each."""

    positions: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    ids: Int32[np.ndarray, " n"]


def from_depth(shots: list[Shot], count: int, rng: np.random.Generator) -> Points:
    """As structure from motion has them: dense where the photos look, coloured by a photo."""
    parts = [_unprojected(shot, count // len(shots), rng) for shot in shots]
    return Points(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _unprojected(shot: Shot, count: int, rng: np.random.Generator) -> Points:
    view = shot.view
    rows, columns = np.nonzero(shot.depth > 0)
    chosen = rng.choice(len(rows), min(count, len(rows)), replace=False)
    rows, columns = rows[chosen], columns[chosen]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    camera = pixels @ np.linalg.inv(view.K).T * shot.depth[rows, columns, None]
    world = camera @ view.cam_from_world[:3, :3] + view.center
    return Points(world, shot.image[rows, columns], shot.ids[rows, columns])


def of_surfaces(room: Room, shots: list[Shot], rng: np.random.Generator, spacing: float = 0.015) -> Points:
    """Evenly over all surfaces that a photo sees; thrice as far apart on floor and walls. Colours are
    the mean over the photos."""
    positions, ids = [], []
    for k, _, mesh in room.pieces():
        positions.append(on_mesh(mesh, spacing if k < len(room.objects) else 3 * spacing, rng))
        ids.append(np.full(len(positions[-1]), k, np.int32))
    return _seen(np.concatenate(positions), np.concatenate(ids), shots)


def on_mesh(mesh: Mesh, spacing: float, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """One point per spacing squared on average, uniform over the area, forty at least."""
    size = areas(mesh.vertices, mesh.faces)
    count = max(40, int(size.sum() / spacing**2))
    face = mesh.faces[rng.choice(len(size), count, p=size / size.sum())]
    root, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    a, b, c = (mesh.vertices[face[:, k]] for k in range(3))
    return (1 - root) * a + root * (1 - v) * b + root * v * c


def _seen(positions: np.ndarray, ids: np.ndarray, shots: list[Shot]) -> Points:
    total, times = np.zeros((len(positions), 3)), np.zeros(len(positions))
    for shot in shots:
        at, rows, columns = _visible(positions, ids, shot)
        total[at] += shot.image[rows, columns]
        times[at] += 1
    seen = times > 0
    colors = np.rint(total[seen] / times[seen, None]).astype(np.uint8)
    return Points(positions[seen], colors, ids[seen])


def _visible(positions: np.ndarray, ids: np.ndarray, shot: Shot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points a shot sees, and the row and column of each."""
    view = shot.view
    camera = positions @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    ahead = np.flatnonzero(camera[:, 2] > 0.05)
    pixels = camera[ahead] @ view.K.T
    columns, rows = np.floor(pixels[:, :2] / pixels[:, 2:]).astype(int).T
    inside = (columns >= 0) & (columns < view.width) & (rows >= 0) & (rows < view.height)
    ahead, rows, columns = ahead[inside], rows[inside], columns[inside]
    near = np.abs(shot.depth[rows, columns] - camera[ahead, 2]) < 0.01 + 0.01 * camera[ahead, 2]
    same = near & (shot.ids[rows, columns] == ids[ahead])
    return ahead[same], rows[same], columns[same]
