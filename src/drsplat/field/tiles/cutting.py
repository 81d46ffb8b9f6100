"""Scenes, or blocks of one, cut into tiles along a Morton curve."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.arrays import Indices, Numbers, Points, SmallIds, UnsignedIds, Vector3
from ...errors import InputError
from ...formats.sources import Block
from ...formats.tiles import Tiles, write_tiles
from ...scene.gaussians import Gaussians, concatenated, local_origin
from ...scene.morton import morton_order
from ...scene.similarity import IDENTITY

MAX_BLOCKS = 65_535
SMALL_QUANTILE = 0.99  # of sizes
TILE_ROWS = 1 << 17  # 6 MB of shapes


def cut(blocks: Sequence[Block], output: Path, rows: int = TILE_ROWS, *, overwrite: bool = False) -> Tiles:
    """Write the Gaussians of all blocks, where they stand in the world, as tiles of at most so many `rows`.

    Holds places, sizes and order of all Gaussians, and the rows of one tile; a binary PLY may be of any size.

    Raises: InputError: no Gaussian is left, more blocks than 65,535 or `output` exists. FormatError: as reading them.
    """
    if len(blocks) > MAX_BLOCKS:
        raise InputError(f"expected at most {MAX_BLOCKS:,} blocks, got {len(blocks):,}: cut them in several scenes")
    if rows < 1:
        raise InputError(f"rows: expected a positive number, got {rows}")
    placed = _placed(blocks)
    if not len(placed.positions):
        raise InputError("no Gaussian is left to cut into tiles: check the boxes of what is kept")
    origin = local_origin(placed.positions)
    names = [block.source.name for block in blocks]
    runs = _runs(placed, rows)
    parts = (_tile(blocks, placed.blocks[run], placed.rows[run], origin) for run in runs)
    return write_tiles(output, parts, origin, names, overwrite)


class _Placed(NamedTuple):
    """Gaussians that are kept: their positions in the world, sizes, blocks, and rows within the blocks."""

    positions: Points
    sizes: Numbers
    blocks: SmallIds
    rows: UnsignedIds


def _runs(placed: _Placed, rows: int) -> Iterator[Indices]:
    """Yield the rows of each tile, along the curve.

    The largest hundredth gets tiles of its own: a single large Gaussian makes its tile seen from afar.
    """
    order = morton_order(placed.positions)
    large = placed.sizes[order] > np.quantile(placed.sizes, SMALL_QUANTILE)
    for of_size in (order[~large], order[large]):
        for begin in range(0, len(of_size), rows):
            yield of_size[begin : begin + rows]


def _placed(blocks: Sequence[Block]) -> _Placed:
    parts = []
    for number, (source, place, keep) in enumerate(blocks):
        positions, sizes = source.positions(), source.sizes()
        if place is not IDENTITY:
            positions, sizes = place.positions(positions), np.float32(place.scale) * sizes
        kept = np.arange(len(positions)) if keep is None else np.flatnonzero(keep.holds(positions))
        parts.append((positions[kept], sizes[kept], np.full(len(kept), number, np.uint16), kept.astype(np.uint32)))
    return _Placed(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _tile(
    blocks: Sequence[Block], block_of: SmallIds, row_of: UnsignedIds,
    origin: Vector3,
) -> Gaussians:  # fmt: skip
    """Return some rows of some blocks, in the order given, with positions counted from the origin."""
    order = np.lexsort((row_of, block_of))  # files are read front to back
    parts = []
    for number in np.unique(block_of):
        source, place, _ = blocks[number]
        part = source.gaussians(row_of[order][block_of[order] == number])
        parts.append(part if place is IDENTITY else place.moved(part))
    whole = concatenated([replace(part, extra={}) for part in parts])
    means = (whole.positions - origin).astype(np.float32)
    extra = {"block": block_of[order], "source_row": row_of[order]}
    given_order = np.empty(len(order), np.int64)
    given_order[order] = np.arange(len(order))
    return replace(whole, means=means, extra=extra, origin=origin).subset(given_order)
