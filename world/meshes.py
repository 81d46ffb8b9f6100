"""Triangle meshes from curves: lathe, sweep, box, sphere, pillow, extrusion.

Metres, z up. Every maker stands its mesh on z = 0 around the z axis, except `sweep`, which follows
its path. Corners of a face are counterclockwise seen from outside. uv are metres along the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int32

from drsplat.base.arrays import Doubles, Matrix3, PlanePoints, Points, Vector3

Curve = list[tuple[float, float]]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Mesh:
    vertices: Float64[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]
    uv: Float64[np.ndarray, "v 2"]

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "Mesh":
        return replace(self, vertices=self.vertices + np.array([x, y, z]))

    def turned(self, axis: str, degrees: float) -> "Mesh":
        """About a coordinate axis through the origin, counterclockwise seen from its tip."""
        return replace(self, vertices=self.vertices @ turn(axis, degrees).T)

    def scaled(self, x: float, y: float, z: float) -> "Mesh":
        return replace(self, vertices=self.vertices * np.array([x, y, z]))

    def on_floor(self) -> "Mesh":
        return self.moved(z=-float(self.vertices[:, 2].min()))


def turn(axis: str, degrees: float) -> Matrix3:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return matrix


def joined(*meshes: Mesh) -> Mesh:
    """All of them as one; where they overlap, they go on overlapping."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate([mesh.uv for mesh in meshes]),
    )


def rounded(points: Curve, times: int = 2) -> Curve:
    """An open polyline with its corners cut (Chaikin); the ends stay."""
    line = np.array(points, float)
    for _ in range(times):
        a, b = line[:-1], line[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, line.shape[1])
        line = np.concatenate([line[:1], cut[1:-1], line[-1:]])
    return [tuple(row) for row in line.tolist()]


def lathe(profile: Curve, sides: int = 40) -> Mesh:
    """The (radius, height) profile, bottom first, turned about z; closed if it begins and ends at
    radius 0. A vessel goes up its outer wall and down its inner one."""
    radius, height = np.array(profile, float).T
    angle = np.linspace(-np.pi, np.pi, sides + 1)
    x, y = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    vertices = np.stack([x, y, np.repeat(height[:, None], sides + 1, 1)], axis=2)
    along = np.concatenate([[0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    u, v = np.meshgrid(angle * radius.max(), along)
    return _grid(vertices, np.stack([u, v], axis=2))


def solid(profile: Curve, sides: int = 40) -> Mesh:
    """A lathed profile, closed by a level floor at its first height and a level top at its last."""
    return lathe([(0, profile[0][1]), *profile, (0, profile[-1][1])], sides)


def ring(profile: Curve, sides: int = 40) -> Mesh:
    """A lathed band: the profile, counterclockwise in (radius, height), closes on itself."""
    return lathe([*profile, profile[0]], sides)


def cylinder(radius: float, height: float, edge: float = 0.0, sides: int = 40) -> Mesh:
    edge = min(edge, 0.45 * height, 0.9 * radius)
    if not edge:
        return solid([(radius, 0), (radius, height)], sides)
    arc = [(np.cos(a), np.sin(a)) for a in np.linspace(0, np.pi / 2, 4)]
    low = [(radius - edge + edge * s, edge - edge * c) for c, s in arc]
    high = [(radius - edge + edge * c, height - edge + edge * s) for c, s in arc]
    return lathe([(0, 0), *low, *high, (0, height)], sides)


def sphere(x: float, y: float | None = None, z: float | None = None, sides: int = 32) -> Mesh:
    """An ellipsoid of these radii around the origin (not standing on the floor)."""
    arc = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    unit = lathe([(abs(np.cos(a)) * (abs(np.cos(a)) > 1e-9), np.sin(a)) for a in arc], sides)
    radii = np.array([x, x if y is None else y, x if z is None else z])
    return replace(unit, vertices=unit.vertices * radii, uv=unit.uv * x)


def box(size: Vec3, edge: float = 0.0) -> Mesh:
    """A box on z = 0, its edges rounded by `edge`; uv are planar on each side."""
    half = np.array(size) / 2
    edge = min(edge, 0.98 * float(half.min()))
    parts = []
    for w in range(3):
        u, v = (w + 1) % 3, (w + 2) % 3
        for sign in (1.0, -1.0):
            a, b = np.meshgrid(_marks(half[u], edge), _marks(half[v], edge))
            p = np.empty((*a.shape, 3))
            p[..., u], p[..., v], p[..., w] = sign * a, b, sign * half[w]
            uv = np.stack([p[..., u], p[..., v]], axis=2)
            parts.append(_grid(_on_rounded_box(p, half - edge, edge), uv))
    return joined(*parts).moved(z=size[2] / 2)


def _marks(half: float, edge: float) -> Doubles:
    if not edge:
        return np.array([-half, half])
    steps = edge * np.tan(np.linspace(0, np.pi / 4, 4))  # even angles on the rounded edge
    return np.concatenate([-half + edge - steps[::-1], half - edge + steps])


def _on_rounded_box(points: Float64[np.ndarray, "*n 3"], core: Vector3, edge: float) -> Float64[np.ndarray, "*n 3"]:
    if not edge:
        return points
    inner = np.clip(points, -core, core)
    away = points - inner
    return inner + edge * away / np.linalg.norm(away, axis=-1, keepdims=True)


def pillow(length: float, width: float, thickness: float, n: int = 20) -> Mesh:
    """A stuffed rectangle with pinched corners."""
    line = np.sin(np.linspace(-np.pi / 2, np.pi / 2, n + 1))
    x, y = np.meshgrid(line, line)
    puff = ((1 - x**2) * (1 - y**2)) ** 0.38
    px = 0.5 * length * x * (0.9 + 0.1 * y**2)  # the seams bow in between the corners
    py = 0.5 * width * y * (0.9 + 0.1 * x**2)
    uv = np.stack([px, py], axis=2)
    top = _grid(np.stack([px, py, 0.5 * thickness * puff], axis=2), uv)
    low = _grid(np.stack([px, py, -0.5 * thickness * puff], axis=2), uv)
    return joined(top, replace(low, faces=low.faces[:, ::-1].copy())).on_floor()


def sweep(
    path: Sequence[Vec3] | np.ndarray,
    radii: float | Sequence[float] | Sequence[tuple[float, float]] | np.ndarray,
    sides: int = 14,
    square: float = 2.0,
    loop: bool = False,
) -> Mesh:
    """A tube along a path, flat ends closed; its section is a superellipse.

    path: n points, best in one plane. radii: one, n, or n pairs (in the plane of the path, across
    it; of a straight path, of least height first). square: 2 is a circle, 6 nearly a rectangle.
    """
    path = np.array(path, float)
    half = np.broadcast_to(np.asarray(radii, float), (len(path),)) if np.ndim(radii) < 2 else None
    half = np.array(radii, float) if half is None else np.stack([half, half], axis=1)
    side, up = _frames(path, loop)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    wave = np.round([np.cos(angle), np.sin(angle)], 12)  # a root of 1e-16 would open the seam
    c, s = np.sign(wave) * np.abs(wave) ** (2 / square)
    rings = path[:, None] + side[:, None] * (half[:, :1] * c)[..., None]
    rings = rings + up[:, None] * (half[:, 1:] * s)[..., None]
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    u, v = np.meshgrid(angle / (2 * np.pi) * 4 * half.mean(), along)
    if loop:
        rings, u, v = (np.concatenate([part, part[:1]]) for part in (rings, u, v))
    else:
        ends = np.repeat(path[[0, -1], None], sides + 1, axis=1)
        rings = np.concatenate([ends[:1], rings, ends[1:]])
        u, v = (np.concatenate([part[:1], part, part[-1:]]) for part in (u, v))
    return _grid(rings, np.stack([u, v], axis=2))


def _frames(path: Points, loop: bool) -> tuple[Points, Points]:
    tangent = np.roll(path, -1, 0) - np.roll(path, 1, 0) if loop else np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    direction = path[-1] - path[0]
    bend = np.linalg.svd(path - path.mean(0))[1]
    if bend[1] < 1e-6 * bend[0]:  # straight: the section's second axis is as upright as can be
        rough = np.array([0, 0, 1.0]) if abs(direction[2]) < 0.9 * bend[0] else np.array([0, 1.0, 0])
        normal = rough
    else:
        normal = np.linalg.svd(path - path.mean(0))[2][2]
    side = np.cross(normal, tangent)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(tangent, side)


def extrude(outline: Curve, height: float) -> Mesh:
    """A simple counterclockwise outline in the xy plane, raised from z = 0 to `height`."""
    ring = np.array(outline, float)
    n = len(ring)
    caps = _ears(ring)
    flat, top = np.zeros((n, 1)), np.full((n, 1), height)
    lower, upper = np.hstack([ring, flat]), np.hstack([ring, top])
    closed = np.vstack([ring, ring[:1]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    walls = np.stack([np.hstack([closed, np.zeros((n + 1, 1))]), np.hstack([closed, np.full((n + 1, 1), height)])])
    u, v = np.meshgrid(along, [0.0, height])
    return joined(
        Mesh(lower, caps[:, ::-1].astype(np.int32), ring.copy()),
        Mesh(upper, caps, ring.copy()),
        _grid(walls, np.stack([u, v], axis=2)),
    )


def _ears(ring: PlanePoints) -> Int32[np.ndarray, "f 3"]:
    """Triangles of a simple counterclockwise polygon, by ear clipping."""
    left = list(range(len(ring)))
    faces: list[tuple[int, ...]] = []
    while len(left) > 3:
        k = next(k for k in range(len(left)) if _is_ear(ring, left, k))
        faces.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    return np.array([*faces, tuple(left)], np.int32)


def _is_ear(ring: PlanePoints, left: list[int], k: int) -> bool:
    a, b, c = (ring[left[i % len(left)]] for i in (k - 1, k, k + 1))

    def turns(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    if turns(a, b, c) <= 1e-14:
        return False
    others = [ring[i] for i in left if not any(np.array_equal(ring[i], p) for p in (a, b, c))]
    return not any(turns(a, b, p) >= 0 and turns(b, c, p) >= 0 and turns(c, a, p) >= 0 for p in others)


def _grid(points: Float64[np.ndarray, "r c 3"], uv: Float64[np.ndarray, "r c 2"]) -> Mesh:
    """Rows of points, two triangles to a cell, without those of no area."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices = points.reshape(-1, 3)
    return Mesh(vertices, faces[areas(vertices, faces) > 1e-13].astype(np.int32), uv.reshape(-1, 2))


def areas(vertices: Float64[np.ndarray, "v 3"], faces: Int32[np.ndarray, "f 3"]) -> Float64[np.ndarray, " f"]:
    """In square metres."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def volume(mesh: Mesh) -> float:
    """In cubic metres; positive if the faces of a closed mesh look outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)
