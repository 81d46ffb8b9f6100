"""A scene in tiles on show: it stays on disk, and what is looked at is read."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from ...authoring.editing import EditList
from ...authoring.editing.edits import Change
from ...base.arrays import Flags, Ids, Indices, Numbers, PlanePoints, RowIds, Vectors, WholeNumbers
from ...drawing.heat import class_colors, heat_colors, heat_of
from ...errors import InputError
from ...formats.tiles import Tile, Tiles
from ...query import Scene
from ...query.objects import objects_of
from ...query.seen import Seen
from ...scene.gaussians import Gaussians, most_significant
from ...scene.views import View
from . import painting
from .edits import Notes
from .naming import REACH_DEVIATIONS, Hit, Met, Ray, blended, inside_outline, met_by_ray
from .session import Mode, Session
from .shown import RADIUS, Frame, Shown, base_colors

COARSE_SHARE = 0.25  # of the Gaussians that a browser gets: of all tiles, the most significant of each
RADIUS_HALF_DIAGONALS = 1.5  # of a middling tile in a browser's RADIUS: a city has the scale of a room there
MIN_LIGHT_SHARE = 1e-4  # where less is left a click goes no further
UNEDITED = (
    "a scene in tiles is not edited here, nor written as one file: edit what it was cut from, or write all of it with "
    "`drsplat export --tiles3d`"
)


@dataclass(eq=False)
class NoEdits(Notes):
    """The edits of a scene in tiles, none, and its annotations. Stands for `Edits`."""

    listed: EditList
    is_edited: bool = False
    file: None = None

    @classmethod
    def of(cls, scene: Scene) -> "NoEdits":
        return cls(*cls.beside(scene), EditList(scene.rows.fingerprint))

    def take(self, other: "NoEdits") -> None:
        """Take the edits of a copy: there are none."""

    def refuse(self, *_: Any) -> NoReturn:
        """Refuse what would change the scene. Raises: InputError: always."""
        raise InputError(UNEDITED)

    add = undo = redo = part = refuse


@dataclass(eq=False, repr=False)
class TiledSession(Session):
    """A session of a scene in tiles. Browsers get it part by part (`live.arrays`): of each tile a coarse one, the rest.

    What is remembered of tiles that were sent are the rows of their coarse parts.
    """

    _coarse: dict[int, Indices] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._edits = NoEdits.of(self.scene)  # type: ignore[assignment]

    @property
    def tiles(self) -> Tiles:
        tiles = self.scene.tiles
        assert tiles is not None
        return tiles

    @property
    def edits(self) -> Any:
        return self._edits

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

    def part(self, number: int) -> tuple[Gaussians, RowIds]:
        """Return a part and its rows: 2 k is the coarse one of tile k, 2 k + 1 what that leaves out.

        Raises: InputError: there is none. FormatError: the tile is damaged or missing.
        """
        tile = self.tile_of(number)
        whole = self.tiles.tile(tile)
        if number // 2 not in self._coarse:
            self._coarse[number // 2] = most_significant(whole, self.num_coarse(tile))
        rows = self.rows_of(number) - tile.first
        return whole.subset(rows), rows + tile.first

    def rows_of(self, number: int) -> RowIds:
        """Return the rows of a part; the tile is read where nobody has. Raises: as `part`."""
        tile = self.tile_of(number)
        if number // 2 not in self._coarse:
            self._coarse[number // 2] = most_significant(self.tiles.shapes(tile), self.num_coarse(tile))
        coarse = self._coarse[number // 2]
        return tile.first + (np.setdiff1d(np.arange(tile.num_rows), coarse) if number % 2 else coarse)

    def tile_of(self, number: int) -> Tile:
        """Return the tile of a part. Raises: InputError: there is none."""
        if not 0 <= number < 2 * len(self.tiles.tiles):
            raise InputError(f"parts: expected numbers below {2 * len(self.tiles.tiles)}, got {number}")
        return self.tiles.tiles[number // 2]

    # --- what rows answer ---

    def heat_at(self, rows: WholeNumbers) -> Numbers:
        """Return how well some rows answer, as `results.heat`."""
        own = self.scene.field.rows_of(rows)
        warmest = np.zeros(len(rows), np.float32)
        for result in self.results:
            warm = heat_of(result.answer.values[own[own >= 0]], result.threshold)
            warmest[own >= 0] = np.maximum(warmest[own >= 0], warm)
        return warmest

    def owners_at(self, rows: WholeNumbers) -> Ids:
        """Return the query that each of some rows answers, as `results.owners`."""
        owners = np.full(len(rows), -1, np.int32)
        for number in range(len(self.results) - 1, -1, -1):
            owners[np.isin(rows, self._found[number], assume_unique=True)] = number
        return owners

    @property
    def _found(self) -> list[RowIds]:
        """Rows of each query, made once for its results."""
        known = self.__dict__.get("_rows_found")
        if known is None or known[0] is not self.results:
            known = self.__dict__["_rows_found"] = self.results, [result.gaussian_ids for result in self.results]
        return known[1]

    def objects_at(self, rows: WholeNumbers) -> Ids:
        """Return the object of each of some rows, -1 for none."""
        own = self.scene.field.rows_of(rows)
        numbers = np.full(len(rows), -1, np.int32)
        numbers[own >= 0] = objects_of(self.scene.field).thing_of(own[own >= 0])
        return numbers

    def colors_at(self, rgb: Vectors, rows: WholeNumbers) -> Vectors:
        """Return the colours of some rows in the present mode, as `Session.colors`. rgb: their own."""
        if self.mode is Mode.CLASSES and self.segmentation is not None:
            palette = class_colors(len(self.segmentation.names))
            return painting.class_painted(rgb, self.segmentation.labels[rows], palette)
        if self.mode is Mode.OBJECTS and self.has_objects:
            return painting.object_painted(rgb, self.objects_at(rows), len(objects_of(self.scene.field)))
        if self.mode is Mode.HEAT and self.results:
            return heat_colors(self.heat_at(rows))
        if self.mode is Mode.ANSWER and any(len(found) for found in self._found):
            accents = [painting.accent(number) for number in range(len(self.results))]
            dimmed = painting.dimmed(rgb)
            owners = self.owners_at(rows)
            return painting.highlighted(rgb, owners, accents) if (owners >= 0).any() else dimmed
        return rgb

    def seen_with_colors(self, view: View) -> tuple[Seen, Vectors]:
        """Return what a camera may see, in the colours of the present mode."""
        seen = self.scene.seen(view)
        assert seen.rows is not None
        return seen, self.colors_at(base_colors(seen.gaussians), seen.rows)

    # --- pointing ---

    @property
    def hidden(self) -> Flags:
        """False for each Gaussian: nothing is removed."""
        return np.broadcast_to(np.False_, len(self.scene.rows))

    def _inside(self, view: View, outline: PlanePoints) -> RowIds:
        seen = self.scene.seen(view)
        assert seen.rows is not None
        return seen.rows[inside_outline(seen.splats, view, outline, threads=self.scene.threads)]

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

    # --- what needs the whole ---

    def edit(self, change: Change) -> NoReturn:
        raise InputError(UNEDITED)

    def edited(self, *, selected_only: bool = False) -> NoReturn:
        raise InputError(UNEDITED)

    def standing(self, ids: RowIds) -> Gaussians:
        return self.scene.rows.shapes_of(ids)


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
