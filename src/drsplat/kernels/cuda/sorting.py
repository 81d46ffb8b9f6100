"""A stable sort of 32-bit keys, and running sums, on the device; neither waits for it."""

from typing import Any, NamedTuple

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
