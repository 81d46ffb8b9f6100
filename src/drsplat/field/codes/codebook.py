"""Codebooks, which turn features into codes and back."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...base.arrays import Arrays, ArraysByName, ByteRows, Embeddings, Float32, Numbers, RowIds, SmallIds
from ...base.working import Here, Track, Work, untracked
from ...errors import FormatError, InputError, MismatchError
from ...formats.embedding_record import encoder_from_json
from ...formats.faiss_index import is_faiss
from ...formats.json_files import parsed
from ...formats.tensors import check_tensors, map_tensors, write_tensors
from ...kernels import QueryTables, lookup_tables, pq_encode
from ...kernels.algebra import CENTROIDS
from ...kernels.kmeans import train_centroids
from ...kernels.mixture import nearest_centres
from ...scene.encoders import EncoderIdentity, identity_json

BLOCK_ROWS = 8192  # bounds the memory of decoded features
MAX_TRAINING_POINTS = 64 * CENTROIDS
MAX_ABS_CENTROID = 1e15  # squared norms are float32
CODEBOOK_FORMAT = "drsplat codebook 1"


class Codes(NamedTuple):
    """Codes of rows: a centroid per sub-vector. coarse_ids: a coarse centroid per row, or None (plain)."""

    codes: ByteRows
    coarse_ids: SmallIds | None = None

    def rows(self, index: slice | RowIds) -> "Codes":
        return Codes(self.codes[index], None if self.coarse_ids is None else self.coarse_ids[index])


@dataclass(frozen=True, eq=False)
class Codebook:
    """Centroids of each sub-vector; fits every scene seen by the same encoder.

    coarse: None (plain), or centroids of whole features, whose codes are of what they leave over.

    Raises: InputError: shapes disagree, or values are not finite. MismatchError: another dimension than the encoder's.
    """

    centroids: Float32[np.ndarray, "L c d"]
    coarse: Embeddings | None
    encoder: EncoderIdentity

    def __post_init__(self) -> None:
        shape, dtype = self.centroids.shape, self.centroids.dtype
        if len(shape) != 3 or shape[1] != CENTROIDS or 0 in shape or dtype != np.float32:
            raise InputError(f"centroids: expected float32 (L, 256, D / L), got {dtype} {shape}")
        if self.dim != self.encoder.dim:
            raise MismatchError(
                f"codebook of {self.dim} numbers for the encoder {self.encoder.name} of "
                f"{self.encoder.dim}: train or read one made with this encoder"
            )
        coarse = self.coarse
        if coarse is not None and not (
            coarse.ndim == 2
            and coarse.shape[1] == self.dim
            and 1 <= len(coarse) <= 65535
            and coarse.dtype == np.float32
        ):
            raise InputError(f"coarse: expected float32 (up to 65535, {self.dim}), got {coarse.dtype} {coarse.shape}")
        parts = [part for part in (self.centroids, coarse) if part is not None]
        if not all(np.abs(part).max(initial=0) <= MAX_ABS_CENTROID for part in parts):  # NaN is not either
            raise InputError(f"centroids must be finite, and not beyond {MAX_ABS_CENTROID:g}")

    @property
    def num_subvectors(self) -> int:
        return len(self.centroids)

    @property
    def code_bytes(self) -> int:
        """Bytes of a code: one per sub-vector, two more for the coarse id of a residual codebook."""
        return self.num_subvectors + (0 if self.coarse is None else 2)

    @property
    def dim(self) -> int:
        return int(self.centroids.shape[0] * self.centroids.shape[2])

    @cached_property
    def hash(self) -> str:
        """Hash of the whole codebook: codebooks of equal hash give a code the same meaning."""
        digest = hashlib.blake2b(digest_size=16)
        shapes = [self.centroids.shape, None if self.coarse is None else self.coarse.shape]
        identity = [self.encoder.name, self.encoder.dim, self.encoder.weights]
        digest.update(json.dumps([shapes, identity]).encode())
        for part in (self.centroids, self.coarse):
            if part is not None:
                digest.update(np.ascontiguousarray(part).data)
        return digest.hexdigest()

    def encode(self, features: Embeddings, *, threads: int = 0) -> Codes:
        """Return the nearest code of each feature; blockwise, so n may be any number.

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
            coarse_ids[rows] = nearest = nearest_centres(block, self.coarse, threads=threads)
            codes[rows] = pq_encode(block - self.coarse[nearest], self.centroids, threads=threads)
        return Codes(codes, coarse_ids)

    def encode_blocks(self, count: int, features: Callable[[int, int], Embeddings], *,
        threads: int = 0, track: Track = untracked,
    ) -> Codes:  # fmt: skip
        """Return the codes of `count` features that are made a block at a time: `features(begin, end)`."""
        codes = np.empty((count, self.num_subvectors), np.uint8)
        coarse_ids = None if self.coarse is None else np.empty(count, np.uint16)
        for begin in track(range(0, count, BLOCK_ROWS), "coding Gaussians"):
            end = min(begin + BLOCK_ROWS, count)
            codes[begin:end], nearest = self.encode(features(begin, end), threads=threads)
            if coarse_ids is not None and nearest is not None:
                coarse_ids[begin:end] = nearest
        return Codes(codes, coarse_ids)

    def decode(self, codes: Codes) -> Embeddings:
        """Return the features that codes stand for, as coded: not normalised.

        Raises: InputError: codes of another codebook (see `check`).
        """
        self.check(codes)
        parts = self.centroids[np.arange(self.num_subvectors), codes.codes]
        features: np.ndarray = parts.reshape(len(codes.codes), self.dim)
        if self.coarse is not None:
            features += self.coarse[codes.coarse_ids]
        return features

    def inverse_norms(self, codes: Codes) -> Numbers:
        """Return 1 / norm of each decoded feature, 0 where it is zero; decodes a block at a time."""
        self.check(codes)
        squares = (self.centroids.astype(np.float64) ** 2).sum(2).astype(np.float32)
        squared = np.empty(len(codes.codes), np.float32)
        for rows in _blocks(len(squared)):
            if self.coarse is None:  # squared norms add up over sub-vectors; even and odd ones apart, in one order
                sums = np.zeros((2, len(squared[rows])), np.float32)
                for part, column in enumerate(codes.codes[rows].T):
                    sums[part % 2] += squares[part, column]
                squared[rows] = sums.sum(0)
            else:
                squared[rows] = (self.decode(codes.rows(rows)) ** 2).sum(1)
        norms = np.sqrt(squared)
        return np.divide(1, norms, out=np.zeros_like(norms), where=norms > 0)

    def tables(self, queries: Embeddings, *, threads: int = 0) -> QueryTables:
        """Return each query's inner products with all centroids.

        Raises: InputError: queries of another dimension.
        """
        if queries.shape[1] != self.dim:
            raise InputError(f"expected queries of {self.dim} numbers, got {queries.shape[1]}")
        by_part, by_block = self._by_number
        luts = lookup_tables(by_part, queries, threads=threads)
        if self.coarse is None:
            return QueryTables(luts)
        blocks = [lookup_tables(block[None], queries, threads=threads) for block in by_block]
        return QueryTables(luts, np.concatenate(blocks, axis=2)[:, 0, : len(self.coarse)])

    @cached_property
    def _by_number(self) -> tuple[Float32[np.ndarray, "L d c"], Float32[np.ndarray, "b D c"]]:
        """Centroids, and blocks of 256 coarse ones, as `lookup_tables` reads them."""
        by_part = np.ascontiguousarray(self.centroids.transpose(0, 2, 1))
        coarse = np.empty((0, self.dim), np.float32) if self.coarse is None else self.coarse
        padded = np.zeros((-(-len(coarse) // CENTROIDS), CENTROIDS, self.dim), np.float32)
        padded.reshape(-1, self.dim)[: len(coarse)] = coarse
        return by_part, np.ascontiguousarray(padded.transpose(0, 2, 1))

    def check(self, codes: Codes) -> None:
        """Refuse codes that this codebook cannot have made.

        Raises: InputError: another number of sub-vectors, coarse ids missing, superfluous or out of range.
        """
        if codes.codes.ndim != 2 or codes.codes.shape[1] != self.num_subvectors:
            raise InputError(f"expected codes (n, {self.num_subvectors}), got {codes.codes.shape}")
        self.check_coarse_ids(codes.coarse_ids, len(codes.codes))

    def check_coarse_ids(self, ids: SmallIds | None, rows: int) -> None:
        """Check coarse ids. Raises: InputError: ids missing, superfluous, out of range or not one per row."""
        if (ids is None) != (self.coarse is None):
            raise InputError("coarse ids belong with a residual codebook, and only with one")
        if self.coarse is not None and ids is not None:
            if ids.shape != (rows,) or ids.dtype != np.uint16:
                raise InputError(f"expected {rows} coarse ids (uint16), got {ids.dtype} {ids.shape}")
            largest = int(ids.max(initial=0))
            if largest >= len(self.coarse):
                raise InputError(f"coarse id {largest}, but there are {len(self.coarse)} coarse centroids")

    def tensors(self) -> Arrays:
        """Return the arrays by name, as they are written to files."""
        return {"centroids": self.centroids} | ({} if self.coarse is None else {"coarse": self.coarse})


def train_codebook(
    embeddings: Embeddings,
    num_subvectors: int = 128,
    *,
    encoder: EncoderIdentity,
    seed: int = 0,
    threads: int = 0,
    track: Track = untracked,
    work: Work | None = None,
) -> Codebook:
    """Train a plain codebook; equal to the bit for any number of threads. track: shows progress. work: who trains.

    At most 16,384 of the points are used, drawn by `seed`: 64 per centroid. Where a sub-vector has
    up to 256 distinct values, they become its centroids, and are then coded without loss.

    Raises: InputError: no points, points not finite, or D is no multiple of num_subvectors.
    Source: Dr. Splat Sec. B.

    >>> vectors = np.random.default_rng(0).normal(size=(1000, 8)).astype(np.float32)
    >>> ds.train_codebook(vectors, 2, encoder=ds.EncoderIdentity("my encoder", 8)).dim
    8
    """
    n, dim = embeddings.shape
    if n == 0 or num_subvectors < 1 or dim % num_subvectors:
        raise InputError(
            f"cannot train {num_subvectors} sub-vectors on {n} embeddings of {dim} numbers: give at "
            f"least one embedding, and a number of sub-vectors that divides {dim}"
        )
    if n > MAX_TRAINING_POINTS:
        drawn = np.random.default_rng(seed).choice(n, MAX_TRAINING_POINTS, replace=False)
        embeddings = embeddings[np.sort(drawn)]
    points = np.ascontiguousarray(embeddings)
    return Codebook(train_centroids(points, num_subvectors, seed, work or Here(threads, track)), None, encoder)


def _blocks(count: int) -> Iterator[slice]:
    return (slice(begin, min(begin + BLOCK_ROWS, count)) for begin in range(0, count, BLOCK_ROWS))


def save_codebook(codebook: Codebook, path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Write a codebook to one safetensors file."""
    metadata = {
        "format": CODEBOOK_FORMAT,
        "hash": codebook.hash,
        "encoder": json.dumps(identity_json(codebook.encoder)),
    }
    write_tensors(path, codebook.tensors(), metadata, overwrite)


def load_codebook(path: str | os.PathLike[str]) -> Codebook:
    """Read what `save_codebook` wrote. Raises: FormatError: another kind of file or version, or damaged.

    >>> ds.load_codebook("codebook.safetensors").dim
    8
    """
    if is_faiss(path):
        raise FormatError(
            f"{path}: a FAISS index, which does not say which encoder made its embeddings: "
            "read it with drsplat.field.codes.official.read_codebook, which takes the encoder's name"
        )
    tensors, metadata = map_tensors(path)
    if metadata.get("format") != CODEBOOK_FORMAT:
        raise FormatError(f"{path}: expected '{CODEBOOK_FORMAT}', got {ascii(metadata.get('format'))[:60]}")
    try:
        identity = parsed(metadata.get("encoder", ""))
    except (ValueError, RecursionError):
        identity = None
    return codebook_from_tensors(tensors, identity, metadata.get("hash"), str(path))


def codebook_from_tensors(tensors: ArraysByName, identity: object, expected_hash: object, where: str) -> Codebook:
    """Return the codebook of a file's arrays and the JSON identity of its encoder, checked by its hash.

    Raises: FormatError: something is missing or ill-formed, or the hash differs.
    """
    encoder = encoder_from_json(identity, where)
    expected = {"centroids": ("float32", "L c d"), "coarse": ("float32", "C D")}
    check_tensors(tensors, {k: v for k, v in expected.items() if k != "coarse" or k in tensors}, where)
    try:
        codebook = Codebook(tensors["centroids"], tensors.get("coarse"), encoder)
    except (InputError, MismatchError) as error:
        raise FormatError(f"{where}: {error}") from error
    if codebook.hash != expected_hash:
        raise FormatError(f"{where}: the codebook is not the one that was written (hash {codebook.hash})")
    return codebook
