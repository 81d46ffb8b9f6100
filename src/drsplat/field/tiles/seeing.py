"""Which tiles a camera may see, and their Gaussians laid out for the kernels."""

import shutil
from collections import OrderedDict
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.arrays import Doubles, Flags, Float64, Points, Vector3
from ...formats.tiles import SHAPES, Tile, Tiles, file_name
from ...kernels import SplatArrays, splat_arrays_at_origin
from ...scene.gaussians import Gaussians
from ...scene.views import View
from ..evidence.columns import VisibleSplats
from .store import Shared, Store

BLUR_VARIANCE_PIXELS2 = 0.3  # that a projected covariance is widened by (3DGS)
CLAMP_HALF_FIELDS = 1.3  # of view: where the Jacobian of the projection stops growing
SPARE_PIXELS = 24.0  # a tile of the raster, what a radius is rounded up by, and what float32 may be off
HELD_BYTES = 512 << 20
NO_SPLATS = SplatArrays(np.empty((3, 0), np.float32), np.empty((6, 0), np.float32), np.empty(0, np.float32))
NO_ROWS = np.empty(0, np.uint32)


def seen_tiles(tiles: Tiles, view: View, near: float) -> Flags:
    """Return the tiles that may hold a Gaussian which the kernels draw in a view: never too few.

    A Gaussian of depth z and largest deviation s reaches at most 3 (s a / z + sqrt(0.3)) pixels from its centre,
    where a / z bounds the norm of the projection's Jacobian. Multiplied by z, that it reaches over a border of the
    raster is linear in its centre: a half-space, which is compared with the corners of the tile's box.

    Source: 3DGS, "EWA" projection as in native/kernels/projection.h.
    """
    camera = view.relative_to(tiles.origin)
    low, high = tiles.corners
    reach = np.array([tile.largest for tile in tiles.tiles])
    seen = _furthest(camera.cam_from_world[2], low, high) > near * (1 - 1e-4)
    for row, offset in _borders(camera):
        seen &= _furthest(row @ camera.cam_from_world[:3], low, high) + offset * reach > 0
    return np.asarray(seen)


def _borders(view: View) -> list[tuple[Vector3, float]]:
    """Return what is positive inside of each border of the raster, in camera coordinates, and what a deviation adds."""
    fx, fy, cx, cy = view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]
    slanted = (CLAMP_HALF_FIELDS * view.width / (2 * fx)) ** 2 + (CLAMP_HALF_FIELDS * view.height / (2 * fy)) ** 2
    steepest = 3 * max(fx, fy) * np.sqrt(1 + slanted)
    margin = 3 * np.sqrt(BLUR_VARIANCE_PIXELS2) + SPARE_PIXELS
    rows = (
        (fx, 0.0, cx + margin),
        (-fx, 0.0, view.width - cx + margin),
        (0.0, fy, cy + margin),
        (0.0, -fy, view.height - cy + margin),
    )
    return [(np.array(row), float(steepest)) for row in rows]


def _furthest(plane: Float64[np.ndarray, " 4"], low: Points, high: Points) -> Doubles:
    """Return the largest value of n x + d over each box."""
    return np.where(plane[:3] > 0, high, low) @ plane[:3] + plane[3]


@dataclass(eq=False)
class Gallery:
    """The Gaussians in front of cameras: a `Scenery`. Tiles looked at last are held, up to `held_bytes`.

    given_near: camera z up to which nothing is drawn; None: the scene's own. store: where the tiles are; None: in
    their folder.
    """

    tiles: Tiles
    given_near: float | None = None
    store: Store | None = None
    held_bytes: int = HELD_BYTES
    _held: OrderedDict[str, SplatArrays] = field(default_factory=OrderedDict, repr=False)

    def __getstate__(self) -> dict[str, object]:
        """Return what other processes need, which load their own tiles."""
        return {**self.__dict__, "_held": OrderedDict()}

    @property
    def near(self) -> float:
        return self.tiles.near if self.given_near is None else self.given_near

    def digest(self, view: View) -> str:
        return f"{self.tiles.digest} {self.near!r}"

    def visible_splats(self, view: View) -> VisibleSplats:
        """Return all tiles that a view may see. Raises: FormatError: one is damaged or missing."""
        tiles = self.tiles.tiles
        chosen = [tiles[number] for number in np.flatnonzero(seen_tiles(self.tiles, view, self.near))]
        parts = [self._splats(tile) for tile in chosen]
        rows = [np.arange(tile.first, tile.first + tile.num_rows, dtype=np.uint32) for tile in chosen]
        means, covariances, opacities = (
            np.concatenate([part[k] for part in (NO_SPLATS, *parts)], axis=-1) for k in range(3)
        )
        splats = SplatArrays(means, covariances, opacities, self.near, self.tiles.origin, self.tiles.antialiased)
        return VisibleSplats(splats, np.concatenate([NO_ROWS, *rows]))

    def shapes(self, tile: Tile) -> Gaussians:
        """Return a tile without its colours, read anew. Raises: FormatError: it is damaged or missing."""
        if self.store is None:
            return self.tiles.shapes(tile)
        here = self.store.bring(_stored(self.tiles, tile))
        return replace(self.tiles, path=here.parent).shapes(tile)

    def _splats(self, tile: Tile) -> SplatArrays:
        if tile.name not in self._held:
            self._held[tile.name] = splat_arrays_at_origin(self.shapes(tile), self.near)
        self._held.move_to_end(tile.name)
        while len(self._held) > 1 and self._bytes() > self.held_bytes:
            self._held.popitem(last=False)
        return self._held[tile.name]

    def _bytes(self) -> int:
        return sum(array.nbytes for part in self._held.values() for array in part[:3])


def with_tiles(store: Store, tiles: Tiles) -> Store | None:
    """Return the store with the shapes of all tiles, or None where all workers see the tiles' folder."""
    if isinstance(store, Shared):
        return None
    for tile in tiles.tiles:
        name = _stored(tiles, tile)
        if not store.has(name):
            here = store.folder / name
            here.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(tiles.path / file_name(tile, SHAPES), here)
            store.send(name)
    return store


def _stored(tiles: Tiles, tile: Tile) -> str:
    """Name a tile in a store, which may hold other scenes with tiles of the same names."""
    return f"{tiles.digest}/{file_name(tile, SHAPES)}"
