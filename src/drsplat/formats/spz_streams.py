"""Decompression that cannot be made to explode.

A size is believed only while it is plausible for the bytes that are there: at most 1 MiB plus 100 times their number.
(Real scenes compress 1 to 3 times, and five times if all their SH are zero; gzip can reach 1,030 and zstd far more, on
zeros only.) That holds for a file, not for each stream of it: all SH of a scene may be zero. Nothing is ever
decompressed beyond that size.

Source: RFC 1952 (gzip), RFC 8878 (zstd).
"""

import zlib
from collections.abc import Callable

from ..errors import FormatError

FREE_UNPACKED_BYTES = 1 << 20
MAX_COMPRESSION_RATIO = 100
MAX_EXTENSION_BYTES = 1 << 20
GZIP_MAGIC = b"\x1f\x8b"


def refuse_implausible(size: int, compressed: int) -> None:
    """Check a size. Raises: FormatError: `size` bytes cannot honestly come of `compressed` ones."""
    limit = FREE_UNPACKED_BYTES + MAX_COMPRESSION_RATIO * compressed
    if size > limit:
        raise FormatError(
            f"{compressed} compressed bytes claim to hold {size}, more than the {limit} that are "
            "plausible: the header is damaged, or this is a decompression bomb"
        )


def gunzipped(buffer: memoryview, start_bytes: int, payload_bytes: Callable[[bytes], int]) -> tuple[bytes, bytes]:
    """Decompress the payload, whose size `payload_bytes` tells from its start, and up to 1 MiB behind it.

    A `buffer` that is not gzip is taken as the payload itself.

    Raises: FormatError: no whole gzip stream, an implausible size, or a payload shorter than it says.
    """
    if bytes(buffer[:2]) != GZIP_MAGIC:
        size = payload_bytes(bytes(buffer[:start_bytes]))
        raw, tail = (bytes(buffer[: min(size, len(buffer))]), bytes(buffer[size : size + MAX_EXTENSION_BYTES + 1]))
        whole = len(buffer) <= size + MAX_EXTENSION_BYTES
    else:
        try:
            start, _ = _unzipped(buffer, start_bytes)
            size = payload_bytes(start)
            refuse_implausible(size, len(buffer))
            raw, whole = _unzipped(buffer, size + MAX_EXTENSION_BYTES)
            raw, tail = raw[:size], raw[size:]
        except zlib.error as error:
            raise FormatError(f"gzip stream is damaged: {error}") from None
    if len(raw) < size or not whole:
        raise FormatError(f"SPZ is truncated or damaged: its header promises {size} bytes, it holds {len(raw)}")
    return raw, tail


def _unzipped(buffer: memoryview, most: int) -> tuple[bytes, bool]:
    """Return at most so many bytes of a gzip file, of one member after another, and whether that is all of it.

    Zeros behind the last member are padding, as tapes and buffers of fixed length have it.
    """
    parts, left = [], most
    while True:
        stream = zlib.decompressobj(wbits=31)
        parts.append(stream.decompress(buffer, left) if left else b"")
        left -= len(parts[-1])
        rest = stream.unused_data
        if not stream.eof or not rest.strip(b"\0"):
            return b"".join(parts), stream.eof
        buffer = memoryview(rest)


def unzstd(compressed: memoryview, size: int) -> bytes:
    """Return one zstd frame of exactly `size` bytes, which the caller finds plausible; no frame for none.

    Raises: FormatError: damaged, or another size than `size`.
    """
    if size == 0:
        return b""
    import zstandard

    try:
        declared = zstandard.frame_content_size(compressed)
        if declared not in (-1, size):  # -1: not stored in the frame
            raise FormatError(f"SPZ is damaged: a zstd frame of {declared} bytes where {size} were expected")
        raw = zstandard.ZstdDecompressor().decompress(compressed, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise FormatError(f"zstd stream is damaged: {error}") from None
    if len(raw) != size:
        raise FormatError(f"SPZ is damaged: a zstd stream of {len(raw)} bytes where {size} were expected")
    return bytes(raw)
