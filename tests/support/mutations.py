"""Damaged files: what a broken download, a bad editor or an attacker makes of good bytes.

`mutants(data, rng, count)` works for any format, text or binary: half of what it does is blind,
half aims at what readers trust (counts, sizes, numbers in text, floats, compressed streams).
"""

import ctypes
import gc
import gzip
import os
import resource
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import zstandard

from drsplat.errors import DrSplatError

Mutation = Callable[[bytes, np.random.Generator], bytes]
NUMBERS = (b"0", b"1", b"-1", b"255", b"256", b"4294967295", b"9223372036854775807", b"1e9", b"nan", b"inf")
NUMBERS += (b"-inf", b"1e39", b"9" * 40, b"0x10", b"\xff", b"")
COUNTS = (0, 1, 2, 255, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
FLOATS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e38, -1e38, 1e-45, 89.0, -120.0)
BOMB_BYTES = 1 << 26


def mutants(data: bytes, rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """`count` damaged versions of `data`, the same for the same state of `rng`."""
    for _ in range(count):
        damaged = data
        for _ in range(1 + int(rng.random() < 0.3)):
            damaged = MUTATIONS[rng.integers(len(MUTATIONS))](damaged, rng)
        yield damaged


def survivors(path: Path, read: Callable[[Path], object], rng: np.random.Generator, count: int) -> int:
    """How many of so many damaged versions of a file are read; anything but our own errors fails the test."""
    good, survived = path.read_bytes(), 0
    read(path)
    for mutant in mutants(good, rng, count):
        path.write_bytes(mutant)
        with suppress(DrSplatError):
            read(path)
            survived += 1
    path.write_bytes(good)
    return survived


def truncate(data, rng):
    return data[: _at(data, rng)]


def clip_the_end(data, rng):
    return data[: -int(rng.integers(1, 9))]


def append(data, rng):
    return data + rng.bytes(int(rng.integers(1, 64)))


def flip_bits(data, rng):
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if data else 0):
        changed[_at(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def flip_bits_of_the_head(data, rng):
    return flip_bits(data[:64], rng) + data[64:]


def fill(data, rng):
    """A run of zeros or ones: zero quaternions, NaN of all bits."""
    length = int(rng.integers(1, 65))
    return _over(data, _at(data, rng), bytes([int(rng.choice([0, 255, 128]))]) * length)


def scramble(data, rng):
    return _over(data, _at(data, rng), rng.bytes(int(rng.integers(1, 65))))


def plant_float(data, rng):
    code = str(rng.choice(["<f", ">f", "<d", ">d"]))
    return _over(data, _at(data, rng), struct.pack(code, FLOATS[rng.integers(len(FLOATS))]))


def plant_count(data, rng):
    """A count that promises too much, or nothing, among the first bytes."""
    size, order = int(rng.choice([1, 2, 4, 8])), str(rng.choice(["little", "big"]))
    value = int(COUNTS[rng.integers(len(COUNTS))]) % 256**size
    return _over(data, _at(data[:96], rng), value.to_bytes(size, order))  # type: ignore[arg-type]


def delete(data, rng):
    start = _at(data, rng)
    return data[:start] + data[start + int(rng.integers(1, 65)) :]


def splice(data, rng):
    """A piece of the file once more, somewhere else."""
    start = _at(data, rng)
    piece = data[start : start + int(rng.integers(1, 257))]
    target = _at(data, rng)
    return data[:target] + piece + data[target:]


def edit_number(data, rng):
    """Another number in place of one written as text."""
    return _edit_word(data, rng, _words(data, rng, b"0123456789.-"), NUMBERS)


def edit_word(data, rng):
    """A word of the file's own in place of another."""
    letters = b"abcdefghijklmnopqrstuvwxyz_0123456789"
    words = _words(data, rng, letters)
    return _edit_word(data, rng, words, [data[a:b] for a, b in words] or [b""])


def edit_line(data, rng):
    """A line left out, doubled, or exchanged with the next."""
    lines = data.split(b"\n", 64)
    i = int(rng.integers(len(lines)))
    match int(rng.integers(3)):
        case 0:
            del lines[i]
        case 1:
            lines.insert(i, lines[i])
        case _:
            lines[i : i + 2] = lines[i : i + 2][::-1]
    return b"\n".join(lines)


def inside_gzip(data, rng):
    """Damage under an intact gzip wrapping, where checksums no longer catch it."""
    inner = _gunzip(data)
    if inner is None:
        return flip_bits(data, rng)
    simple = MUTATIONS[: MUTATIONS.index(inside_gzip)]
    return gzip.compress(simple[rng.integers(len(simple))](inner, rng), 1, mtime=0)


def bomb(data, rng):
    """A compressed stream that unfolds to 64 MiB, alone or behind the file's own beginning."""
    kinds = bombs()
    return data[: int(rng.choice([0, 0, 16, 32, 48, 112]))] + kinds[rng.integers(len(kinds))]


MUTATIONS: list[Mutation] = [
    truncate, clip_the_end, append, flip_bits, flip_bits_of_the_head, fill, scramble, plant_float,
    plant_count, delete, splice, edit_number, edit_word, edit_line, inside_gzip, bomb,
]  # fmt: skip


@cache
def bombs() -> list[bytes]:
    """64 MiB of zeros as gzip, as zlib, as zstd with and without its size, and zstd in zstd."""
    zeros = bytes(BOMB_BYTES)
    deflated = zlib.compress(zeros, 1)
    known = zstandard.ZstdCompressor().compress(zeros)
    unknown = zstandard.ZstdCompressor(write_content_size=False).compress(zeros)
    return [gzip.compress(zeros, 1, mtime=0), deflated, known, unknown, zstandard.compress(known)]


@cache
def _gunzip(data: bytes) -> bytes | None:
    try:
        return zlib.decompressobj(wbits=31).decompress(data, 1 << 20) or None
    except zlib.error:
        return None


def _at(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data))) if data else 0


def _over(data: bytes, start: int, new: bytes) -> bytes:
    return data[:start] + new + data[start + len(new) :]


def _words(data: bytes, rng: np.random.Generator, letters: bytes) -> list[tuple[int, int]]:
    """Spans of up to three words made of `letters`, at random in the first 4 KiB."""
    found = []
    for _ in range(3):
        start = end = _at(data[:4096], rng)
        while start > 0 and data[start - 1] in letters:
            start -= 1
        while end < len(data) and data[end] in letters:
            end += 1
        if end > start:
            found.append((start, end))
    return found


def _edit_word(data: bytes, rng: np.random.Generator, spans: list[tuple[int, int]], others: tuple | list) -> bytes:
    if not spans:
        return flip_bits(data, rng)
    start, end = spans[rng.integers(len(spans))]
    return data[:start] + others[rng.integers(len(others))] + data[end:]


@contextmanager
def bounded_allocations(allowance: int) -> Iterator[None]:
    """Allocations beyond `allowance` bytes raise MemoryError, which no reader is to raise."""
    bombs()  # made once, with more memory than this
    gc.collect()
    _give_back_free_memory()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + allowance, hard))
    holes = []
    try:
        with pytest.raises(MemoryError):  # noqa: PT012
            while len(holes) < 1000:  # what earlier tests left within the heap needs no new address space
                holes.append(np.empty(2 * allowance, np.uint8))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _give_back_free_memory() -> None:
    """What earlier tests left at the top of the heap could be had again without any new address space."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
    if trim is not None:
        trim(ctypes.c_size_t(0))


def seeded(*numbers: int) -> np.random.Generator:
    """The same numbers for the same seed, others where DRSPLAT_SEED is set, for a long run by hand."""
    return np.random.default_rng([*numbers, *map(int, os.environ.get("DRSPLAT_SEED", "").split())])


def quota(count: int) -> int:
    """How many mutants a reader gets: `count`, or DRSPLAT_MUTANTS for a long run by hand."""
    return int(os.environ.get("DRSPLAT_MUTANTS", count))
