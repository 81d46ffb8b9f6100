"""A scene in tiles on show: it stays on disk, and what is looked at is read."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from ...authoring.editing import EditList
from ...base.arrays import Indices, RowIds, Vectors
from ...errors import InputError
from ...formats.tiles import Tile, Tiles
from ...query import Scene
from ...query.seen import Seen
from ...scene.gaussians import Gaussians, most_significant
from ...scene.views import View
from .edits import Notes
from .naming import REACH_DEVIATIONS, Hit, Met, Ray, blended, met_by_ray
from .session import Mode, Session
from .shown import RADIUS, Frame, Shown, base_colors

COARSE_SHARE = 0.25  # of the Gaussians that a browser gets: of all tiles, the most significant of each
RADIUS_HALF_DIAGONALS = 1.5  # of a middling tile in a browser's RADIUS: a city has the scale of a room there
MIN_LIGHT_SHARE = 1e-4  # where less is left a click goes no further
UNEDITED = (
    "a scene in tiles is not edited here, nor written as one file: edit what it was cut from, or write all of it with "
    "`drsplat export --tiles3d`"
)


def _refused(*_: Any, **__: Any) -> NoReturn:
    """Refuse what would change the scene. Raises: InputError: always."""
    raise InputError(UNEDITED)


class NoEdits(Notes):
    """The edits of a scene in tiles, none, and its annotations. Stands for `Edits`."""

    is_edited, file = False, None
    add = undo = redo = part = _refused

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.listed = EditList(scene.rows.fingerprint)
        self.present = np.broadcast_to(np.True_, len(scene.rows))


@dataclass(eq=False, repr=False)
class TiledSession(Session):
    """A session of a scene in tiles. Browsers get it part by part (`live.arrays`): of each tile a coarse one, the rest.

    What is remembered of tiles that were sent are the rows of their coarse parts.
    """

    _coarse: dict[int, Indices] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._edits = NoEdits(self.scene)  # type: ignore[assignment]

    @property
    def tiles(self) -> Tiles:
        tiles = self.scene.tiles
        assert tiles is not None
        return tiles

    @property
    def modes(self) -> tuple[Mode, ...]:
        return tuple(mode for mode in super().modes if mode is not Mode.FEATURES)

    # --- what a browser gets ---

    @cached_property
    def shown(self) -> Shown:
        """No rows, and the frame of all."""
        none = np.empty(0, np.float32)
        return Shown(
            np.empty(0, np.int64), none.reshape(0, 3), none.reshape(0, 6), none.reshape(0, 3), none,
            frame_of_tiles(self.tiles), 0, self.tiles.antialiased,
        )  # fmt: skip

    @property
    def drawn(self) -> Shown:
        return self.shown

    @property
    def num_shown(self) -> int:
        return min(self.budget, len(self.tiles))

    @property
    def radius(self) -> float:
        return RADIUS / self.shown.frame.scale / 2

    def num_coarse(self, tile: Tile) -> int:
        """Return how many Gaussians the coarse part of a tile has."""
        return max(1, min(tile.num_rows, int(tile.num_rows * COARSE_SHARE * self.budget / len(self.tiles))))

    def part(self, number: int) -> Gaussians:
        """Return a part: 2 k is the coarse one of tile k, 2 k + 1 what that leaves out.

        Raises: InputError: there is none. FormatError: the tile is damaged or missing.
        """
        tile = self.tile_of(number)
        whole = self.tiles.tile(tile)
        return whole.subset(self.rows_of(number, whole) - tile.first)

    def rows_of(self, number: int, whole: Gaussians | None = None) -> RowIds:
        """Return the rows of a part. whole: its tile; None: it is read where nobody has. Raises: as `part`."""
        tile = self.tile_of(number)
        if number // 2 not in self._coarse:
            read = self.tiles.shapes(tile) if whole is None else whole
            self._coarse[number // 2] = most_significant(read, self.num_coarse(tile))
        coarse = self._coarse[number // 2]
        return tile.first + (np.setdiff1d(np.arange(tile.num_rows), coarse) if number % 2 else coarse)

    def num_rows_of(self, number: int) -> int:
        """Return how many Gaussians a part has. Raises: InputError: there is none."""
        tile = self.tile_of(number)
        return tile.num_rows - self.num_coarse(tile) if number % 2 else self.num_coarse(tile)

    def tile_of(self, number: int) -> Tile:
        """Return the tile of a part. Raises: InputError: there is none."""
        if not 0 <= number < 2 * len(self.tiles.tiles):
            raise InputError(f"parts: expected numbers below {2 * len(self.tiles.tiles)}, got {number}")
        return self.tiles.tiles[number // 2]

    # --- what a camera sees ---

    def seen(self, view: View) -> Seen:
        return self.scene.seen(view)

    def seen_colors(self, seen: Seen) -> Vectors:
        return self.painted(base_colors(seen.gaussians), seen.rows)

    def _hit(self, ray: Ray) -> Hit | None:
        """Return what a ray meets, read tile after tile until no light reaches the next one."""
        met = Met(np.empty(0, np.int64), np.empty(0), np.empty(0))
        for entered, tile in self._along(ray):
            before = met.depths < entered
            if np.prod(1 - met.alphas[before]) < MIN_LIGHT_SHARE:
                break
            rows = np.arange(tile.first, tile.first + tile.num_rows)
            own = met_by_ray(self.tiles.shapes(tile), ray, self.scene.field.rows_of(rows) >= 0)
            own = own._replace(gaussian_ids=own.gaussian_ids + tile.first)
            both = Met(*(np.concatenate(pair) for pair in zip(met, own, strict=True)))
            order = np.lexsort((both.gaussian_ids, both.depths))
            met = Met(*(column[order] for column in both))
        return blended(met, ray)

    def _along(self, ray: Ray) -> Iterator[tuple[float, Tile]]:
        """Yield the tiles whose boxes, widened by what their Gaussians reach, a ray meets: how far it is to each."""
        start = ray.origin - self.tiles.origin
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [
                np.sort([(tile.low - REACH_DEVIATIONS * tile.largest - start) / ray.direction,
                         (tile.high + REACH_DEVIATIONS * tile.largest - start) / ray.direction], axis=0)
                for tile in self.tiles.tiles
            ]  # fmt: skip
        entered = np.nanmax(np.array([end[0] for end in ends]), axis=1)
        left = np.nanmin(np.array([end[1] for end in ends]), axis=1)
        for number in np.argsort(entered, kind="stable").tolist():
            if entered[number] <= left[number] and left[number] > 0:
                yield float(entered[number]), self.tiles.tiles[number]

    def standing(self, ids: RowIds) -> Gaussians:
        return self.scene.rows.shapes_of(ids)

    edit = edited = _refused


def session_of(scene: Scene, *given: Any, **named: Any) -> Session:
    """Return a session of a scene, in memory or in tiles; arguments as of `Session`."""
    return (Session if scene.tiles is None else TiledSession)(scene, *given, **named)


def frame_of_tiles(tiles: Tiles) -> Frame:
    """Return a frame in the middle of all tiles in which a middling tile has the size that a room has."""
    low, high = tiles.corners
    sizes = np.array([tile.num_rows for tile in tiles.tiles])
    middles = (low + high) / 2
    center = np.average(middles, axis=0, weights=sizes)
    halves = np.linalg.norm(high - low, axis=1) / 2
    reach = min(
        RADIUS_HALF_DIAGONALS * float(np.median(halves)),
        float((np.linalg.norm(middles - center, axis=1) + halves).max()),
    )
    return Frame(center + tiles.origin, RADIUS / reach if reach > 0 else 1.0)
