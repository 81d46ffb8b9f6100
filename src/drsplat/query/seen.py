"""Gaussians that a view may see: all of a scene in memory, some tiles of one on disk."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arrays import Indices, RowIds
from ..errors import warn
from ..field import LanguageField
from ..field.tiles.seeing import seen_tiles
from ..formats.tiles import Tile, Tiles
from ..kernels import SplatArrays, splat_arrays_at_origin
from ..kernels.splatting import on_device_in_use
from ..scene.gaussians import Gaussians, filled, most_significant
from ..scene.parted import AnyGaussians
from ..scene.views import View

SAMPLED_GAUSSIANS = 1000  # whose mean is the place of a thing
MAX_VIEWS_COMPARED = 6  # to find the one that shows most of something
MAX_GAUSSIANS_SEEN = 3_000_000  # of tiles, in one picture: 0.9 GB with harmonics of degree 3


class Seen(NamedTuple):
    """Gaussians that a view may see.

    rows: theirs in the scene, ascending; None: they are the whole scene. num_left_out: those of far tiles for which a
    picture has no room.
    """

    gaussians: Gaussians
    splats: SplatArrays
    rows: Indices | None = None
    num_left_out: int = 0

    def warn(self, view: View) -> None:
        """Warn that a picture lacks something: DrSplatWarning."""
        if self.num_left_out:
            warn(
                f"view '{view.name}' may see {len(self.gaussians) + self.num_left_out:,} Gaussians, and a picture of "
                f"tiles has room for {MAX_GAUSSIANS_SEEN:,}: of far tiles the most significant are drawn; look from "
                "nearer",
                3,
            )

    def local(self, ids: RowIds) -> Indices:
        """Return the places here of some rows of the scene, without those that are not here."""
        if self.rows is None:
            return ids.astype(np.int64)
        places = np.searchsorted(self.rows, ids)
        here = places < len(self.rows)
        here[here] = self.rows[places[here]] == ids[here]
        return np.asarray(places[here], np.int64)


def seen_of_tiles(tiles: Tiles, view: View, most: int = MAX_GAUSSIANS_SEEN) -> Seen:
    """Return the Gaussians of all tiles that a view may see; of more than `most`, those of far tiles thinned out.

    Raises: FormatError: a tile is damaged or missing.
    """
    chosen = [tiles.tiles[number] for number in np.flatnonzero(seen_tiles(tiles, view, tiles.near))]
    rooms = _rooms(tiles, chosen, view, most)
    parts, rows = [_NO_GAUSSIANS], [np.empty(0, np.int64)]
    for tile in chosen:
        part = tiles.tile(tile)
        kept = most_significant(part, rooms[tile.name])
        parts.append(part if len(kept) == len(part) else part.subset(kept))
        rows.append(tile.first + kept)
    whole = _joined(parts, tiles)
    splats = on_device_in_use(splat_arrays_at_origin(whole, tiles.near))
    return Seen(whole, splats, np.concatenate(rows), sum(tile.num_rows for tile in chosen) - len(whole))


def _rooms(tiles: Tiles, chosen: list[Tile], view: View, most: int) -> dict[str, int]:
    """Return how many Gaussians of each tile a picture has room for: all of near ones, an equal share of far ones."""
    rooms = {tile.name: tile.num_rows for tile in chosen}
    total = sum(rooms.values())
    if total <= most:
        return rooms
    eye = view.center - tiles.origin
    away = {
        tile.name: float(np.linalg.norm(np.maximum(np.maximum(tile.low - eye, eye - tile.high), 0))) for tile in chosen
    }
    near, far, left = 0, dict(rooms), most
    for name in sorted(away, key=lambda name: away[name]):
        if near + rooms[name] > most // 2:
            break
        near += far.pop(name)
    left = most - near
    behind = sum(far.values())
    return rooms | {name: max(1, left * count // behind) for name, count in far.items()}


def _joined(parts: list[Gaussians], tiles: Tiles) -> Gaussians:
    most = max(part.sh.shape[1] for part in parts)
    means, quats, scales, opacities = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("means", "quats", "scales", "opacities")
    )
    sh = np.concatenate([filled(part.sh, most) for part in parts])
    return Gaussians(means, quats, scales, opacities, sh, {}, tiles.origin, tiles.antialiased)


def views_showing(field: LanguageField, rows: AnyGaussians, views: Sequence[View], ids: RowIds) -> list[View]:
    """Return a few views whose masks have the largest weights in some Gaussians; without evidence, near ones.

    rows: the scene's.
    """
    own = field.rows_of(ids)
    if field.evidence is None or not (own >= 0).any():
        # the views that are nearest to a place, of those that have it in their picture if there are any
        poses, K = np.array([view.cam_from_world for view in views]), np.array([view.K for view in views])
        local = (
            poses[:, :3, :3] @ rows.shapes_of(ids[:: len(ids) // SAMPLED_GAUSSIANS + 1]).positions.mean(0)
            + poses[:, :3, 3]
        )
        depth = np.maximum(local[:, 2], 1e-9)
        x, y = (K[:, k, k] * local[:, k] / depth + K[:, k, 2] for k in range(2))
        wide, high = np.array([view.size for view in views]).T
        inside = (local[:, 2] > 0) & (x >= 0) & (x <= wide) & (y >= 0) & (y <= high)
        order = np.lexsort((np.linalg.norm(local, axis=1), ~inside))
        return [views[number] for number in order[:MAX_VIEWS_COMPARED].tolist()]
    masks = field.evidence.masks
    weights = field.evidence.column_sums(np.unique(own[own >= 0]))
    shown = np.bincount(masks.views, weights, minlength=len(masks.view_names))
    names = {
        masks.view_names[view] for view in np.argsort(-shown, kind="stable")[:MAX_VIEWS_COMPARED] if shown[view] > 0
    }
    return [view for view in views if view.name in names] or list(views[:MAX_VIEWS_COMPARED])


_NO_GAUSSIANS = Gaussians(
    np.empty((0, 3), np.float32), np.empty((0, 4), np.float32), np.empty((0, 3), np.float32),
    np.empty(0, np.float32), np.empty((0, 1, 3), np.float32),
)  # fmt: skip
