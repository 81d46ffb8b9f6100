"""Images and blending weights on a GPU: what `kernels.splatting` does on the CPU, of the same scene."""

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Float32, Int32
from ..kernels.splatting import Contributions, Rendering, SplatArrays, Triples
from ..scene.views import View
from .engine import Engine, blocks_of
from .places import on_host
from .sorting import empty, running_sums, sorted_pairs
from .tiling import Raster, Tiles, room_for_splats, sent_camera, tiles_of

WARPS, PIXELS_IN_A_TILE = 8, 256


class TiledView(NamedTuple):
    """A view of a scene, ready to be walked over."""

    raster: Raster
    splats: Any  # float32 (n, 8)
    tiles: Tiles

    def arguments(self) -> tuple[object, ...]:
        """Return what every kernel that walks over tiles takes first."""
        raster = self.raster
        return (self.tiles.starts, self.tiles.ids, self.splats, raster.width, raster.height, raster.columns)


def sent_splats(engine: Engine, splats: SplatArrays) -> SplatArrays:
    """Return a scene on the device: 40 bytes for each Gaussian."""
    means, covariances, opacities = (engine.xp.asarray(np.ascontiguousarray(part)) for part in splats[:3])
    return splats._replace(means=means, covariances=covariances, opacities=opacities, engine=engine)


def tiled_view(splats: SplatArrays, view: View) -> TiledView:
    """Project a scene and sort it into the tiles of a view. Raises: InputError: see `camera_numbers`."""
    engine, count = splats.engine, len(splats.opacities)
    raster = Raster(view.width, view.height)
    camera = sent_camera(engine, view.relative_to(splats.origin), splats.near)
    projected = room_for_splats(engine, count)
    engine.launch(
        "project_scene", blocks_of(count), 256, splats.means, splats.covariances, splats.opacities, count, camera,
        raster.width, raster.height, splats.antialiased, *projected,
    )  # fmt: skip
    return TiledView(raster, projected.splats, tiles_of(engine, projected, raster))


def render_channels(
    splats: SplatArrays, view: View, values: Float32[np.ndarray, "n c"], background: Float32[np.ndarray, " c"]
) -> Rendering:
    """Composite per-Gaussian values as `kernels.splatting.render_channels`."""
    engine, xp, channels = splats.engine, splats.engine.xp, values.shape[1]
    tiled = tiled_view(splats, view)
    size = (view.height, view.width)
    image, alpha, depth = (
        xp.empty((*size, channels), xp.float32),
        xp.empty(size, xp.float32),
        xp.empty(size, xp.float32),
    )
    engine.launch(
        "draw", tiled.raster.num_tiles, PIXELS_IN_A_TILE, *tiled.arguments(), xp.asarray(values), channels,
        xp.asarray(background), image, alpha, depth,
    )  # fmt: skip
    return Rendering(*map(on_host, (image, alpha, depth)))


def view_weights(
    splats: SplatArrays, view: View, mask_ids: Int32[np.ndarray, "h w"], topk: int, first_hits: int
) -> Triples:
    """Return one view's entries of W as `kernels.splatting.view_weights`; 0 for `topk` or `first_hits`: all."""
    engine, xp, count = splats.engine, splats.engine.xp, len(splats.opacities)
    tiled, masks = tiled_view(splats, view), xp.asarray(mask_ids)
    bounds = xp.empty(tiled.raster.num_tiles * WARPS, xp.uint32)
    chosen = _chosen(engine, tiled, masks, topk, first_hits, bounds)
    ends = running_sums(engine, bounds)
    room = int(ends[-1]) if len(ends) else 0
    gaussians, masks_seen, weights = (empty(engine, room, kind) for kind in (xp.uint32, xp.uint32, xp.float32))
    engine.launch(
        "put_weights", tiled.raster.num_tiles, PIXELS_IN_A_TILE, *tiled.arguments(), masks, first_hits, chosen,
        bounds, ends, count, gaussians, masks_seen, weights,
    )  # fmt: skip
    most = int(mask_ids.max(initial=0))
    return _added(engine, (gaussians, masks_seen, weights), count, most.bit_length())


def topk_contributions(splats: SplatArrays, view: View, topk: int, first_hits: int) -> Contributions:
    """Return the largest weights of each pixel as `kernels.splatting.topk_contributions`."""
    engine, xp = splats.engine, splats.engine.xp
    tiled = tiled_view(splats, view)
    chosen = _chosen(engine, tiled, None, topk, first_hits, None)
    ids = xp.full((view.height, view.width, topk), -1, xp.int32)
    weights = xp.zeros(ids.shape, xp.float32)
    engine.launch(
        "put_contributions", tiled.raster.num_tiles, PIXELS_IN_A_TILE, *tiled.arguments(), topk, first_hits, chosen,
        ids, weights,
    )  # fmt: skip
    return Contributions(on_host(ids), on_host(weights))


def _chosen(engine: Engine, tiled: TiledView, masks: Any | None, topk: int, first_hits: int, bounds: Any | None) -> Any:
    """Return what each pixel takes of its weights: a threshold, and how many that equal it."""
    xp, raster = engine.xp, tiled.raster
    chosen = xp.empty((raster.height, raster.width, 2), xp.uint32)
    column_bytes = 4 * topk * PIXELS_IN_A_TILE
    static_bytes = 24 << 10  # of the kernel's own batch
    fits = column_bytes + static_bytes <= engine.shared_bytes
    columns = None if fits else xp.empty(raster.num_tiles * topk * PIXELS_IN_A_TILE, xp.float32)
    engine.launch(
        "choose_weights", raster.num_tiles, PIXELS_IN_A_TILE, *tiled.arguments(), masks, topk, first_hits, columns,
        chosen, bounds, shared_bytes=column_bytes if fits else 0,
    )  # fmt: skip
    return chosen


def _added(engine: Engine, entries: tuple[Any, Any, Any], count: int, mask_bits: int) -> Triples:
    """Sort entries by (Gaussian, mask) and add up those of one pair, in the order in which they were written."""
    xp, (gaussians, masks, weights) = engine.xp, entries
    size = len(gaussians)
    if size == 0:
        return Triples(np.zeros(0, np.uint32), np.zeros(0, np.int32), np.zeros(0, np.float32))
    places = sorted_pairs(engine, masks.copy(), None, mask_bits).values
    places = sorted_pairs(engine, gaussians[places], places, count.bit_length()).values
    begins = empty(engine, size, xp.uint32)
    engine.launch("mark_pairs", blocks_of(size), 256, places, gaussians, masks, size, count, begins)
    numbers = running_sums(engine, begins)
    found = int(numbers[-1])
    out = xp.empty(found, xp.uint32), xp.empty(found, xp.int32), xp.empty(found, xp.float32)
    engine.launch(
        "add_pairs", blocks_of(size), 256, places, gaussians, masks, weights, size, count, begins, numbers, *out
    )
    return Triples(*map(on_host, out))
