"""Writing SPZ, version 3 (one gzip stream of quantised planes) and version 4 (a zstd stream of each plane).

Values keep the format's own precision: opacities and colours 8 bits, scales 1/16 of a natural logarithm, rotations
9 bits a component, positions 24 bits over the extent of the scene.

Version 4 has room for extensions: the object of each Gaussian, its relevancy, names and boxes travel in one, which
other readers step over. Version 3, which more viewers read, has none.

Source: github.com/nianticlabs/spz, README "File Format" and extensions/README.
"""

import gzip
import io
import struct

import numpy as np

from ..base.arrays import Array, Quats, UInt8
from ..errors import FormatError, InputError
from ..scene.gaussians import SH_COEFFICIENTS, Gaussians
from ..scene.labelled import LabelledScene
from .labels import has_labels, labels_bytes
from .spz import (
    ANTIALIASED,
    COLOUR_SCALE,
    HAS_EXTENSIONS,
    HEADER_BYTES,
    MAGIC,
    OBJECTS,
    PARITIES,
    PREFIX,
    refuse_implausible,
)

VERSION, VERSION_4 = 3, 4
ZSTD_LEVEL = 12
MAX_FIXED_POSITION = (1 << 23) - 1  # in units of 2**-fractional_bits
MAX_FRACTIONAL_BITS = 24
TO_RUB = np.array([1, -1, -1], np.float32)  # a PLY's axes are right, down, front; SPZ has right, up, back


def spz_bytes(gaussians: Gaussians, degree: int | None = None) -> bytes:
    """Encode a scene as SPZ, rows in their order.

    Args:
        gaussians: the scene; positions are written relative to its `origin`.
        degree: of the harmonics that are written, None for all that the scene has.

    Raises: InputError: a scene without Gaussians or too wide for the format, a degree that the scene has not.
    """
    planes = _planes(gaussians, gaussians.sh_degree if degree is None else degree, VERSION, 0)
    out = io.BytesIO()
    with gzip.GzipFile(fileobj=out, mode="wb", compresslevel=6, mtime=0) as stream:  # the same bytes at any time
        for plane in planes:
            stream.write(plane)
    return out.getvalue()


def spz4_bytes(scene: LabelledScene) -> bytes:
    """Encode a scene as SPZ of version 4, with its objects in an extension, rows in their order.

    Raises: InputError: a scene without Gaussians or too wide for the format.
    """
    import zstandard

    gaussians = scene.gaussians
    extension = _extension(scene) if has_labels(scene) else b""
    flags = HAS_EXTENSIONS if extension else 0
    prefix, *planes = _planes(gaussians, gaussians.sh_degree, VERSION_4, flags, 5 + bool(gaussians.sh_degree))
    coder = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
    kept = [plane for plane in planes if plane]
    streams = [coder.compress(plane) for plane in kept]
    table = b"".join(struct.pack("<QQ", len(s), len(p)) for s, p in zip(streams, kept, strict=True))
    head = struct.pack("<I12x", HEADER_BYTES + len(extension))
    return b"".join([prefix, head, extension, table, *streams])


def _extension(scene: LabelledScene) -> bytes:
    """Encode objects as a record of drsplat's: sizes of three parts, and these, in a zstd stream.

    Raises: InputError: names that are so long and alike that a reader would take them for a decompression bomb.
    """
    import zstandard

    parts = [
        b"" if (numbers := scene.object_numbers) is None else numbers.astype("<i4").tobytes(),
        b"" if scene.relevancy is None else scene.relevancy.astype("<f4").tobytes(),
        labels_bytes(scene),
    ]
    payload = struct.pack("<3Q", *map(len, parts)) + zstandard.ZstdCompressor(ZSTD_LEVEL).compress(b"".join(parts))
    try:
        refuse_implausible(len(parts[-1]), len(payload))
    except FormatError:
        raise InputError(
            f"the names of {len(scene.things):,} objects are long and alike, {len(parts[-1]):,} bytes: files of such "
            "cannot be told from damaged ones; shorten them, or write GLB"
        ) from None
    return struct.pack("<II", OBJECTS, len(payload)) + payload


def _planes(gaussians: Gaussians, degree: int, version: int, flags: int, streams: int = 0) -> tuple[bytes, ...]:
    """Return the first 16 bytes and the planes in their order."""
    if not 0 <= degree <= gaussians.sh_degree:
        raise InputError(f"degree: expected 0 to {gaussians.sh_degree}, which the scene has, got {degree}")
    # The number of fractional bits with which the farthest position still fits into 24
    farthest = float(np.abs(gaussians.means).max(initial=0))
    if not len(gaussians) or farthest > MAX_FIXED_POSITION:
        raise InputError(
            f"SPZ holds positions within {MAX_FIXED_POSITION:,} units of the scene's origin, got {len(gaussians):,} "
            f"Gaussians up to {farthest:,.0f} away: leave out what lies far off"
        )
    spare = np.log2(MAX_FIXED_POSITION / farthest) if farthest > 0 else MAX_FRACTIONAL_BITS
    bits = int(np.clip(np.floor(spare), 0, MAX_FRACTIONAL_BITS))
    flags |= ANTIALIASED if gaussians.antialiased else 0
    whole = np.rint((gaussians.means * TO_RUB).astype(np.float64) * 2.0**bits).astype("<i4")
    # quantise coefficients, with those negated that are odd in the axes which SPZ turns
    rest = gaussians.sh[:, 1 : SH_COEFFICIENTS[degree]]
    signs = np.array([(-1) ** (name.count("y") + name.count("z")) for name in PARITIES[: rest.shape[1]]], np.float32)
    return (
        PREFIX.pack(MAGIC, version, len(gaussians), degree, bits, flags, streams),
        np.ascontiguousarray(whole.view(np.uint8).reshape(-1, 3, 4)[:, :, :3]).reshape(-1, 9).tobytes(),
        _byte(gaussians.opacities * 255).tobytes(),
        _byte((gaussians.sh[:, 0] * COLOUR_SCALE + 0.5) * 255).tobytes(),
        _byte((np.log(gaussians.scales) + 10) * 16).tobytes(),
        _smallest_three(gaussians.quats * np.array([1, *TO_RUB], np.float32)).tobytes(),
        _byte(rest * signs[None, :, None] * 128 + 128).tobytes(),
    )


def _smallest_three(quats: Quats) -> Array:
    """Pack (w, x, y, z): sign and 9 bits of each but the largest, whose index among (x, y, z, w) is on top."""
    xyzw = quats[:, [1, 2, 3, 0]]
    largest = np.abs(xyzw).argmax(1)
    rows = np.arange(len(xyzw))
    negative = (xyzw < 0) != (xyzw[rows, largest] < 0)[:, None]  # the largest is taken as positive
    sizes = np.minimum(np.rint(np.abs(xyzw) * (511 * np.sqrt(2))), 511).astype(np.uint32)
    packed = largest.astype(np.uint32)
    for component in range(4):
        written = (packed << 10) | (negative[:, component].astype(np.uint32) << 9) | sizes[:, component]
        packed = np.where(largest == component, packed, written)
    return packed.astype("<u4")


def _byte(values: Array) -> UInt8[Array, "..."]:
    return np.asarray(np.clip(np.rint(values), 0, 255)).astype(np.uint8)
