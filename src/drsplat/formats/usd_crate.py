"""Counts in the head of binary OpenUSD (`.usdc`), checked before the library allocates what they promise.

Byte 16 says where the table of contents is: a count and, of 32 bytes each, a section's name, start and size. A section
begins with the count of its entries; a second one follows in two of them. Numbers are little-endian, of 8 bytes.

Source: OpenUSD 26.11, pxr/usd/sdf/crateFile.cpp, which is all that describes the format.
"""

import struct

import numpy as np

from ..base.arrays import UInt8
from ..errors import FormatError

HEAD_BYTES, ENTRY_BYTES = 24, 32
MAX_INTEGERS_PER_BYTE = 4 * 255  # LZ4 makes at most 255 bytes of one, with four integers in each
FIRST_COMPRESSED_VERSION = (0, 4)  # the first whose sections are compressed and begin as they do here
TWO_COUNTS = (b"TOKENS", b"PATHS")


def refuse_false_counts(content: UInt8[np.ndarray, " n"]) -> None:
    """Check the counts of a file. Raises: FormatError: one that its bytes have no room for, or a section elsewhere."""
    view = content.data
    if len(view) < HEAD_BYTES:
        raise FormatError(f"the file ends after {len(view)} bytes")
    version, table = tuple(view[8:10]), _number(view, 16)
    if table + 8 > len(view) or _number(view, table) > (len(view) - table - 8) // ENTRY_BYTES:
        raise FormatError(f"no table of contents at byte {table:,} of {len(view):,}")
    for place in range(table + 8, table + 8 + ENTRY_BYTES * _number(view, table), ENTRY_BYTES):
        name, start, size = bytes(view[place : place + 16]).rstrip(b"\0"), *struct.unpack_from("<QQ", view, place + 16)
        counts = 2 if name in TWO_COUNTS and version >= FIRST_COMPRESSED_VERSION else 1
        if start + size > len(view) or size < 8 * counts:
            raise FormatError(f"section {name!r}: {size:,} bytes at byte {start:,} of {len(view):,}")
        most = max(_number(view, start + 8 * number) for number in range(counts))
        if most > MAX_INTEGERS_PER_BYTE * size:
            raise FormatError(f"section {name!r}: {size:,} bytes hold no {most:,} entries")


def _number(view: memoryview, place: int) -> int:
    return int(struct.unpack_from("<Q", view, place)[0])
