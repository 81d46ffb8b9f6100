"""Which splats touch which tile of a view, front to back: what every walk over pixels starts from.

A stable sort of 32-bit keys, and running sums, on the device; neither waits for it.
"""

from typing import Any, NamedTuple

import numpy as np

from ...errors import DrSplatError
from ...scene.views import View
from ..splats import camera_numbers
from .engine import Engine, blocks_of

KEYS_PER_BLOCK, COUNTS_PER_BLOCK = 4096, 2048
DIGIT_BITS, DIGITS = 8, 256
MAX_KEYS = (1 << 30) - 1  # the kernels count in 30 bits
MAX_HISTOGRAM_BLOCKS = 1024  # enough to fill a GPU


def rounded(count: int) -> int:
    """Return a count that arrays are allocated for: few different ones, so that memory is used again."""
    step = 1 << max(count.bit_length() - 4, 10)
    return -(-count // step) * step


def empty(engine: Engine, count: int, kind: Any) -> Any:
    """Return an array of a size that changes with every view."""
    return engine.xp.empty(rounded(count), kind)[:count]


class Pairs(NamedTuple):
    """Keys and the values beside them."""

    keys: Any  # uint32 (n)
    values: Any  # uint32 (n)


def sorted_pairs(engine: Engine, keys: Any, values: Any | None, key_bits: int) -> Pairs:
    """Return keys in ascending order and the values beside them, equal keys in the order given.

    keys: uint32 (n), of which the lowest `key_bits` count; they are written over. values: uint32 (n), written over as
    well, or None: the places of the keys.
    """
    xp, count = engine.xp, len(keys)
    if count == 0:
        return Pairs(keys, xp.zeros(0, xp.uint32) if values is None else values)
    passes, blocks = max(1, -(-key_bits // DIGIT_BITS)), blocks_of(count, KEYS_PER_BLOCK)
    # what a sort counts with, zero: histograms, tickets, and what each block tells in each pass
    room = xp.zeros(rounded(passes * (DIGITS + 1 + blocks * DIGITS)), xp.uint32)
    histograms, tickets, status = room, room[passes * DIGITS :], room[passes * (DIGITS + 1) :]
    other_keys = empty(engine, count, xp.uint32)
    outputs = (empty(engine, count, xp.uint32), empty(engine, count, xp.uint32) if values is None else values)
    engine.launch("sort_histograms", min(blocks, MAX_HISTOGRAM_BLOCKS), 256, keys, count, passes, histograms)
    for number in range(passes):
        output = outputs[number % 2]
        engine.launch(
            "sort_pass", blocks, 256, keys, values, other_keys, output, count, DIGIT_BITS * number,
            histograms[number * DIGITS :], status[number * blocks * DIGITS :], tickets[number:],
        )  # fmt: skip
        keys, other_keys, values = other_keys, keys, output
    return Pairs(keys, values)


def running_sums(engine: Engine, counts: Any, order: Any | None = None) -> Any:
    """Return int64 sums of counts (uint32) up to each place, itself included; in another order where one is given."""
    xp, count = engine.xp, len(counts)
    blocks = blocks_of(count, COUNTS_PER_BLOCK)
    ends, room = xp.empty(count, xp.int64), xp.zeros(blocks + 1, xp.uint64)
    engine.launch("sum_counts", blocks, 256, counts, order, count, ends, room[1:], room)
    return ends


TILE = 16  # pixels a side
SPLAT_FLOATS, EXTENT_FLOATS = 8, 8  # of the structures in projection.cuh
DEPTH_BITS = 32


class OutOfMemoryError(DrSplatError):
    """There is more than fits, whatever memory the device has; answered as CuPy's error of this name."""


class Raster(NamedTuple):
    """Size of an image, in pixels."""

    width: int
    height: int

    @property
    def columns(self) -> int:
        return -(-self.width // TILE)

    @property
    def num_tiles(self) -> int:
        return self.columns * -(-self.height // TILE)


class Projected(NamedTuple):
    """Splats of a view by Gaussian; where `counts` is 0 nothing is seen of it, and its rows hold nothing.

    keys: order as the depths do. counts: tiles that each touches.
    """

    splats: Any  # float32 (n, 8)
    extents: Any  # float32 (n, 8)
    keys: Any  # uint32 (n)
    counts: Any  # uint32 (n)


class Tiles(NamedTuple):
    """Splats of each tile, front to back; of one depth by their index.

    starts: of each tile's run in `ids`, which names Gaussians. rows: where training keeps what it sums up of each pair:
    rows of one Gaussian follow each other and end at `row_ends`; None outside of training.
    """

    starts: Any  # uint32 (tiles + 1)
    ids: Any  # uint32 (pairs)
    rows: Any | None = None  # uint32 (pairs)
    row_ends: Any | None = None  # int64 (n)


def room_for_splats(engine: Engine, count: int) -> Projected:
    """Return arrays for the splats of one view."""
    xp = engine.xp
    return Projected(
        xp.empty((count, SPLAT_FLOATS), xp.float32),
        xp.empty((count, EXTENT_FLOATS), xp.float32),
        xp.empty(count, xp.uint32),
        xp.empty(count, xp.uint32),
    )


def sent_camera(engine: Engine, view: View, near: float) -> Any:
    """Return a camera as the kernels read it: `camera_numbers`, then its centre. Raises: InputError: as those."""
    numbers = camera_numbers(view, near)
    rotation, translation = numbers[:9].reshape(3, 3), numbers[9:12]
    return engine.xp.asarray(np.concatenate([numbers, -(rotation.T @ translation)]).astype(np.float32))


def tiles_of(engine: Engine, projected: Projected, raster: Raster, *, training: bool = False) -> Tiles:
    """Sort a view's splats into tiles. Waits for the device once, to learn how many pairs there are.

    Raises: OutOfMemoryError: more pairs than can be sorted at once, as if there were no memory for them.
    """
    xp, count = engine.xp, len(projected.keys)
    order = sorted_pairs(engine, projected.keys, None, DEPTH_BITS).values
    ends = running_sums(engine, projected.counts, order)
    row_ends = running_sums(engine, projected.counts) if training else None
    pairs = int(ends[-1]) if count else 0
    if pairs > MAX_KEYS:
        raise OutOfMemoryError(
            f"a view of {raster.width}x{raster.height} pixels has {pairs:,} pairs of splats and tiles, more than can "
            f"be sorted at once, {MAX_KEYS:,}"
        )
    keys, values = empty(engine, pairs, xp.uint32), empty(engine, pairs, xp.uint32)
    owners = empty(engine, pairs, xp.uint32) if training else None
    engine.launch(
        "list_tiles", blocks_of(count), 256, order, projected.counts, ends, row_ends, projected.splats,
        projected.extents, count, raster.columns, keys, values, owners,
    )  # fmt: skip
    keys, values = sorted_pairs(engine, keys, values, (raster.num_tiles - 1).bit_length())
    starts = xp.zeros(raster.num_tiles + 1, xp.uint32)
    ids = empty(engine, pairs, xp.uint32) if training else values
    engine.launch(
        "find_tiles", blocks_of(pairs), 256, keys, values, owners, pairs, raster.num_tiles, starts,
        ids if training else None,
    )  # fmt: skip
    return Tiles(starts, ids, values if training else None, row_ends)
