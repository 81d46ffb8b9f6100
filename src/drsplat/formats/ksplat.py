"""KSPLAT, version 0.1: the compact file of mkkellogg's viewer (GaussianSplats3D).

A header of 4096 bytes, one of 1024 for each section, then the sections, one behind the other: the lengths of the
buckets that are not full, the centres of all buckets, the rows. A row is position, scale (no logarithm), rotation
(w, x, y, z), colour and opacity as bytes, and of each degree of further harmonics all of red, of green, of blue;
degree 2 is the highest. Level 0 has float32. Level 1 has half floats, and positions in 16-bit steps from the centre
of the row's bucket. Level 2 is level 1 with harmonics in bytes, 255 steps between two numbers of the header.

Axes are those of the PLY that it was made from. Rows have been sorted by distance and bucket, and those that are
nearly transparent left out, so they are not the rows of that PLY.

A section's own count of rows is that of the first part that arrived where the viewer saved a scene which it had
loaded bit by bit: like the viewer this goes by the count of what has room (`rows`).

Source: SplatBuffer and the loaders of github.com/mkkellogg/GaussianSplats3D 0.4.7 (MIT).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..base.arrays import Array, Harmonics, Points
from ..errors import FormatError
from ..scene.gaussians import SH_C0, SH_COEFFICIENTS, Gaussians
from .activation import checked

MAGIC = b"\0\1\0\0"  # the version, and two bytes without a use
CENTRE_BYTES = 12
DEFAULT_HALF_STEPS = 32767  # from the centre of a bucket to its side, where the header has 0
DEFAULT_HARMONIC_BOUNDS = (-1.5, 1.5)  # where the header has 0
MIN_SCALE = 2.0**-25  # in place of 0 in half floats, which stands for all below their 2^-24
HARMONIC_BANDS = ((0, 1, 4), (9, 4, 9))  # first number in a row, first and last coefficient


class _Header(NamedTuple):
    sections: int
    rows: int
    loaded: int
    level: int
    low: float
    high: float


class _Section(NamedTuple):
    rows: int
    bucket_rows: int
    buckets: int
    block: float
    bucket_bytes: int
    half_steps: int
    full: int
    partial: int
    degree: int


HEADER = np.dtype(
    {
        "names": _Header._fields,
        "formats": ["<u4", "<u4", "<u4", "<u2", "<f4", "<f4"],
        "offsets": [4, 12, 16, 20, 36, 40],
        "itemsize": 4096,
    }
)
SECTION = np.dtype(
    {
        "names": _Section._fields,
        "formats": ["<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": 1024,
    }
)


def parse_ksplat(buffer: memoryview) -> Gaussians:
    """Return the Gaussians of a KSPLAT, SH degree 0 to 2: the highest of its sections, with zeros in the others.

    Raises: FormatError: another version; counts, buckets and sizes that do not fit each other and the file;
    rows that are no Gaussians.
    """
    header = _header(buffer)
    places = list(_places(buffer, header))
    n, degree = header.rows, max((section.degree for section, *_ in places), default=0)
    means, scales, quats, rgba = (np.empty((n, k), np.float32) for k in (3, 3, 4, 4))
    sh = np.zeros((n, SH_COEFFICIENTS[degree], 3), np.float32)
    for section, buckets, start, first in places:
        table = np.frombuffer(buffer, _row(header.level, section.degree), section.rows, start)
        rows = slice(first, first + section.rows)
        means[rows] = _positions(buffer, section, buckets, table) if header.level else table["means"]
        scales[rows], quats[rows], rgba[rows] = table["scales"], table["quats"], table["rgba"]
        _fill_further(sh[rows], table["rest"], header)
    if header.level:
        scales[scales == 0] = MIN_SCALE
    rgba /= 255
    sh[:, 0] = (rgba[:, :3] - np.float32(0.5)) / np.float32(SH_C0)
    return checked(means, quats, scales, rgba[:, 3].copy(), sh)


def _header(buffer: memoryview) -> _Header:
    if len(buffer) < HEADER.itemsize:
        raise FormatError(f"KSPLAT is truncated: {len(buffer)} bytes, its header has {HEADER.itemsize}")
    if bytes(buffer[:2]) != MAGIC[:2]:
        raise FormatError(f"KSPLAT version {buffer[0]}.{buffer[1]}; 0.1 can be read: export it again")
    header = _Header(*np.frombuffer(buffer, HEADER, 1).tolist()[0])
    if header.level > 2:
        raise FormatError(f"KSPLAT: expected compression level 0, 1 or 2, got {header.level}")
    if header.loaded != header.rows:
        raise FormatError(
            f"KSPLAT was saved when {header.loaded} of its {header.rows} Gaussians had been loaded: export it again"
        )
    return header


def _places(buffer: memoryview, header: _Header) -> Iterator[tuple[_Section, int, int, int]]:
    """Yield each section, where its buckets and its rows begin, and the number of its first row in the file.

    Each is checked to fit the file, and at last that they are all of the file.
    """
    at, first = HEADER.itemsize + header.sections * SECTION.itemsize, 0
    if at > len(buffer):
        raise FormatError(
            f"KSPLAT is truncated: the headers of {header.sections} sections end at byte {at} of {len(buffer)}"
        )
    sections = np.frombuffer(buffer, SECTION, header.sections, HEADER.itemsize).tolist()
    for index, section in enumerate(map(_Section._make, sections)):
        if section.degree > 2:
            raise FormatError(f"KSPLAT section {index}: expected harmonics of degree 0 to 2, got {section.degree}")
        table = at + 4 * section.partial + section.bucket_bytes * section.buckets
        end = table + section.rows * _row(header.level, section.degree).itemsize
        if end > len(buffer):
            raise FormatError(
                f"KSPLAT is truncated: section {index} of {section.rows} Gaussians in "
                f"{section.buckets} buckets ends at byte {end} of {len(buffer)}"
            )
        if header.level:
            _require_buckets(buffer, section, at, index)
        yield section, at, table, first
        at, first = end, first + section.rows
    if (at, first) != (len(buffer), header.rows):
        raise FormatError(
            f"KSPLAT: its {header.sections} sections are {first} Gaussians and end at byte {at}; expected "
            f"{header.rows} Gaussians and byte {len(buffer)}"
        )


def _require_buckets(buffer: memoryview, section: _Section, at: int, index: int) -> None:
    held = section.full * section.bucket_rows + int(_lengths(buffer, section, at).sum())
    if (
        section.bucket_bytes != CENTRE_BYTES
        or section.full + section.partial != section.buckets
        or held != section.rows
    ):
        raise FormatError(
            f"KSPLAT section {index}: {section.full} full and {section.partial} other buckets of "
            f"{section.buckets}, with centres of {section.bucket_bytes} bytes, hold {held} rows; expected "
            f"{CENTRE_BYTES} bytes and {section.rows} rows"
        )


def _lengths(buffer: memoryview, section: _Section, at: int) -> Array:
    """Return the rows of the buckets that are not full."""
    return np.frombuffer(buffer, "<u4", section.partial, at)


def _row(level: int, degree: int) -> np.dtype:
    number = "<f2" if level else "<f4"
    return np.dtype(
        [
            ("means", "<u2" if level else "<f4", 3),
            ("scales", number, 3),
            ("quats", number, 4),
            ("rgba", "u1", 4),
            ("rest", ("<f4", "<f2", "u1")[level], (3 * (SH_COEFFICIENTS[degree] - 1),)),
        ]
    )


def _positions(buffer: memoryview, section: _Section, at: int, table: Array) -> Points:
    centres = np.frombuffer(buffer, "<f4", 3 * section.buckets, at + 4 * section.partial)
    full = np.full(section.full, section.bucket_rows, np.int64)
    counts = np.concatenate([full, _lengths(buffer, section, at)])
    half = section.half_steps or DEFAULT_HALF_STEPS
    steps = table["means"].astype(np.float64) - half
    return steps * (section.block / 2 / half) + centres.reshape(-1, 3).repeat(counts, axis=0)


def _fill_further(sh: Harmonics, rest: Array, header: _Header) -> None:
    """Fill in the coefficients that a row has beyond the constant one."""
    lowest, highest = header.low or DEFAULT_HARMONIC_BOUNDS[0], header.high or DEFAULT_HARMONIC_BOUNDS[1]
    of_bytes = (lowest + (highest - lowest) * (np.arange(256) / 255)).astype(np.float32)
    values = of_bytes[rest] if header.level == 2 else rest
    for start, low, high in HARMONIC_BANDS:
        end = start + 3 * (high - low)
        if rest.shape[1] >= end:
            by_channel = values[:, start:end].reshape(-1, 3, high - low)
            sh[:, low:high] = by_channel.transpose(0, 2, 1)
