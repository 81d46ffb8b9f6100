"""A photo's features in one small file: each map compressed, and only once, beside the embeddings.

LangSplat's files hold 16 bytes for every pixel, four levels of int32; maps are large areas of one number.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zstandard

from ..base.arrays import Array, Embeddings, Int64, LevelMaskIds
from ..errors import FormatError, InputError
from .json_files import as_kind, document_in
from .tensors import check_tensors, read_tensors, write_tensors

FORMAT = "drsplat features 1"
MAX_PIXELS = 1 << 27
"""Most pixels of a map, beyond any photo; it bounds what a file decompresses to."""
_MIN_WIDE_EMBEDDINGS = 1 << 16  # from this number on, ids take 32 bits
_ZSTD_LEVEL = 12  # a third smaller than at its default, and still far quicker than embedding
_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class CompactFile:
    """Content of a compact file; maps are decompressed on demand.

    embeddings: (N, D), as stored. size: height and width of its maps. levels: the number of the map that
    serves each of the four levels, or the only one, of a file without levels.
    """

    path: Path
    embeddings: Embeddings
    size: tuple[int, int]
    levels: tuple[int, ...]
    maps: tuple[Array, ...]

    def count_levels(self) -> int:
        return len(self.levels)

    def ids(self, level: int) -> Int64[Array, "h w"]:
        """Return the row of `embeddings` by pixel, -1: none. Raises: FormatError: damaged, or an id without a row."""
        height, width = self.size
        dtype = _dtype(len(self.embeddings))
        raw = _decompressed(
            self.maps[self.levels[level if len(self.levels) > 1 else 0]], self.path, height * width * dtype.itemsize
        )
        ids = np.frombuffer(raw, dtype).reshape(height, width).astype(np.int64) - 1
        if ids.max() >= len(self.embeddings):
            raise FormatError(f"{self.path}: mask {ids.max()} of {len(self.embeddings)}")
        return ids


def write_compact(path: Path, mask_ids: LevelMaskIds, embeddings: Embeddings, overwrite: bool = False) -> None:
    """Write one photo's features; maps that are alike are kept once.

    Raises: InputError: `path` exists and `overwrite` is false; a map of no or too many pixels.
    """
    planes = mask_ids.reshape(-1, *mask_ids.shape[-2:])
    height, width = planes.shape[1:]
    if not 0 < height * width <= MAX_PIXELS:
        raise InputError(f"mask_ids: expected 1 to {MAX_PIXELS:,} pixels, got {width}x{height}")
    levels = [next(i for i, one in enumerate(planes) if np.array_equal(one, plane)) for plane in planes]
    kept = sorted(set(levels))
    dtype = _dtype(len(embeddings))
    squeeze = zstandard.ZstdCompressor(level=_ZSTD_LEVEL, write_content_size=False).compress
    tensors = {
        f"map_{number}": np.frombuffer(squeeze((planes[index] + 1).astype(dtype).tobytes()), np.uint8)
        for number, index in enumerate(kept)
    }
    about = {
        "format": FORMAT,
        "size": json.dumps([height, width]),
        "levels": json.dumps([kept.index(index) for index in levels]),
    }
    write_tensors(path, {"embeddings": embeddings, **tensors}, about, overwrite)


def read_compact(path: Path) -> CompactFile:
    """Read what `write_compact` wrote, compared with its checksums.

    Raises: InputError: there is no such file. FormatError: damaged, or another kind of file.
    """
    tensors, about = read_tensors(path)
    if about.get("format") != FORMAT:
        raise FormatError(f"{path}: expected '{FORMAT}', got {ascii(about.get('format'))[:60]}")
    size, levels = (_counts(about.get(name), f"{path}: {name}") for name in ("size", "levels"))
    names = [f"map_{number}" for number in range(len(set(levels)))]
    check_tensors(tensors, {"embeddings": ("float32", "n d")} | {name: ("uint8", name) for name in names}, str(path))
    if len(size) != 2 or not 0 < size[0] * size[1] <= MAX_PIXELS or not tensors["embeddings"].shape[1]:
        raise FormatError(f"{path}: expected maps of 1 to {MAX_PIXELS:,} pixels and embeddings, got {list(size)}")
    if len(levels) not in (1, 4) or set(levels) != set(range(len(names))):
        raise FormatError(f"{path}: expected a map for each of four levels, or one, got {list(levels)}")
    return CompactFile(path, tensors["embeddings"], (size[0], size[1]), levels, tuple(tensors[name] for name in names))


def _dtype(num_embeddings: int) -> np.dtype[np.unsignedinteger]:
    """Return the type of ids, which count from 1; 0 is none."""
    return np.dtype("<u2" if num_embeddings < _MIN_WIDE_EMBEDDINGS else "<u4")


def _counts(text: str | None, where: str) -> tuple[int, ...]:
    numbers: tuple[int, ...] = as_kind(document_in(text or "null", where), tuple[int, ...], where)
    if len(numbers) > 4 or not all(0 <= number <= MAX_PIXELS for number in numbers):
        raise FormatError(f"{where}: expected a short list of counts")
    return numbers


def _decompressed(data: Array, path: Path, size: int) -> bytes:
    """Return exactly `size` bytes; memory grows with what is there, not with what is promised."""
    raw = bytearray()
    try:
        with zstandard.ZstdDecompressor().stream_reader(data.tobytes()) as stream:
            while len(raw) <= size and (chunk := stream.read(_CHUNK_BYTES)):
                raw += chunk
    except zstandard.ZstdError as error:
        raise FormatError(f"{path}: damaged: {error}") from None
    if len(raw) != size:
        raise FormatError(f"{path}: damaged: a map of another size than {size} bytes")
    return bytes(raw)
