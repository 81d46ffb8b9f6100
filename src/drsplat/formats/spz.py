"""Niantic's SPZ, versions 2 and 3 (one gzip stream) and 4 (plain header, zstd streams).

Planes, in this order: positions 3 x int24 fixed point, opacities u8, colours 3 x u8, log scales 3 x
u8 as byte / 16 - 10, rotations, SH coefficients u8 as byte / 128 - 1 with channels innermost.
Rotations are (x, y, z) as 3 x u8 with w >= 0 left out (version 2), or the smallest three of (x, y,
z, w) as sign and 9 bits each with the index of the largest on top (3 and 4).

Axes: SPZ stores RUB (x right, y up, z back), a PLY's are RDF (x right, y down, z front), and what drsplat holds is
always RDF: reading negates y and z of the positions, of the rotation axes, and of the SH coefficients that are odd in
them. A file that names its axes (extension 0xADBE0003) is believed. Files that `gsply` writes hold the PLY's axes and
do not say so: they come out turned by 180 degrees about x, as in every reader that follows the specification.

Source: github.com/nianticlabs/spz, README "File Format" and extensions/README.

Decompression cannot be made to explode: a size is believed only while it is plausible for the bytes that are there, at
most 1 MiB plus 100 times their number. (Real scenes compress 1 to 3 times, and five times if all their SH are zero;
gzip can reach 1,030 and zstd far more, on zeros only.) That holds for a file, not for each stream of it: all SH of a
scene may be zero. Nothing is ever decompressed beyond that size. Source: RFC 1952 (gzip), RFC 8878 (zstd).
"""

import gzip
import io
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.arrays import Array, Arrays, Float32, Harmonics, Quats, UInt8
from ..base.contents import file_bytes
from ..errors import FormatError, warn
from ..scene.gaussians import Gaussians
from .activation import checked, exp, from_smallest_three
from .labels import Labels, parse_labels

FREE_UNPACKED_BYTES = 1 << 20
MAX_COMPRESSION_RATIO = 100
MAX_EXTENSION_BYTES = 1 << 20
GZIP_MAGIC = b"\x1f\x8b"


MAGIC = b"NGSP"
PREFIX = struct.Struct("<4sIIBBBB")
HEADER_BYTES = 32
ANTIALIASED, HAS_EXTENSIONS, HAS_LOD_TREE = 0x01, 0x02, 0x80
COORDINATE_SYSTEM = 0xADBE0003
OBJECTS = 0xD25B0001  # drsplat's own extension: object and relevancy of each Gaussian, names and boxes
OBJECT_SIZES = struct.Struct("<3Q")
COLOUR_SCALE = 0.15
REST_COEFFICIENTS = (0, 3, 8, 15, 24)
# Sign of each SH basis function, degrees 1 to 3, as powers of the signs of x, y and z.
PARITIES = ["y", "z", "x", "xy", "yz", "", "xz", "", "y", "xyz", "y", "z", "x", "z", "x"]


@dataclass(frozen=True)
class SpzHeader:
    """The first 16 bytes; `streams` is reserved before version 4."""

    version: int
    count: int
    degree: int
    fractional_bits: int
    flags: int
    streams: int

    def plane_bytes(self) -> list[int]:
        """Return the size of each plane, in order."""
        rotation = 3 if self.version == 2 else 4
        return [self.count * size for size in (9, 1, 3, 3, rotation, 3 * REST_COEFFICIENTS[self.degree])]


def parse_spz(buffer: memoryview) -> Gaussians:
    """Return the Gaussians of an SPZ file, in the axes of a PLY (RDF).

    Degree-4 coefficients are left out with a DrSplatWarning.

    Raises: FormatError: damaged or truncated, an unknown version, a size its header makes
    implausible (see `spz`), a level-of-detail tree, or rows that are no Gaussians.
    """
    planes, extensions, header = _planes(buffer)
    positions, alphas, colours, scales, rotations, rest = planes
    n = header.count
    # The factors of x, y, z that turn the stored axes, by default RUB, into RDF
    system = int.from_bytes(extensions.get(COORDINATE_SYSTEM, b"")[:4], "little") or 4
    if system > 8:
        raise FormatError(f"SPZ stores axes {system}, with y and z exchanged: convert it to RUB (4) first")
    # Bits of system - 1: right, up, front. RDF is right, not up, front.
    stored = [(system - 1) >> bit & 1 for bit in range(3)]
    signs = np.where(np.array(stored) == (1, 0, 1), 1, -1).astype(np.float32)
    if header.degree > 3:
        warn("SH coefficients of degree 4 (9 per channel) were left out", 3)
    log_scales = scales.reshape(n, 3).astype(np.float32) / 16 - 10
    turn = np.array([1, *(signs.prod() * signs)], np.float32)  # (w, x, y, z) of F R F for a diagonal F
    wide = np.zeros((len(positions) // 3, 4), np.uint8)
    wide[:, 1:] = positions.reshape(-1, 3)  # the upper 24 bits, so that shifting down extends the sign
    fixed = wide.view("<i4").reshape(-1, 3) >> 8
    return checked(
        np.ldexp(fixed.astype(np.float32), -header.fractional_bits) * signs,
        (_first_three if header.version == 2 else _smallest_three)(rotations) * turn,
        exp(log_scales),
        alphas.astype(np.float32) / 255,
        _harmonics(colours, rest, header, signs),
        _objects(extensions, n)[0],
        antialiased=bool(header.flags & ANTIALIASED),
    )


def read_spz_labels(path: Path) -> Labels:
    """Return the names and boxes that drsplat wrote into an SPZ of version 4; none in other files.

    Raises: FormatError: a damaged file, or labels that are none.
    """
    _, extensions, header = _planes(file_bytes(path).data)
    content = _objects(extensions, header.count)[1]
    return parse_labels(content, f"{path}: extension") if content else Labels()


def _objects(extensions: dict[int, bytes], count: int) -> tuple[Arrays, bytes]:
    """Return the columns of drsplat's extension, and its labels as JSON; neither where there is none."""
    payload = extensions.get(OBJECTS)
    if payload is None:
        return {}, b""
    if len(payload) < OBJECT_SIZES.size:
        raise FormatError("SPZ: drsplat's extension is truncated")
    sizes = OBJECT_SIZES.unpack_from(payload)
    if any(size not in (0, 4 * count) for size in sizes[:2]):
        raise FormatError(f"SPZ: expected objects of {count} Gaussians, got {sizes[0]} and {sizes[1]} bytes")
    refuse_implausible(sizes[2], len(payload))  # the others are as plausible as the count
    content = unzstd(memoryview(payload)[OBJECT_SIZES.size :], sum(sizes))
    ids, relevancy = content[: sizes[0]], content[sizes[0] : sizes[0] + sizes[1]]
    columns = {"object_id": np.frombuffer(ids, "<i4").copy(), "relevancy": np.frombuffer(relevancy, "<f4").copy()}
    return {name: column for name, column in columns.items() if len(column)}, content[sizes[0] + sizes[1] :]


def _records(raw: bytes) -> dict[int, bytes]:
    """Return the extensions by kind."""
    found: dict[int, bytes] = {}
    offset = 0
    while offset + 8 <= len(raw):
        kind, length = struct.unpack_from("<II", raw, offset)
        found[kind] = raw[offset + 8 : offset + 8 + length]
        offset += 8 + length
    return found


Planes = tuple[list[UInt8[Array, " _"]], dict[int, bytes], SpzHeader]


def _planes(buffer: memoryview) -> Planes:
    if bytes(buffer[:4]) == MAGIC and _header(bytes(buffer[: PREFIX.size])).version == 4:
        return _separate(buffer)
    return _concatenated(buffer)


def _header(raw: bytes) -> SpzHeader:
    if raw.startswith((b"ply\n", b"ply\r")):
        raise FormatError("a PLY packed by gzip, taken for an SPZ: unpack it first, with gunzip")
    if len(raw) != PREFIX.size or raw[:4] != MAGIC:
        raise FormatError("no SPZ: its 16-byte header does not begin with 'NGSP'")
    header = SpzHeader(*PREFIX.unpack(raw)[1:])
    if header.version not in (2, 3, 4):
        raise FormatError(f"SPZ version {header.version}; versions 2, 3 and 4 can be read: save it again as one")
    if header.degree >= len(REST_COEFFICIENTS) or header.fractional_bits > 24:
        raise FormatError(
            f"SPZ header is damaged: SH degree {header.degree} (at most 4), "
            f"{header.fractional_bits} fractional bits (at most 24)"
        )
    if header.flags & HAS_LOD_TREE:
        raise FormatError("SPZ holds a level-of-detail tree, the scene several times over: export it without LOD")
    return header


def _concatenated(buffer: memoryview) -> Planes:
    """Read versions 2 and 3: the header, all planes and perhaps extensions in one gzip stream, or without one."""
    is_packed = bytes(buffer[:2]) == GZIP_MAGIC
    stream = gzip.GzipFile(fileobj=io.BytesIO(buffer)) if is_packed else io.BytesIO(buffer)
    try:
        raw = stream.read(PREFIX.size)
        header = _header(raw)
        if header.version == 4:
            raise FormatError("SPZ version 4 inside gzip: decompress the file first")
        sizes = header.plane_bytes()
        size = PREFIX.size + sum(sizes)
        if is_packed:
            refuse_implausible(size, len(buffer))
        raw += stream.read(sum(sizes))
        tail = stream.read(MAX_EXTENSION_BYTES)
        is_whole = not stream.read(1)
    except (EOFError, OSError, zlib.error) as error:
        raise FormatError(f"gzip stream is damaged: {error}") from None
    if len(raw) < size or not is_whole:
        raise FormatError(f"SPZ is truncated or damaged: its header promises {size} bytes, it holds {len(raw)}")
    if tail.strip(b"\0") and not header.flags & HAS_EXTENSIONS:  # zeros are padding
        raise FormatError(f"SPZ holds {len(tail)} bytes more than {header.count} Gaussians: its header is damaged")
    whole = np.frombuffer(raw, np.uint8, sum(sizes), PREFIX.size)
    return np.split(whole, np.cumsum(sizes)[:-1]), _records(tail), header


def _separate(buffer: memoryview) -> Planes:
    """Read version 4: header, extensions, table of contents, a zstd stream per plane that has bytes."""
    if len(buffer) < HEADER_BYTES:
        raise FormatError("SPZ is truncated in its header")
    header = _header(bytes(buffer[: PREFIX.size]))
    (contents,) = struct.unpack_from("<I", buffer, PREFIX.size)
    sizes = header.plane_bytes()
    stored = [size for size in sizes if size]
    offset = contents + 16 * header.streams
    if header.streams != len(stored) or contents < HEADER_BYTES or offset > len(buffer):
        raise FormatError(
            f"SPZ header is damaged: {header.streams} streams for {len(stored)} planes, table of "
            f"contents at byte {contents}"
        )
    refuse_implausible(sum(sizes), len(buffer))
    planes = []
    # Of bytes: CPython 3.11 crashes when an unfinished iter_unpack of a memoryview is collected in a
    # cycle, as the traceback of an error makes one.
    table = struct.iter_unpack("<QQ", bytes(buffer[contents:offset]))
    for size in sizes:
        compressed, promised = next(table) if size else (0, 0)
        if promised != size or offset + compressed > len(buffer):
            raise FormatError(f"SPZ is truncated or damaged: a stream of {promised} bytes, expected {size}")
        planes.append(np.frombuffer(unzstd(buffer[offset : offset + compressed], size), np.uint8))
        offset += compressed
    if bytes(buffer[offset : offset + MAX_EXTENSION_BYTES]).strip(b"\0") or len(buffer) - offset > MAX_EXTENSION_BYTES:
        raise FormatError(f"SPZ holds {len(buffer) - offset} bytes after its last stream: its header is damaged")
    extensions = _records(bytes(buffer[HEADER_BYTES:contents])) if header.flags & HAS_EXTENSIONS else {}
    return planes, extensions, header


def _first_three(plane: UInt8[Array, " _"]) -> Quats:
    xyz = plane.reshape(-1, 3).astype(np.float32) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(1 - np.einsum("ni,ni->n", xyz, xyz), 0))
    return np.column_stack([w, xyz])


def _smallest_three(plane: UInt8[Array, " _"]) -> Quats:
    packed = plane.view("<u4").astype(np.uint32)
    fields = (packed[:, None] >> np.array([20, 10, 0], np.uint32)) & np.uint32(1023)
    magnitudes = (fields & np.uint32(511)).astype(np.float32) * np.float32(np.sqrt(0.5) / 511)
    three = np.where(fields >> np.uint32(9), -magnitudes, magnitudes)
    return from_smallest_three(three, packed >> np.uint32(30))[:, [3, 0, 1, 2]]


def _harmonics(
    colours: UInt8[Array, " _"], rest: UInt8[Array, " _"], header: SpzHeader, signs: Float32[Array, "3"]
) -> Harmonics:
    n = header.count
    kept = min(REST_COEFFICIENTS[header.degree], len(PARITIES))
    sh = np.empty((n, 1 + kept, 3), np.float32)
    sh[:, 0] = (colours.reshape(n, 3).astype(np.float32) / 255 - np.float32(0.5)) / np.float32(COLOUR_SCALE)
    x, y, z = signs
    flips = np.array([np.prod([{"x": x, "y": y, "z": z}[a] for a in axes]) for axes in PARITIES], np.float32)
    stored = rest.reshape(n, REST_COEFFICIENTS[header.degree], 3)[:, :kept]
    np.multiply(stored.astype(np.float32) / 128 - 1, flips[:kept, None], out=sh[:, 1:])
    return sh


def refuse_implausible(size: int, compressed: int) -> None:
    """Check a size. Raises: FormatError: `size` bytes cannot honestly come of `compressed` ones."""
    limit = FREE_UNPACKED_BYTES + MAX_COMPRESSION_RATIO * compressed
    if size > limit:
        raise FormatError(
            f"{compressed} compressed bytes claim to hold {size}, more than the {limit} that are "
            "plausible: the header is damaged, or this is a decompression bomb"
        )


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
