"""Evidence to field, a block of rows at a time: there is never a dense matrix of all features."""

import math

import numpy as np
from jaxtyping import Bool

from ..aggregation import MEAN, MEAN_RECORD, Aggregated, AggregatorRecord
from ..aggregation.entries import canonical
from ..codes import Code, Codebook, Codes, Track, pq_code, train_codebook, untracked
from ..codes.codebook import BLOCK, TRAINING_POINTS
from ..codes.mixture import encode_mixture
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
    atoms_per_row: int | None = None,
    aggregated: Aggregated | None = None,
    record: AggregatorRecord = MEAN_RECORD,
    track: Track = untracked,
) -> LanguageField:
    """The feature of each Gaussian, coded. Gaussians without any are left out.

    evidence: one row per Gaussian of the scene; the field keeps all of it, whatever the features are made
    of. scene: fingerprint of those Gaussians. codebook None trains one on features spread over the scene,
    with num_subvectors parts (None: 128, or the largest power of two below it that divides D). atoms_per_row:
    not product-quantised, but a mixture of so many segments and typical features each: see docs/mixture.md.
    aggregated: the features of the rows, as an aggregator makes them of the evidence, None for their mean;
    record: what the field says of it. track: shows progress. The same to the bit for any number of
    threads.

    Raises: InputError: no Gaussian has evidence, not one feature per row, or both a mixture and a codebook
    are asked for. MismatchError: the
    embeddings, the encoder and the codebook are not of one dimension.
    Source: Dr. Splat Sec. A "Training stage".
    """
    if evidence.dim != encoder.dim:
        raise MismatchError(
            f"embeddings of {evidence.dim} numbers, but {encoder.name} makes {encoder.dim}"
        )
    if atoms_per_row is not None and (codebook is not None or num_subvectors is not None):
        raise InputError("a mixture has no codebook: drop atoms_per_row, or what is of a codebook")
    features = MEAN(evidence) if aggregated is None else aggregated
    if len(features) != len(evidence):
        raise InputError(f"{len(features)} features for evidence of {len(evidence)} rows")
    seen = np.flatnonzero(features.present)
    if not len(seen):
        raise InputError(
            "no Gaussian is under any mask: check that poses, photos and scene belong together"
        )
    features = features.rows(seen)
    if atoms_per_row is not None:
        evidence = canonical(evidence)  # a mixture names columns
        code, directed = _mixed(features, atoms_per_row, threads, track)
    else:
        if codebook is None:
            parts = num_subvectors or math.gcd(SUBVECTORS, encoder.dim)
            codebook = _scene_codebook(features, encoder, parts, threads, track)
        code, directed = _quantised(features, codebook, threads, track)
    ids, kept = seen[directed].astype(np.uint32), evidence.rows(seen[directed])
    return LanguageField(ids, code, encoder, scene, len(evidence), kept, aggregator=record)


def _mixed(
    features: Aggregated, atoms_per_row: int, threads: int, track: Track
) -> tuple[Code, Bool[np.ndarray, " r"]]:
    """The code of the rows that have a direction, and which of all do."""
    source = features.evidence
    if features.donors is not None:
        source = source.rows(features.donors)
    code = encode_mixture(canonical(source), atoms_per_row, threads=threads, track=track)
    directed = code.blocks.scales > 0
    return code if directed.all() else code.rows(np.flatnonzero(directed)), directed


def _quantised(
    features: Aggregated, codebook: Codebook, threads: int, track: Track
) -> tuple[Code, Bool[np.ndarray, " r"]]:
    """The code of the rows that have a direction, and which of all do: embeddings can cancel out."""
    codes, directed = _encode_rows(features, codebook, threads, track)
    if not directed.all():
        codes = codes.rows(np.flatnonzero(directed))
    return pq_code(codebook, codes, threads=threads), directed


def _scene_codebook(
    features: Aggregated, encoder: EncoderIdentity, parts: int, threads: int, track: Track
) -> Codebook:
    count = min(len(features), TRAINING_POINTS)
    spread = np.linspace(0, len(features) - 1, count).astype(np.int64)
    points = features.rows(spread).features(0, count, threads=threads)
    directed = points[points.any(axis=1)]
    return train_codebook(directed, parts, encoder=encoder, threads=threads, track=track)


def _encode_rows(
    aggregated: Aggregated, codebook: Codebook, threads: int, track: Track
) -> tuple[Codes, Bool[np.ndarray, " r"]]:
    """Codes of all rows, and which of them have a direction."""
    rows = len(aggregated)
    codes = np.empty((rows, codebook.num_subvectors), np.uint8)
    coarse_ids = None if codebook.coarse is None else np.empty(rows, np.uint16)
    directed = np.empty(rows, np.bool_)
    for begin in track(range(0, rows, BLOCK), "coding Gaussians"):
        block = slice(begin, min(begin + BLOCK, rows))
        features = aggregated.features(block.start, block.stop, threads=threads)
        directed[block] = features.any(axis=1)
        codes[block], nearest = codebook.encode(features, threads=threads)
        if coarse_ids is not None and nearest is not None:
            coarse_ids[block] = nearest
    return Codes(codes, coarse_ids), directed
