"""SuperSplat's compressed PLY: 16 bytes per Gaussian, quantised within chunks of 256.

Element `chunk` holds the bounds of positions, log scales and (since SuperSplat 2) colours of 256
consecutive rows of `vertex`, which packs position and scale as 11-10-11 bits, rotation as 2 bits
for the largest component and 10 for each other, colour and opacity as 8 bits each. An optional
element `sh` has one byte per further SH coefficient. Axes and SH order are those of a 3DGS PLY;
rows have been sorted along a Morton curve, so they are not the rows of the PLY it was made from.

Source: PlayCanvas, "Compressed PLY format" (SuperSplat user manual).
"""

import numpy as np

from ..base.arrays import Float32, UInt32
from ..errors import FormatError
from ..scene.gaussians import SH_C0, SH_COEFFICIENTS, Gaussians
from .activation import checked, exp, from_smallest_three
from .gaussian_ply import drawn_as_marked, extra_columns
from .ply import Header, Records, gather, read_elements

CHUNK_ROWS = 256
BLOCK_CHUNKS = 64  # that are unpacked at once
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
POSITION_BOUNDS = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
SCALE_BOUNDS = ("min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z")
COLOUR_BOUNDS = ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b")


def is_compressed(header: Header) -> bool:
    """Return True if the header is that of a compressed PLY: a `vertex` with a packed position."""
    return "vertex" in header.elements and "packed_position" in header.elements["vertex"].names()


def parse_compressed_ply(buffer: memoryview, header: Header) -> Gaussians:
    """Return the Gaussians of a compressed PLY; further properties of `vertex` are kept in `extra`.

    Raises: FormatError: properties missing, elements whose counts do not fit, or rows that are no Gaussians.
    """
    _require(header, "vertex", PACKED, "u4")
    _require(header, "chunk", (*POSITION_BOUNDS, *SCALE_BOUNDS), "f4")
    rest = _rest_names(header)
    tables = read_elements(buffer, header, {"chunk", "vertex", *(["sh"] if rest else [])})
    vertex, chunk = tables["vertex"], tables["chunk"]
    if len(chunk) != -(-len(vertex) // CHUNK_ROWS):
        raise FormatError(f"{len(vertex)} packed Gaussians need a chunk per {CHUNK_ROWS}, got {len(chunk)} chunks")
    colour = _unpack(_packed(vertex, 3), (24, 16, 8, 0), (8, 8, 8, 8))
    means = _unpack(_packed(vertex, 0), (21, 11, 0), (11, 10, 11))
    _within_chunks(means, gather(chunk, POSITION_BOUNDS))
    log_scales = _unpack(_packed(vertex, 2), (21, 11, 0), (11, 10, 11))
    _within_chunks(log_scales, gather(chunk, SCALE_BOUNDS))
    if set(COLOUR_BOUNDS) <= set(chunk.dtype.names or ()):
        _within_chunks(colour[:, :3], gather(chunk, COLOUR_BOUNDS))
    sh = np.empty((len(vertex), 1 + len(rest) // 3, 3), np.float32)
    sh[:, 0] = (colour[:, :3] - 0.5) / SH_C0
    if rest:
        _decode_rest(tables["sh"], rest, sh[:, 1:])
    extra = extra_columns(vertex, set(PACKED))
    scales = exp(log_scales)
    return drawn_as_marked(checked(means, _rotations(vertex), scales, colour[:, 3].copy(), sh, extra), header)


def _require(header: Header, element: str, names: tuple[str, ...], code: str) -> None:
    found = {p.name: p.code for p in header.elements[element].properties} if element in header.elements else {}
    wrong = [name for name in names if found.get(name) != code]
    if wrong:
        raise FormatError(f"compressed PLY: '{element}' must have {', '.join(wrong)} of type {code}")


def _rest_names(header: Header) -> list[str]:
    """Return the names of the coefficients in the memory order of Gaussians.sh, without the constant one."""
    if "sh" not in header.elements:
        return []
    element = header.elements["sh"]
    per_channel = len(element.properties) // 3
    names = [f"f_rest_{channel * per_channel + c}" for c in range(per_channel) for channel in range(3)]
    if 1 + per_channel not in SH_COEFFICIENTS[1:] or set(names) != set(element.names()):
        raise FormatError("compressed PLY: 'sh' must have the properties f_rest_0 onwards, 9, 24 or 45 of them")
    _require(header, "sh", tuple(names), "u1")
    count = header.elements["vertex"].count
    if element.count != count:
        raise FormatError(f"compressed PLY: {element.count} rows of 'sh' for {count} Gaussians")
    return names


def _packed(vertex: Records, which: int) -> UInt32[np.ndarray, " n"]:
    return vertex[PACKED[which]].astype(np.uint32)


def _unpack(
    packed: UInt32[np.ndarray, " n"], shifts: tuple[int, ...], bits: tuple[int, ...]
) -> Float32[np.ndarray, "n c"]:
    """Return bit fields as fractions of their range."""
    result = np.empty((len(packed), len(shifts)), np.float32)
    for column, (shift, width) in enumerate(zip(shifts, bits, strict=True)):
        limit = (1 << width) - 1
        np.divide((packed >> np.uint32(shift)) & np.uint32(limit), limit, out=result[:, column], casting="unsafe")
    return result


def _within_chunks(fractions: Float32[np.ndarray, "n 3"], bounds: Float32[np.ndarray, "c 6"]) -> None:
    """Replace each fraction by the point it marks between the bounds of its row's chunk."""
    for start in range(0, len(bounds), BLOCK_CHUNKS):
        block = fractions[start * CHUNK_ROWS : (start + BLOCK_CHUNKS) * CHUNK_ROWS]
        of_rows = np.repeat(bounds[start : start + BLOCK_CHUNKS], CHUNK_ROWS, axis=0)[: len(block)]
        block[:] = of_rows[:, :3] * (1 - block) + of_rows[:, 3:] * block


def _rotations(vertex: Records) -> Float32[np.ndarray, "n 4"]:
    packed = _packed(vertex, 1)
    three = (_unpack(packed, (20, 10, 0), (10, 10, 10)) - np.float32(0.5)) * np.float32(np.sqrt(2))
    return from_smallest_three(three, packed >> np.uint32(30))


def _decode_rest(table: Records, names: list[str], into: Float32[np.ndarray, "n k 3"]) -> None:
    """Turn bytes into [-4, 4]: 0 and 255 are the ends of it, all others the middle of their step."""
    steps = (np.arange(256, dtype=np.float32) + np.float32(0.5)) / 32 - 4
    steps[[0, 255]] = -4, 4
    for place, name in enumerate(names):
        into[:, place // 3, place % 3] = steps[table[name]]
