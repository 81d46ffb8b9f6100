"""Product quantisers out of FAISS index files, without FAISS: it believes every count it reads.

Two kinds: a plain IndexPQ, and IndexIVFPQ (coarse centroids plus coded residuals), which is what
the authors of Dr. Splat publish. Lists of stored vectors, if any, are left alone.
Source: the layout that FAISS's write_index produces (marks "IxPq", "IwPQ").
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import ByteValues, Embeddings, Float32, Numbers
from ..base.contents import AnyPath, file_bytes, open_file
from ..errors import FormatError

_PLAIN = {b"IxPq", b"IxPQ"}
_FLAT = {b"IxFI", b"IxF2", b"IxFl"}
MARKS = (b"Ix", b"Iw", b"IB", b"IH")  # first bytes of the names of FAISS's kinds
_MAX_FILE_BYTES = 1 << 31


class FaissQuantizer(NamedTuple):
    """coarse: None, or the centroids whose residuals are coded."""

    centroids: Float32[np.ndarray, "L c d"]
    coarse: Embeddings | None


class _Bytes:
    """A cursor that refuses to read past the end."""

    def __init__(self, content: ByteValues, path: Path) -> None:
        self._content, self._path, self._at = content, path, 0

    def take(self, count: int) -> bytes:
        if count > len(self._content) - self._at:
            raise FormatError(f"{self._path}: truncated FAISS index: {count} bytes wanted at byte {self._at}")
        self._at += count
        return self._content[self._at - count : self._at].tobytes()

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def floats(self, count: int) -> Numbers:
        return np.frombuffer(self.take(4 * count), "<f4")


def is_faiss(path: AnyPath) -> bool:
    """Return whether a file begins with the mark of a FAISS index of any kind."""
    try:
        with open_file(path) as file:
            mark = file.read(4)
    except OSError:
        return False
    return len(mark) == 4 and mark[:2] in MARKS and mark.isalnum()


def read_faiss_quantizer(path: AnyPath) -> FaissQuantizer:
    """Read the centroids of the index in `path`.

    Raises: InputError: there is no such file. FormatError: another kind of index, damaged, not 8
    bits per code, or centroids that are not finite.
    """
    path = Path(path)
    content = file_bytes(path)
    if content.size > _MAX_FILE_BYTES:
        raise FormatError(f"{path}: no product quantiser is that large")
    source = _Bytes(content, path)
    kind = source.take(4)
    if kind in _PLAIN:
        dim, coarse = _index_header(source), None
    elif kind == b"IwPQ":
        dim, coarse = _inverted_file(source, path)
    else:
        raise FormatError(f"{path}: expected a FAISS IndexPQ or IndexIVFPQ, got the mark {kind!r}")
    given, subvectors, bits, count = (source.number(8) for _ in range(4))
    if given != dim or not 1 <= subvectors <= dim or dim % subvectors:
        raise FormatError(f"{path}: {subvectors} sub-vectors of {given} numbers in an index of {dim}")
    if bits != 8:
        raise FormatError(f"{path}: expected 8 bits per sub-vector, got {bits}")
    if count != 256 * dim:
        raise FormatError(f"{path}: expected {256 * dim} centroid numbers, got {count}")
    centroids = source.floats(count).reshape(subvectors, 256, dim // subvectors)
    for values in (centroids, coarse):
        if values is not None and not np.isfinite(values).all():
            raise FormatError(f"{path}: centroids must be finite")
    return FaissQuantizer(centroids, coarse)


def _index_header(source: _Bytes) -> int:
    dim = source.number(4)
    source.take(8 + 16 + 1)  # number of vectors, two unused words, is_trained
    if source.number(4) > 1:  # metrics beyond inner product and L2 have an argument
        source.take(4)
    return dim


def _inverted_file(source: _Bytes, path: Path) -> tuple[int, Embeddings | None]:
    """Return the dimension and coarse centroids; None where codes are of the vectors themselves."""
    dim = _index_header(source)
    lists = source.number(8)
    source.take(8)  # nprobe
    kind = source.take(4)
    if kind not in _FLAT:
        raise FormatError(f"{path}: expected a flat coarse quantiser, got the mark {kind!r}")
    if (given := _index_header(source)) != dim:
        raise FormatError(f"{path}: coarse centroids of {given} numbers in an index of {dim}")
    count = source.number(8)
    if count != lists * dim:
        raise FormatError(f"{path}: {lists} lists of {dim} numbers announced, {count} numbers stored")
    coarse = source.floats(count).reshape(lists, dim)
    direct_map = source.number(1)
    source.take(8 * source.number(8))
    if direct_map == 2:
        source.take(16 * source.number(8))
    by_residual = source.number(1)
    source.take(8)  # code size
    return dim, coarse if by_residual else None
