"""Codebook and codes as the authors of Dr. Splat publish them."""

import os
from typing import NamedTuple

import numpy as np

from ...base.arrays import ByteRows, UnsignedIds
from ...errors import FormatError, InputError
from ...formats.faiss_index import is_faiss, read_faiss_quantizer
from ...scene.encoders import EncoderIdentity
from .codebook import Codebook, Codes, load_codebook


def read_faiss_codebook(path: str | os.PathLike[str], encoder: EncoderIdentity) -> Codebook:
    """Read a codebook from a FAISS index: IndexPQ, or the IndexIVFPQ that Dr. Splat's authors publish.

    Raises: FormatError: another kind of file, or damaged. MismatchError: another dimension than the encoder's.
    """
    quantizer = read_faiss_quantizer(path)
    try:
        return Codebook(*quantizer, encoder)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


def read_codebook(path: str | os.PathLike[str], encoder_name: str | None = None) -> Codebook:
    """Read a codebook of ours or the authors' .faiss file.

    encoder_name: that of the embeddings, which a .faiss file does not name. Raises: as `load_codebook` and
    `read_faiss_codebook`.
    """
    if os.path.splitext(path)[1] != ".faiss" and not is_faiss(path):
        return load_codebook(path)
    centroids = read_faiss_quantizer(path).centroids
    dim = centroids.shape[0] * centroids.shape[2]
    return read_faiss_codebook(path, EncoderIdentity(encoder_name or "unknown", dim))


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
