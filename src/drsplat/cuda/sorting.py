"""A stable sort of 32-bit keys on the device."""

from typing import Any

from .engine import Engine, blocks_of

KEYS_IN_A_BLOCK = 4096
DIGIT_BITS, DIGITS = 8, 256
MOST_KEYS = (1 << 30) - 1  # the kernels count in 30 bits
SOME_BLOCKS = 1024  # enough to fill a GPU


def sorted_pairs(engine: Engine, keys: Any, values: Any | None, key_bits: int) -> tuple[Any, Any]:
    """Return keys in ascending order and the values beside them, equal keys in the order given.

    keys: uint32 (n), of which the lowest `key_bits` count; they are written over. values: uint32 (n), written over as
    well, or None: the places of the keys.
    """
    xp, count = engine.xp, len(keys)
    passes = max(1, -(-key_bits // DIGIT_BITS))
    if count == 0:
        return keys, xp.zeros(0, xp.uint32) if values is None else values
    blocks = blocks_of(count, KEYS_IN_A_BLOCK)
    # what a sort counts with, zero: histograms, tickets, and what each block tells in each pass
    room = xp.zeros(passes * DIGITS + passes + passes * blocks * DIGITS, xp.uint32)
    histograms, tickets = room[: passes * DIGITS], room[passes * DIGITS :][:passes]
    status = room[passes * DIGITS + passes :]
    other_keys = xp.empty_like(keys)
    outputs = (xp.empty(count, xp.uint32), xp.empty(count, xp.uint32) if values is None else values)
    engine.launch("sort_histograms", min(blocks, SOME_BLOCKS), 256, keys, count, passes, histograms)
    for number in range(passes):
        output = outputs[number % 2]
        engine.launch(
            "sort_pass", blocks, 256, keys, values, other_keys, output, count, DIGIT_BITS * number,
            histograms[number * DIGITS :], status[number * blocks * DIGITS :], tickets[number:],
        )  # fmt: skip
        keys, other_keys, values = other_keys, keys, output
    return keys, values
