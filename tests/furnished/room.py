"""The room: what stands where, as one set of Gaussians with a label for each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float64, Int32

from drsplat.kernels import splat_arrays, view_weights
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.views import View

from . import belongings, furniture
from .light import color_to_sh, lit
from .paint import Part, Thing, painted, patterned, placed, wood_grain
from .surfaces import Number, Vector, quad

WIDTH, DEPTH, HEIGHT = (4.6, 3.9, 2.5)  # x, y, z; walls at x = 0 and y = DEPTH, the other sides are open
OPACITY, DISC_SIGMA, DISC_THICKNESS = 0.97, 0.55, 0.06  # sigmas in units of the spacing


@dataclass(frozen=True, eq=False)
class Room:
    """gaussians: of all things. labels: of each Gaussian, an index into names."""

    gaussians: Gaussians
    labels: Int32[np.ndarray, " n"]
    names: tuple[str, ...]

    def members(self, *names: str) -> np.ndarray:
        """Boolean mask of the Gaussians of the things named."""
        return np.isin(self.labels, [self.names.index(name) for name in names])

    def seen_from(self, views: Sequence[View], least: float = 2e-6) -> "Room":
        """Without the Gaussians that weigh less than `least` of a picture in all views together.

        Training from photos leaves none there either: a scene has no inside of a sofa.
        """
        splats, total = splat_arrays(self.gaussians), np.zeros(len(self.gaussians))
        for view in (view.resized(320, 240) for view in views):
            found = view_weights(splats, view, np.zeros((view.height, view.width), np.int32), topk=None)
            total[found.gaussian_ids] += found.weights
        seen = np.flatnonzero(total >= least * 320 * 240)
        return Room(self.gaussians.subset(seen), self.labels[seen], self.names)


def _floor(coarse: Number) -> Thing:
    def planks(points: np.ndarray) -> np.ndarray:
        row = np.floor(points[:, 1] / 0.16)
        board = np.floor((points[:, 0] + 0.77 * row) / 1.3)
        tone = 1 + 0.13 * np.sin(row * 12.9898 + board * 78.233)
        seam = (np.abs(points[:, 1] / 0.16 - row - 0.5) > 0.42) * 0.16
        grained: np.ndarray = wood_grain((0.64, 0.45, 0.28))(points) * (tone - seam)[:, None]
        return grained

    return [patterned(quad(WIDTH, DEPTH, 0.042 * coarse).placed((WIDTH / 2, DEPTH / 2, 0)), planks)]


def _wall(coarse: Number) -> Thing:
    d, plaster = 0.050 * coarse, (0.80, 0.775, 0.72)
    back = quad(WIDTH, HEIGHT, d).placed((WIDTH / 2, DEPTH, HEIGHT / 2), pitch=90)
    left = quad(DEPTH, HEIGHT, d).placed((0, DEPTH / 2, HEIGHT / 2), yaw=90, pitch=90)
    return [painted(back, plaster, 0.012), painted(left, plaster, 0.012)]


_Entry = tuple[str, Callable[[Number], Thing], Vector, Number, Number]
TABLE, SOFA = (2.25, 1.95, 0.015), (2.25, 3.38, 0.0)
INVENTORY: tuple[_Entry, ...] = (
    ("wooden floor", _floor, (0, 0, 0), 0, 0),
    ("white wall", _wall, (0, 0, 0), 0, 0),
    ("green sofa", furniture.sofa, SOFA, 0, 0),
    ("grey cat", belongings.cat, (1.88, 3.30, 0.45), 8, 0),
    ("yellow cushion", belongings.cushion, (2.86, 3.40, 0.45), -20, 0),
    ("striped rug", furniture.rug, (2.25, 1.95, 0), 0, 0),
    ("wooden table", furniture.coffee_table, TABLE, 0, 0),
    ("red mug", partial(belongings.mug, (0.80, 0.09, 0.09)), (1.93, 1.80, 0.46), 215, 0),
    ("blue mug", partial(belongings.mug, (0.12, 0.28, 0.76)), (2.58, 1.83, 0.46), -40, 0),
    ("white bowl", belongings.bowl, (2.24, 2.02, 0.46), 0, 0),
    ("green apples", belongings.apples, (2.24, 2.02, 0.46), 20, 0),
    ("lamp", furniture.floor_lamp, (3.62, 3.42, 0), 0, 0),
    ("potted plant", furniture.plant, (0.52, 3.35, 0), 15, 0),
    ("bookshelf", furniture.shelf, (0.17, 1.75, 0), 90, 0),
    ("books", belongings.books, (0.17, 1.75, 0), 90, 0),
    ("wooden chair", furniture.chair, (3.75, 1.55, 0), -62, 0),
    ("orange ball", belongings.ball, (0.95, 0.72, 0), 30, 0),
    ("brown teddy", belongings.teddy, (3.05, 0.85, 0.015), 12, 0),
    ("guitar", belongings.guitar, (4.22, 3.62, 0.0), -8, -14),
    ("painting", belongings.painting, (2.25, DEPTH - 0.01, 1.32), 0, 0),
    ("round clock", belongings.clock, (3.62, DEPTH - 0.01, 1.86), 0, 0),
    ("window", furniture.window, (0.01, 2.95, 1.00), 90, 0),
)


def furnish(coarse: Number = 1.0) -> list[tuple[str, Thing]]:
    """The things by name, in place."""
    return [(name, placed(build(coarse), at, yaw, pitch)) for name, build, at, yaw, pitch in INVENTORY]


def build_room(coarse: Number = 1.0, seed: int = 0) -> Room:
    """Flat Gaussians on all surfaces, lit. coarse: stretches their distances; 2 makes a quarter as many."""
    things = furnish(coarse)
    parts = [part for _, thing in things for part in thing]
    counts = [sum(len(part.colors) for part in thing) for _, thing in things]
    gaussians = _splats(parts, np.random.default_rng(seed))
    surface_normals = np.concatenate([part.surface.normals for part in parts])
    glows = np.concatenate([np.full(len(part.colors), part.glow) for part in parts])
    labels = np.repeat(np.arange(len(things), dtype=np.int32), counts)
    return Room(lit(gaussians, surface_normals, glows), labels, tuple(name for name, _ in things))


def _splats(parts: Sequence[Part], rng: np.random.Generator) -> Gaussians:
    spacing = np.concatenate([part.surface.spacing for part in parts])
    points = np.concatenate([part.surface.points for part in parts])
    normals = np.concatenate([part.surface.normals for part in parts])
    jitter = rng.normal(0, 0.10, points.shape)
    jitter -= (jitter * normals).sum(1, keepdims=True) * normals  # along the surface: it stays smooth
    points = points + jitter * spacing[:, None]
    sigma = spacing[:, None] * rng.normal([DISC_SIGMA, DISC_SIGMA, DISC_THICKNESS], [0.04, 0.04, 0.005], points.shape)
    colors = np.concatenate([part.colors for part in parts])
    opacities = np.clip(OPACITY + rng.normal(0, 0.01, len(points)), 0, 0.99)
    quats = _facing(normals)
    sh = color_to_sh(colors)
    columns = (points, quats, sigma, opacities, sh)
    means, quats32, scales, alphas, sh32 = (column.astype(np.float32) for column in columns)
    return Gaussians(means, quats32, scales, alphas, sh32)


def _facing(normals: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 4"]:
    """Rotations (wxyz) that take the local z axis to the normals by the shortest way."""
    half = normals + np.array([0, 0, 1.0])
    length = np.linalg.norm(half, axis=1, keepdims=True)
    half = np.where(length > 1e-6, half / np.maximum(length, 1e-6), [1.0, 0, 0])
    # the half turn about `half` maps z to the normal
    quats: np.ndarray = np.column_stack([np.zeros(len(half)), half])
    return quats
