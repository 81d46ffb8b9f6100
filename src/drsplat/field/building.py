"""Evidence to field, a block of rows at a time: there is never a dense matrix of all features."""

import math

import numpy as np
from jaxtyping import Bool

from ..codes import Codebook, Codes, Track, train_codebook, untracked
from ..codes.codebook import BLOCK, TRAINING_POINTS
from ..encoders import EncoderIdentity
from ..errors import InputError, MismatchError
from ..evidence import Evidence
from .language_field import LanguageField

SUBVECTORS = 128


def build_field(
    evidence: Evidence,
    scene: str,
    encoder: EncoderIdentity,
    codebook: Codebook | None = None,
    num_subvectors: int | None = None,
    threads: int = 0,
    *,
    track: Track = untracked,
) -> LanguageField:
    """Mean embedding of each Gaussian, normalised and coded. Gaussians without any are left out.

    evidence: one row per Gaussian of the scene. scene: fingerprint of those Gaussians. codebook
    None trains one on features spread over the scene, with num_subvectors parts (None: 128, or the
    largest power of two below it that divides D). track: shows progress. The same to the bit for any
    number of threads.

    Raises: InputError: no Gaussian has evidence. MismatchError: the embeddings, the encoder and the
    codebook are not of one dimension.
    Source: Dr. Splat Sec. A "Training stage".
    """
    if evidence.dim != encoder.dim:
        raise MismatchError(
            f"embeddings of {evidence.dim} numbers, but {encoder.name} makes {encoder.dim}"
        )
    seen = np.flatnonzero(np.diff(evidence.weights.indptr) > 0)
    if not len(seen):
        raise InputError(
            "no Gaussian is under any mask: check that poses, photos and scene belong together"
        )
    registered = evidence.rows(seen)
    if codebook is None:
        parts = num_subvectors or math.gcd(SUBVECTORS, encoder.dim)
        codebook = _scene_codebook(registered, encoder, parts, threads, track)
    codes, directed = _encode_rows(registered, codebook, threads, track)
    if not directed.all():  # embeddings that cancel out exactly
        rows = np.flatnonzero(directed)
        seen, codes, registered = seen[rows], codes.rows(rows), registered.rows(rows)
    norms = codebook.inverse_norms(codes, threads=threads)
    ids = seen.astype(np.uint32)
    return LanguageField(ids, *codes, norms, codebook, encoder, scene, len(evidence), registered)


def _scene_codebook(
    registered: Evidence, encoder: EncoderIdentity, parts: int, threads: int, track: Track
) -> Codebook:
    count = min(len(registered), TRAINING_POINTS)
    spread = np.linspace(0, len(registered) - 1, count).astype(np.int64)
    features = registered.rows(spread).features(0, count, threads=threads)
    directed = features[features.any(axis=1)]
    return train_codebook(directed, parts, encoder=encoder, threads=threads, track=track)


def _encode_rows(
    evidence: Evidence, codebook: Codebook, threads: int, track: Track
) -> tuple[Codes, Bool[np.ndarray, " r"]]:
    """Codes of all rows, and which of them have a direction."""
    rows = len(evidence)
    codes = np.empty((rows, codebook.num_subvectors), np.uint8)
    coarse_ids = None if codebook.coarse is None else np.empty(rows, np.uint16)
    directed = np.empty(rows, np.bool_)
    for begin in track(range(0, rows, BLOCK), "coding Gaussians"):
        block = slice(begin, min(begin + BLOCK, rows))
        features = evidence.features(block.start, block.stop, threads=threads)
        directed[block] = features.any(axis=1)
        codes[block], nearest = codebook.encode(features, threads=threads)
        if coarse_ids is not None and nearest is not None:
            coarse_ids[block] = nearest
    return Codes(codes, coarse_ids), directed
