"""Product quantisation: a feature as one byte per sub-vector.

A plain codebook is the paper's. A residual one (`coarse` is not None) is what its authors publish: a
code is then a coarse centroid's index plus the bytes of what that centroid leaves over.
Source: Dr. Splat Sec. B; Jegou et al. 2011.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Integer, UInt8, UInt16, UInt32

from .encoders import EncoderIdentity
from .errors import FormatError, InputError, MismatchError
from .formats.faiss_index import read_faiss_quantizer
from .formats.tensors import map_tensors, write_tensors
from .kernels import pq_encode, pq_scores
from .kernels.algebra import CENTROIDS
from .kmeans import train_centroids

BLOCK = 8192  # rows worked on at once: bounds what is decoded
TRAINING_POINTS = 64 * CENTROIDS
OFFICIAL_BYTES = 130
CODEBOOK_FORMAT = "drsplat codebook 1"


class Codes(NamedTuple):
    """codes: a centroid per sub-vector. coarse_ids: a coarse centroid per row, or None (plain)."""

    codes: UInt8[np.ndarray, "n L"]
    coarse_ids: UInt16[np.ndarray, " n"] | None = None

    def rows(self, index: slice | Integer[np.ndarray, " m"]) -> "Codes":
        return Codes(self.codes[index], None if self.coarse_ids is None else self.coarse_ids[index])


@dataclass(frozen=True, eq=False)
class Codebook:
    """What turns features into codes and back; fits every scene seen by the same encoder.

    Raises: InputError: shapes disagree, or values are not finite. MismatchError: another dimension
    than the encoder's.
    """

    centroids: Float32[np.ndarray, "L c d"]
    coarse: Float32[np.ndarray, "C D"] | None
    encoder: EncoderIdentity

    def __post_init__(self) -> None:
        shape = self.centroids.shape
        if (
            len(shape) != 3
            or shape[1] != CENTROIDS
            or 0 in shape
            or self.centroids.dtype != np.float32
        ):
            raise InputError(
                f"centroids: expected float32 (L, {CENTROIDS}, D / L), got {self.centroids.dtype} {shape}"
            )
        if self.dim != self.encoder.dim:
            raise MismatchError(
                f"codebook of {self.dim} numbers for the encoder {self.encoder.name} of {self.encoder.dim}: "
                "train or read one made with this encoder"
            )
        coarse = self.coarse
        if coarse is not None and not (
            coarse.ndim == 2
            and coarse.shape[1] == self.dim
            and 1 <= len(coarse) <= 65535
            and coarse.dtype == np.float32
        ):
            raise InputError(
                f"coarse: expected float32 (1 to 65535, {self.dim}), got {coarse.dtype} {coarse.shape}"
            )
        if not all(
            np.isfinite(part).all() for part in (self.centroids, coarse) if part is not None
        ):
            raise InputError("centroids must be finite")

    @property
    def num_subvectors(self) -> int:
        return len(self.centroids)

    @property
    def dim(self) -> int:
        return self.centroids.shape[0] * self.centroids.shape[2]

    @cached_property
    def hash(self) -> str:
        """Of everything in it: two codebooks with one hash give a code the same meaning."""
        digest = hashlib.blake2b(digest_size=16)
        shapes = [self.centroids.shape, None if self.coarse is None else self.coarse.shape]
        identity = [self.encoder.name, self.encoder.dim, self.encoder.weights]
        digest.update(json.dumps([shapes, identity]).encode())
        for part in (self.centroids, self.coarse):
            if part is not None:
                digest.update(np.ascontiguousarray(part).data)
        return digest.hexdigest()

    def encode(self, features: Float32[np.ndarray, "n D"], *, threads: int = 0) -> Codes:
        """The nearest code of each feature; blockwise, so n may be any number.

        Coarse centroids are chosen by inner product, as in the authors' index.

        Raises: InputError: features of another dimension, or not finite.
        """
        if features.ndim != 2 or features.shape[1] != self.dim:
            raise InputError(f"expected features (n, {self.dim}), got {features.shape}")
        if self.coarse is None:
            return Codes(pq_encode(features, self.centroids, threads=threads))
        codes = np.empty((len(features), self.num_subvectors), np.uint8)
        coarse_ids = np.empty(len(features), np.uint16)
        for rows in _blocks(len(features)):
            block = features[rows]
            coarse_ids[rows] = nearest = (block @ self.coarse.T).argmax(axis=1)
            codes[rows] = pq_encode(block - self.coarse[nearest], self.centroids, threads=threads)
        return Codes(codes, coarse_ids)

    def decode(self, codes: Codes) -> Float32[np.ndarray, "n D"]:
        """The features that codes stand for, as coded: not normalised.

        Raises: InputError: codes of another codebook (see `check`).
        """
        self.check(codes)
        features = self.centroids[np.arange(self.num_subvectors), codes.codes].reshape(
            len(codes.codes), self.dim
        )
        if self.coarse is not None:
            features += self.coarse[codes.coarse_ids]
        return features

    def inverse_norms(self, codes: Codes, *, threads: int = 0) -> Float32[np.ndarray, " n"]:
        """1 / norm of each decoded feature, 0 where it has none; never more than a block is decoded."""
        self.check(codes)
        if self.coarse is None:  # squared norms add up over sub-vectors: the scan does that
            squares = (self.centroids.astype(np.float64) ** 2).sum(axis=2).astype(np.float32)
            squared = pq_scores(
                codes.codes, squares, np.ones(len(codes.codes), np.float32), threads=threads
            )
        else:
            squared = np.empty(len(codes.codes), np.float32)
            for rows in _blocks(len(squared)):
                squared[rows] = (self.decode(codes.rows(rows)) ** 2).sum(axis=1)
        norms = np.sqrt(squared)
        return np.divide(1, norms, out=np.zeros_like(norms), where=norms > 0)

    def lookup_table(self, query: Float32[np.ndarray, " D"]) -> Float32[np.ndarray, "L c"]:
        """Inner product of each part of the query with each centroid of that part."""
        parts = self._checked(query).reshape(self.num_subvectors, 1, -1)
        return (parts.astype(np.float64) * self.centroids).sum(axis=2).astype(np.float32)

    def coarse_scores(self, query: Float32[np.ndarray, " D"]) -> Float32[np.ndarray, " C"] | None:
        """Inner product of the query with each coarse centroid; None for a plain codebook."""
        if self.coarse is None:
            return None
        return np.einsum("cd,d->c", self.coarse, self._checked(query))

    def check(self, codes: Codes) -> None:
        """Refuse codes that this codebook cannot have made.

        Raises: InputError: another number of sub-vectors, coarse ids missing, superfluous or out of
        range.
        """
        if codes.codes.ndim != 2 or codes.codes.shape[1] != self.num_subvectors:
            raise InputError(f"expected codes (n, {self.num_subvectors}), got {codes.codes.shape}")
        if (codes.coarse_ids is None) != (self.coarse is None):
            raise InputError("coarse ids belong with a residual codebook, and only with one")
        if self.coarse is not None and codes.coarse_ids is not None:
            if codes.coarse_ids.shape != (len(codes.codes),):
                raise InputError(
                    f"expected {len(codes.codes)} coarse ids, got {codes.coarse_ids.shape}"
                )
            largest = int(codes.coarse_ids.max(initial=0))
            if largest >= len(self.coarse):
                raise InputError(
                    f"coarse id {largest}, but there are {len(self.coarse)} coarse centroids"
                )

    def _checked(self, query: Float32[np.ndarray, " D"]) -> Float32[np.ndarray, " D"]:
        if query.shape != (self.dim,):
            raise InputError(f"expected a query of {self.dim} numbers, got {query.shape}")
        return query

    def tensors(self) -> dict[str, np.ndarray]:
        """Its arrays by name, as they are written to files."""
        return {"centroids": self.centroids} | (
            {} if self.coarse is None else {"coarse": self.coarse}
        )


def train_codebook(
    embeddings: Float32[np.ndarray, "n D"],
    num_subvectors: int = 128,
    *,
    encoder: EncoderIdentity,
    seed: int = 0,
    threads: int = 0,
) -> Codebook:
    """Train a plain codebook; equal to the bit for any number of threads.

    At most 16,384 of the points are used, drawn by `seed`: 64 per centroid. Up to 256 distinct points
    become the centroids themselves, and are then coded without loss.

    Raises: InputError: no points, points not finite, or D is no multiple of num_subvectors.
    Source: Dr. Splat Sec. B.
    """
    n, dim = embeddings.shape
    if n == 0 or num_subvectors < 1 or dim % num_subvectors:
        raise InputError(
            f"cannot train {num_subvectors} sub-vectors on {n} embeddings of {dim} numbers"
        )
    if n > TRAINING_POINTS:
        drawn = np.random.default_rng(seed).choice(n, TRAINING_POINTS, replace=False)
        embeddings = embeddings[np.sort(drawn)]
    points = np.ascontiguousarray(embeddings)
    return Codebook(train_centroids(points, num_subvectors, seed, threads), None, encoder)


def read_faiss_codebook(path: str | os.PathLike[str], encoder: EncoderIdentity) -> Codebook:
    """A codebook from a FAISS index: IndexPQ, or the IndexIVFPQ that Dr. Splat's authors publish.

    Raises: FormatError: another kind of file, or damaged. MismatchError: another dimension than the
    encoder's.
    """
    try:
        return Codebook(*read_faiss_quantizer(path), encoder)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


def official_bytes(codes: Codes) -> UInt8[np.ndarray, "n b"]:
    """Residual codes as the authors' files hold them: list id in two bytes, little-endian, then codes."""
    if codes.coarse_ids is None:
        raise InputError("plain codes have no official form: encode with the authors' codebook")
    return np.hstack([codes.coarse_ids.astype("<u2")[:, None].view(np.uint8), codes.codes])


class OfficialRows(NamedTuple):
    """ids: the rows that hold a code, ascending. codes: theirs."""

    ids: UInt32[np.ndarray, " r"]
    codes: Codes


def from_official_bytes(rows: UInt8[np.ndarray, "n b"], codebook: Codebook) -> OfficialRows:
    """Codes out of the authors' files. All-255 rows are their mark for "no feature" and are left out.

    Raises: InputError: a plain codebook. FormatError: rows of another length, or a list id that the
    codebook does not have.
    """
    if codebook.coarse is None:
        raise InputError(
            "official codes are residuals: read the authors' .faiss file for their codebook"
        )
    if rows.ndim != 2 or rows.shape[1] != 2 + codebook.num_subvectors:
        raise FormatError(f"expected rows of {2 + codebook.num_subvectors} bytes, got {rows.shape}")
    ids = np.flatnonzero((rows != 255).any(axis=1)).astype(np.uint32)
    coarse_ids = np.ascontiguousarray(rows[ids, :2]).view("<u2")[:, 0].astype(np.uint16)
    bad = np.flatnonzero(coarse_ids >= len(codebook.coarse))
    if len(bad):
        raise FormatError(
            f"row {ids[bad[0]]} names list {coarse_ids[bad[0]]} of {len(codebook.coarse)}: these codes "
            "were made with another codebook, or are damaged"
        )
    return OfficialRows(ids, Codes(np.ascontiguousarray(rows[ids, 2:]), coarse_ids))


def save_codebook(
    codebook: Codebook, path: str | os.PathLike[str], overwrite: bool = False
) -> None:
    """Write a codebook to one safetensors file."""
    encoder = codebook.encoder
    metadata = {
        "format": CODEBOOK_FORMAT,
        "hash": codebook.hash,
        "encoder": json.dumps(
            {"name": encoder.name, "dim": encoder.dim, "weights": encoder.weights}
        ),
    }
    write_tensors(path, codebook.tensors(), metadata, overwrite)


def load_codebook(path: str | os.PathLike[str]) -> Codebook:
    """Read what `save_codebook` wrote.

    Raises: FormatError: another kind of file or version, or damaged.
    """
    tensors, metadata = map_tensors(path)
    if metadata.get("format") != CODEBOOK_FORMAT:
        raise FormatError(
            f"{path}: expected '{CODEBOOK_FORMAT}', got {ascii(metadata.get('format'))[:60]}"
        )
    try:
        identity = json.loads(metadata.get("encoder", ""))
    except (ValueError, RecursionError):
        identity = None
    return codebook_from_tensors(tensors, identity, metadata.get("hash"), str(path))


def codebook_from_tensors(
    tensors: Mapping[str, np.ndarray], identity: object, expected_hash: object, where: str
) -> Codebook:
    """A codebook from the arrays of a file and the JSON identity of its encoder, checked by its hash.

    Raises: FormatError: something is missing or ill-formed, or the hash differs.
    """
    encoder = encoder_from_json(identity, where)
    coarse = tensors.get("coarse")
    if "centroids" not in tensors:
        raise FormatError(f"{where}: there are no centroids in this file")
    try:
        codebook = Codebook(
            np.asarray(tensors["centroids"]),
            None if coarse is None else np.asarray(coarse),
            encoder,
        )
    except (InputError, MismatchError) as error:
        raise FormatError(f"{where}: {error}") from error
    if codebook.hash != expected_hash:
        raise FormatError(
            f"{where}: the codebook is not the one that was written (hash {codebook.hash})"
        )
    return codebook


def encoder_from_json(identity: object, where: str) -> EncoderIdentity:
    """Raises: FormatError: not an object of name, dim and weights."""
    if not isinstance(identity, dict):
        raise FormatError(f"{where}: expected the encoder's name, dim and weights")
    name, dim, weights = (identity.get(key) for key in ("name", "dim", "weights"))
    well_typed = isinstance(name, str) and isinstance(weights, str) and isinstance(dim, int)
    if not well_typed or isinstance(dim, bool) or not 1 <= dim < 1 << 24:
        raise FormatError(f"{where}: expected the encoder's name, dim and weights")
    return EncoderIdentity(name, dim, weights)


def _blocks(count: int) -> Iterator[slice]:
    return (slice(begin, min(begin + BLOCK, count)) for begin in range(0, count, BLOCK))
