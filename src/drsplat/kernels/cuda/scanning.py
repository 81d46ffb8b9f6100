"""Search in product-quantised codes on a GPU: what `kernels.scan` does on the CPU, with codes that stay on the device.

Scores are float32 sums in one fixed order: the same bits in each run, and nearer to the exact ones than
`kernels.scan.MAX_SCORE_ERROR`. Only what was asked for comes to the host.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Float32, FloatRows, Ids, Indices, Numbers, OtherIndices
from ...errors import InputError
from ..scan import (
    GroupedRows,
    QueryTables,
    RowShapes,
    check_count,
    check_fit,
    check_floor,
    refuse_several_queries,
    shapes_of,
)
from .devices import on_host
from .engine import Engine, blocks_of
from .tiling import MAX_KEYS, sorted_pairs

THREADS_PER_BLOCK = 512  # as in scan.cuh
ROWS_PER_BLOCK = 1024  # that it scores at once
SLOT_SUBVECTORS = 32  # whose tables a warp looks up at once
SLICE_BYTES = 64 * 256 * 4  # tables of two slots
WORKING_BYTES_PER_ROW = 24  # for scores and for choosing by them
EMULATED_BLOCKS = 2  # without a GPU


class DeviceRows(NamedTuple):
    """Coded features on the device, as `kernels.scan.GroupedRows`."""

    engine: Engine
    codes: Any  # uint8 (g, L, 256)
    inverse_norms: Any  # float32 (n)
    coarse_ids: Any | None  # uint16 (n)
    shapes: RowShapes

    @property
    def num_rows(self) -> int:
        """Number of rows."""
        return self.shapes.num_rows


def sent_rows(engine: Engine, rows: GroupedRows) -> DeviceRows:
    """Copy coded features to the device, once for all queries.

    Raises: InputError: more rows than a scan can have, or than the device has memory for.
    """
    shapes = shapes_of(rows)
    if shapes.num_rows > MAX_KEYS:
        raise InputError(
            f"expected up to {MAX_KEYS:,} rows to search on a GPU, got {shapes.num_rows:,}: take device 'cpu'"
        )
    needed = sum(part.nbytes for part in rows if part is not None) + WORKING_BYTES_PER_ROW * len(rows.inverse_norms)
    free = engine.free_bytes()
    if needed > free:
        raise InputError(
            f"search on the GPU needs {needed / 1e6:,.0f} MB of its memory for {len(rows.inverse_norms):,} rows, of "
            f"which {free / 1e6:,.0f} MB are free: end other programs that use it, or take device 'cpu'"
        )
    xp, ids = engine.xp, rows.coarse_ids
    return DeviceRows(
        engine,
        xp.asarray(np.ascontiguousarray(rows.codes, np.uint8)),
        xp.asarray(np.ascontiguousarray(rows.inverse_norms, np.float32)),
        None if ids is None else xp.asarray(np.ascontiguousarray(ids, np.uint16)),
        shapes,
    )


def scan_scores(rows: DeviceRows, tables: QueryTables) -> FloatRows:
    """Return each query's scores of each row as `kernels.scan.scan_scores`.

    Raises: InputError: arrays that do not fit each other.
    """
    scores = np.empty((len(tables.luts), rows.num_rows), np.float32)
    for query, on_device in enumerate(device_scores(rows, tables)):
        scores[query] = on_host(on_device)
    return scores


def scan_above(
    rows: DeviceRows, tables: QueryTables, threshold: float, floor: Numbers | None = None
) -> tuple[OtherIndices, Float32[np.ndarray, " m"]]:
    """Return the rows whose score minus `floor` exceeds the threshold as `kernels.scan.scan_above`.

    Raises: InputError: more than one query, or arrays that do not fit each other.
    """
    scores = _scores_of_one(rows, tables)
    check_floor(floor, rows.num_rows)
    xp = rows.engine.xp
    margins = scores if floor is None else scores - xp.asarray(np.ascontiguousarray(floor))
    matches = xp.flatnonzero(margins > np.float32(threshold))
    return on_host(matches), on_host(scores[matches])


def scan_top(rows: DeviceRows, tables: QueryTables, count: int) -> tuple[Indices, Numbers]:
    """Return the `count` best rows and their scores as `kernels.scan.scan_top`.

    Raises: InputError: more than one query, a count below 1, or arrays that do not fit each other.
    """
    scores = _scores_of_one(rows, tables)
    check_count(count)
    # whole numbers that ascend where scores descend; the two zeros are equal
    bits = (scores + np.float32(0)).view(rows.engine.xp.uint32)
    places = sorted_pairs(
        rows.engine, rows.engine.xp.where(bits >> 31, bits, bits ^ np.uint32(0x7FFFFFFF)), None, 32
    ).values[:count]
    return on_host(places).astype(np.int64), on_host(scores[places])


def scan_best(rows: DeviceRows, tables: QueryTables) -> tuple[Ids, Numbers, Numbers]:
    """Return each row's best query, its score and the next highest as `kernels.scan.scan_best`.

    Raises: InputError: arrays that do not fit each other.
    """
    xp, count = rows.engine.xp, rows.num_rows
    index, best, runner_up = (xp.empty(count, kind) for kind in (xp.int32, xp.float32, xp.float32))
    for query, scores in enumerate(device_scores(rows, tables)):
        rows.engine.launch("keep_best", blocks_of(count), 256, scores, count, query, index, best, runner_up)
    return on_host(index), on_host(best), on_host(runner_up)


def device_scores(rows: DeviceRows, tables: QueryTables) -> Iterator[Any]:
    """Return the scores of each query on the device, one query after the other, in memory that is used again.

    Raises: InputError: arrays that do not fit each other.
    """
    check_fit(rows.shapes, tables)
    xp = rows.engine.xp
    luts = xp.asarray(np.ascontiguousarray(tables.luts))
    coarse = None if tables.coarse is None else xp.asarray(np.ascontiguousarray(tables.coarse))
    scores = xp.empty(rows.num_rows, xp.float32)
    return (scanned(rows, luts[q], None if coarse is None else coarse[q], scores) for q in range(len(luts)))


def scanned(rows: DeviceRows, luts: Any, coarse: Any | None, scores: Any) -> Any:
    """Fill the scores of one query, with as many sub-vectors at once as shared memory has room for."""
    engine, subvectors = rows.engine, rows.codes.shape[1]
    slots, at_once = blocks_of(subvectors, SLOT_SUBVECTORS), 2 * (engine.shared_bytes // SLICE_BYTES)
    cuda = getattr(engine.xp, "cuda", None)
    most = EMULATED_BLOCKS if cuda is None else int(cuda.Device().attributes["MultiProcessorCount"])
    blocks = min(most, blocks_of(rows.num_rows, ROWS_PER_BLOCK))
    for begin in range(0, slots, at_once):
        number = min(at_once, slots - begin)
        ending = (coarse, rows.coarse_ids, rows.inverse_norms) if begin + number == slots else (None, None, None)
        engine.launch(
            "scan", blocks, THREADS_PER_BLOCK, rows.codes, rows.num_rows, subvectors, begin * SLOT_SUBVECTORS, number,
            luts, scores if begin else None, *ending, scores, shared_bytes=blocks_of(number, 2) * SLICE_BYTES,
        )  # fmt: skip
    return scores


def _scores_of_one(rows: DeviceRows, tables: QueryTables) -> Any:
    scores = device_scores(rows, tables)
    refuse_several_queries(tables)
    return next(scores)
