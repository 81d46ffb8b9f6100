"""Codebook and codes as the authors of Dr. Splat publish them."""

import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...base.arrays import ByteRows, UnsignedIds
from ...base.contents import AnyPath
from ...errors import FormatError, InputError
from ...formats.faiss_index import FaissQuantizer, is_faiss, read_faiss_quantizer
from ...scene.encoders import EncoderIdentity
from .codebook import Codebook, Codes, load_codebook


def read_faiss_codebook(path: AnyPath, encoder: EncoderIdentity) -> Codebook:
    """Read a codebook from a FAISS index: IndexPQ, or the IndexIVFPQ that Dr. Splat's authors publish.

    Raises: FormatError: another kind of file, or damaged. MismatchError: another dimension than the encoder's.
    """
    return _codebook(path, read_faiss_quantizer(path), encoder)


def _codebook(path: AnyPath, quantizer: FaissQuantizer, encoder: EncoderIdentity) -> Codebook:
    try:
        return Codebook(*quantizer, encoder)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


class CodebookFormat(NamedTuple):
    """A format of codebooks. tells: whether a file is one. read: it, given the name of the embeddings' encoder."""

    tells: Callable[[AnyPath], bool]
    read: Callable[[AnyPath, str | None], Codebook]


def _read_nameless(path: AnyPath, encoder_name: str | None) -> Codebook:
    quantizer = read_faiss_quantizer(path)
    dim = quantizer.centroids.shape[0] * quantizer.centroids.shape[2]
    return _codebook(path, quantizer, EncoderIdentity(encoder_name or "unknown", dim))


FORMATS = (
    CodebookFormat(lambda path: os.path.splitext(path)[1] == ".faiss" or is_faiss(path), _read_nameless),
    CodebookFormat(lambda _: True, lambda path, _: load_codebook(path)),
)


def read_codebook(path: AnyPath, encoder_name: str | None = None) -> Codebook:
    """Read a codebook of ours or the authors' .faiss file.

    encoder_name: that of the embeddings, which a .faiss file does not name. Raises: as `load_codebook` and
    `read_faiss_codebook`.
    """
    return next(one for one in FORMATS if one.tells(path)).read(path, encoder_name)


def official_bytes(codes: Codes) -> ByteRows:
    """Return residual codes as the authors' files hold them: list id (two bytes, little-endian), codes."""
    if codes.coarse_ids is None:
        raise InputError("plain codes have no official form: encode with the authors' codebook")
    return np.hstack([codes.coarse_ids.astype("<u2")[:, None].view(np.uint8), codes.codes])


class OfficialRows(NamedTuple):
    """Rows of an official file. ids: the rows that hold a code, ascending. codes: theirs."""

    ids: UnsignedIds
    codes: Codes


def from_official_bytes(rows: ByteRows, codebook: Codebook) -> OfficialRows:
    """Return the codes of the authors' files; rows of 255, their mark for "no feature", are left out.

    Raises: InputError: a plain codebook. FormatError: rows of another length, or a list id that the
    codebook does not have.
    """
    if codebook.coarse is None:
        raise InputError("official codes are residuals: read the authors' .faiss file for their codebook")
    if rows.ndim != 2 or rows.shape[1] != 2 + codebook.num_subvectors:
        raise FormatError(f"expected rows of {2 + codebook.num_subvectors} bytes, got {rows.shape}")
    ids = np.flatnonzero((rows != 255).any(1)).astype(np.uint32)
    coarse_ids = np.ascontiguousarray(rows[ids, :2]).view("<u2")[:, 0].astype(np.uint16)
    bad = np.flatnonzero(coarse_ids >= len(codebook.coarse))
    if len(bad):
        raise FormatError(
            f"row {ids[bad[0]]} names list {coarse_ids[bad[0]]} of {len(codebook.coarse)}: these "
            "codes were made with another codebook, or are damaged"
        )
    return OfficialRows(ids, Codes(np.ascontiguousarray(rows[ids, 2:]), coarse_ids))
