"""Masks as run lengths, as COCO and LVIS store them, and polygons as masks.

A run-length mask goes down the columns of the image, one column after the other: so many pixels
outside, so many inside, and so on in turns.
Source: the COCO API (masks.h, maskApi.c), its data formats; read for facts.
"""

import numpy as np

from ..base.arrays import Bool, Float, Int64, UInt8
from ..errors import FormatError

_FIRST_CODE = 48
_DIGIT_MASK = 0x1F
_CONTINUATION_BIT = 0x20
_SIGN_BIT = 0x10
_DIGIT_BITS = 5
_MAX_DIGITS = 8  # 40 bits: more pixels than any photo has
_BLOCK_CROSSINGS = 1 << 18  # that are worked on at once, so that memory does not grow with a polygon's height


def decode_runs(counts: Int64[np.ndarray, " n"], height: int, width: int, where: str) -> Bool[np.ndarray, "h w"]:
    """Return the mask of run lengths, the first of which are pixels outside.

    Raises: FormatError: a negative length, or lengths that do not add up to the image. Nothing is
    allocated before that is known.
    """
    pixels = height * width
    wrong = counts[(counts < 0) | (counts > pixels)]
    if len(wrong):
        raise FormatError(f"{where}: a run of {wrong[0]} pixels in an image of {width}x{height}, {pixels} pixels")
    total = sum(counts.tolist())  # Python's integers: a sum of int64 could wrap to the right number
    if total != pixels:
        raise FormatError(f"{where}: the runs add up to {total} pixels, the image {width}x{height} has {pixels}")
    inside = np.arange(len(counts)) % 2 == 1
    mask: np.ndarray = np.ascontiguousarray(np.repeat(inside, counts).reshape(width, height).T)
    return mask


def unpack_counts(text: str, where: str) -> Int64[np.ndarray, " n"]:
    """Run lengths from COCO's compressed text.

    A number is a row of characters, each 48 plus five bits, lowest first; 32 says that more follow, and the fifth bit
    of the last is the sign. From the fourth on, a number is the difference from the length two before.

    Raises: FormatError: other characters, a number that does not end or is too long.
    """
    codes = _codes(text, where)
    if len(codes) == 0:
        return np.zeros(0, np.int64)
    last = (codes & _CONTINUATION_BIT) == 0
    ends = np.flatnonzero(last)
    lengths = np.diff(ends, prepend=-1)
    if not last[-1] or lengths.max() > _MAX_DIGITS:
        raise FormatError(f"{where}: expected compressed run lengths, got a number without end")
    place = np.arange(len(codes)) - np.repeat(ends - lengths + 1, lengths)
    digits = (codes & _DIGIT_MASK).astype(np.int64) << (_DIGIT_BITS * place)
    numbers = np.add.reduceat(digits, ends - lengths + 1)
    numbers -= np.where(codes[ends] & _SIGN_BIT, np.int64(1) << (_DIGIT_BITS * lengths), 0)
    numbers[1::2] = np.cumsum(numbers[1::2])
    numbers[2::2] = np.cumsum(numbers[2::2])
    return np.asarray(numbers)


def _codes(text: str, where: str) -> UInt8[np.ndarray, " c"]:
    raw = np.frombuffer(text.encode("utf-8", "replace"), np.uint8)
    codes: np.ndarray = raw - np.uint8(_FIRST_CODE)  # below 48 wraps to above 63
    bad = np.flatnonzero(codes > _DIGIT_MASK + _CONTINUATION_BIT)
    if len(bad):
        raise FormatError(
            f"{where}: expected compressed run lengths, characters '0' to 'o'; got byte {raw[bad[0]]} at {bad[0]}"
        )
    return codes


def fill_polygon(points: Float[np.ndarray, "v 2"], height: int, width: int) -> Bool[np.ndarray, "h w"]:
    """Return the pixels whose centres lie inside a closed polygon, by the even-odd rule.

    points: x, y in pixels; the centre of pixel (0, 0) is at (0.5, 0.5), a centre on a left or upper
    edge is inside. What lies outside the image is cut off. pycocotools rounds the outline to a grid of
    fifths of a pixel instead of testing centres: masks differ from its by pixels on the outline only.
    """
    mask = np.zeros((height, width), bool)
    ends = np.roll(points, -1, axis=0).astype(np.float64)
    begins = points.astype(np.float64)
    top = np.ceil(np.minimum(begins[:, 1], ends[:, 1]) - 0.5).clip(0, height).astype(np.int64)
    bottom = np.ceil(np.maximum(begins[:, 1], ends[:, 1]) - 0.5).clip(0, height).astype(np.int64)
    block = max(1, _BLOCK_CROSSINGS // max(len(points), width))
    for start in range(int(top.min(initial=height)), int(bottom.max(initial=0)), block):
        stop = min(start + block, height)
        spans = top.clip(start, stop), bottom.clip(start, stop)
        mask[start:stop] = _parity(begins, ends, *spans, slice(start, stop), width)
    return mask


def _parity(
    begins: Float[np.ndarray, "v 2"],
    ends: Float[np.ndarray, "v 2"],
    top: Int64[np.ndarray, " v"],
    bottom: Int64[np.ndarray, " v"],
    rows: slice,
    width: int,
) -> Bool[np.ndarray, "r w"]:
    """Return the inside of some rows: pixels with an odd number of edges (each in rows top to bottom) to the left."""
    counts = bottom - top
    edge = np.repeat(np.arange(len(counts)), counts)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + top[edge]
    (x0, y0), (x1, y1) = begins[edge].T, ends[edge].T
    crossing = x0 + (row + 0.5 - y0) / (y1 - y0) * (x1 - x0)
    column = np.ceil(crossing - 0.5).clip(0, width).astype(np.int64)
    shape = (rows.stop - rows.start, width + 1)
    flips = np.bincount((row - rows.start) * shape[1] + column, minlength=shape[0] * shape[1])
    inside: np.ndarray = np.cumsum(flips.reshape(shape), axis=1)[:, :width] % 2 == 1
    return inside
