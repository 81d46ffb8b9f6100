"""Images and blending weights on a GPU: what `kernels.splatting` does on the CPU, of the same scene.

Where the memory is full a view is worked on in bands of tiles, half of it at a time, and so on.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ...base.arrays import Float32, FloatRows, MaskIds
from ...errors import DrSplatError
from ...scene.views import View
from ..splats import Contributions, Rendering, SplatArrays, Triples
from .devices import on_host
from .engine import Engine, blocks_of, is_memory_full
from .tiling import Raster, Tiles, empty, room_for_splats, running_sums, sent_camera, sorted_pairs, tiles_of

WARPS_PER_TILE, PIXELS_PER_TILE = 8, 256
BATCH_BYTES = 24 << 10  # of shared memory that a kernel needs besides its columns
Entries = tuple[Any, Any, Any]  # Gaussians (uint32), masks (uint32), weights (float32)
T = TypeVar("T")


class Band(NamedTuple):
    """Rows [first, last) of a view's tiles."""

    first: int
    last: int


class TiledView(NamedTuple):
    """A band of a view of a scene, ready to be walked over."""

    raster: Raster
    band: Band
    splats: Any  # float32 (n, 8)
    tiles: Tiles

    @property
    def num_tiles(self) -> int:
        return (self.band.last - self.band.first) * self.raster.columns

    def arguments(self) -> tuple[object, ...]:
        """Return what every kernel that walks over tiles takes first."""
        raster, first_tile = self.raster, self.band.first * self.raster.columns
        return (self.tiles.starts, self.tiles.ids, self.splats, first_tile, raster.width, raster.height, raster.columns)


def sent_splats(engine: Engine, splats: SplatArrays) -> SplatArrays:
    """Return a scene on the device: 40 bytes for each Gaussian. Raises: DrSplatError: it does not fit."""
    try:
        arrays = [engine.xp.asarray(np.ascontiguousarray(part)) for part in splats[:3]]
    except Exception as error:
        if not is_memory_full(error):
            raise
        raise DrSplatError(
            f"the GPU has no room for {len(splats.opacities):,} Gaussians of 40 bytes: take device 'cpu', or cut the "
            f"scene into tiles. {error}"
        ) from error
    return splats._replace(means=arrays[0], covariances=arrays[1], opacities=arrays[2], engine=engine)


def render_channels(
    splats: SplatArrays, view: View, values: FloatRows, background: Float32[np.ndarray, " k"]
) -> Rendering:
    """Composite per-Gaussian values as `kernels.splatting.render_channels`. Raises: DrSplatError: the GPU is full."""
    xp = splats.engine.xp
    return Rendering(*map(on_host, drawn_channels(splats, view, xp.asarray(values), xp.asarray(background))))


def drawn_channels(splats: SplatArrays, view: View, values: Any, background: Any) -> tuple[Any, Any, Any]:
    """Return image (h, w, c), alpha and depth (h, w) on the device. values (n, c), background (c): float32 there.

    Raises: DrSplatError: the GPU is full.
    """
    engine, xp, channels = splats.engine, splats.engine.xp, values.shape[1]
    size = (view.height, view.width)
    image, alpha, depth = (xp.empty(shape, xp.float32) for shape in ((*size, channels), size, size))

    def draw(tiled: TiledView) -> None:
        engine.launch(
            "draw", tiled.num_tiles, PIXELS_PER_TILE, *tiled.arguments(), values, channels, background, image, alpha,
            depth,
        )  # fmt: skip

    _in_bands(splats, view, draw)
    return image, alpha, depth


def view_weights(splats: SplatArrays, view: View, mask_ids: MaskIds, topk: int, first_hits: int) -> Triples:
    """Return one view's entries of W as `kernels.splatting.view_weights`; 0 for `topk` or `first_hits`: all.

    Raises: DrSplatError: the GPU is full.
    """
    engine, xp, count = splats.engine, splats.engine.xp, len(splats.opacities)
    masks, most = xp.asarray(mask_ids), int(mask_ids.max(initial=0))

    def weights(tiled: TiledView) -> Entries:
        return _added(engine, _entries(engine, tiled, masks, topk, first_hits, count), count, most.bit_length())

    bands = _in_bands(splats, view, weights)
    if len(bands) > 1:
        joined = xp.concatenate([band[0] for band in bands]), xp.concatenate([band[1] for band in bands])
        bands = [_added(engine, (*joined, xp.concatenate([band[2] for band in bands])), count, most.bit_length())]
    gaussians, masks_seen, sums = map(on_host, bands[0])
    return Triples(gaussians, masks_seen.view(np.int32), sums)


def topk_contributions(splats: SplatArrays, view: View, topk: int, first_hits: int) -> Contributions:
    """Return the largest weights of each pixel as `kernels.splatting.topk_contributions`.

    Raises: DrSplatError: the GPU is full.
    """
    engine, xp = splats.engine, splats.engine.xp
    ids = xp.full((view.height, view.width, topk), -1, xp.int32)
    weights = xp.zeros(ids.shape, xp.float32)

    def contribute(tiled: TiledView) -> None:
        chosen = _chosen(engine, tiled, None, topk, first_hits, None)
        engine.launch(
            "put_contributions", tiled.num_tiles, PIXELS_PER_TILE, *tiled.arguments(), topk, first_hits, chosen, ids,
            weights,
        )  # fmt: skip

    _in_bands(splats, view, contribute)
    return Contributions(on_host(ids), on_host(weights))


def _in_bands(splats: SplatArrays, view: View, work: Callable[[TiledView], T]) -> list[T]:
    """Return what `work` makes of a view: of all its tiles at once, or of bands of them where the memory is full."""
    raster = Raster(*view.size)
    camera = sent_camera(splats.engine, view.relative_to(splats.origin), splats.near)

    def of_band(band: Band) -> list[T]:
        try:
            # project a scene and sort it into the tiles of a band
            engine, count = splats.engine, len(splats.opacities)
            projected = room_for_splats(engine, count)
            engine.launch(
                "project_scene", blocks_of(count), 256, splats.means, splats.covariances, splats.opacities, count,
                camera, raster.width, raster.height, splats.antialiased, *band, *projected,
            )  # fmt: skip
            return [work(TiledView(raster, band, projected.splats, tiles_of(engine, projected, raster)))]
        except Exception as error:
            if not is_memory_full(error):
                raise
            if band.last - band.first == 1:
                raise DrSplatError(
                    f"the GPU's memory is full, with {len(splats.opacities):,} Gaussians and one row of tiles of view "
                    f"'{view.name}' ({view.width}x{view.height}): take device 'cpu', or a smaller image. {error}"
                ) from error
        splats.engine.release()
        middle = (band.first + band.last) // 2
        return of_band(Band(band.first, middle)) + of_band(Band(middle, band.last))

    return of_band(Band(0, raster.num_tiles // raster.columns))


def _chosen(engine: Engine, tiled: TiledView, masks: Any | None, topk: int, first_hits: int, bounds: Any | None) -> Any:
    """Return what each pixel takes of its weights: a threshold, and how many that equal it."""
    xp, raster = engine.xp, tiled.raster
    chosen = xp.empty((raster.height, raster.width, 2), xp.uint32)
    column_bytes = 4 * topk * PIXELS_PER_TILE
    fits = column_bytes + BATCH_BYTES <= engine.shared_bytes
    columns = None if fits else xp.empty(tiled.num_tiles * topk * PIXELS_PER_TILE, xp.float32)
    engine.launch(
        "choose_weights", tiled.num_tiles, PIXELS_PER_TILE, *tiled.arguments(), masks, topk, first_hits, columns,
        chosen, bounds, shared_bytes=column_bytes if fits else 0,
    )  # fmt: skip
    return chosen


def _entries(engine: Engine, tiled: TiledView, masks: Any, topk: int, first_hits: int, count: int) -> Entries:
    """Return the weights of each warp's pixels by Gaussian and mask, in a fixed order; Gaussian `count` is none."""
    xp = engine.xp
    bounds = xp.empty(tiled.num_tiles * WARPS_PER_TILE, xp.uint32)
    chosen = _chosen(engine, tiled, masks, topk, first_hits, bounds)
    ends = running_sums(engine, bounds)
    room = int(ends[-1])
    entries = empty(engine, room, xp.uint32), empty(engine, room, xp.uint32), empty(engine, room, xp.float32)
    engine.launch(
        "put_weights", tiled.num_tiles, PIXELS_PER_TILE, *tiled.arguments(), masks, first_hits, chosen, bounds, ends,
        count, *entries,
    )  # fmt: skip
    return entries


def _added(engine: Engine, entries: Entries, count: int, mask_bits: int) -> Entries:
    """Sort entries by (Gaussian, mask) and add up those of one pair, in the order in which they were written."""
    xp, (gaussians, masks, weights) = engine.xp, entries
    size = len(gaussians)
    places = sorted_pairs(engine, masks.copy(), None, mask_bits).values
    places = sorted_pairs(engine, gaussians[places], places, count.bit_length()).values
    begins = empty(engine, size, xp.uint32)
    engine.launch("mark_pairs", blocks_of(size), 256, places, gaussians, masks, size, count, begins)
    numbers = running_sums(engine, begins)
    found = int(numbers[-1]) if size else 0
    out = xp.empty(found, xp.uint32), xp.empty(found, xp.uint32), xp.empty(found, xp.float32)
    engine.launch(
        "add_pairs", blocks_of(size), 256, places, gaussians, masks, weights, size, count, begins, numbers, *out
    )
    return out
