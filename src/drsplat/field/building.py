"""Evidence to field, a block of rows at a time: there is never a dense matrix of all features."""

import numpy as np
from jaxtyping import Bool

from ..codes import (
    PQ,
    Code,
    Codebook,
    Codes,
    CodeSpecification,
    Mixture,
    Smaller,
    Track,
    pq_code,
    train_codebook,
    untracked,
)
from ..codes.codebook import BLOCK, TRAINING_POINTS
from ..codes.mixture import encode_mixture
from ..encoders import EncoderIdentity
from ..errors import InputError, MismatchError
from ..evidence.aggregation import MEAN, Aggregated
from ..evidence.aggregation.entries import canonical
from ..evidence.evidence import Evidence
from .language_field import LanguageField


def build_field(
    evidence: Evidence,
    scene: str,
    encoder: EncoderIdentity,
    code: CodeSpecification = PQ(),
    *,
    aggregated: Aggregated | None = None,
    threads: int = 0,
    track: Track = untracked,
) -> LanguageField:
    """The feature of each Gaussian, coded. Gaussians without any are left out.

    evidence: one row per Gaussian of the scene; the field keeps all of it, whatever the features are made
    of. scene: fingerprint of those Gaussians. code: what features are kept as. aggregated: the features of
    the rows, as an aggregator makes them of the evidence, None for their mean. track: shows progress. The
    same to the bit for any number of threads.

    Raises: InputError: no Gaussian has evidence, or not one feature per row. MismatchError: the
    embeddings, the encoder and the codebook are not of one dimension.
    Source: Dr. Splat Sec. A "Training stage".
    """
    if evidence.dim != encoder.dim:
        raise MismatchError(f"embeddings of {evidence.dim} numbers, but {encoder.name} makes {encoder.dim}")
    features = MEAN(evidence) if aggregated is None else aggregated
    if len(features) != len(evidence):
        raise InputError(f"{len(features)} features for evidence of {len(evidence)} rows")
    seen = np.flatnonzero(features.present)
    if not len(seen):
        raise InputError("no Gaussian is under any mask: check that poses, photos and scene belong together")
    if isinstance(code, Smaller):
        code = code.chosen(evidence.num_seen, len(evidence.masks), evidence.dim)
    if isinstance(code, Mixture):
        evidence = canonical(evidence)  # a mixture names columns
    coded, directed = _coded(features.rows(seen), code, encoder, threads, track)
    ids, kept = seen[directed].astype(np.uint32), evidence.rows(seen[directed])
    return LanguageField(ids, coded, encoder, scene, len(evidence), kept, aggregator=features.record)


def _coded(
    features: Aggregated, code: PQ | Mixture | Codebook, encoder: EncoderIdentity, threads: int, track: Track
) -> tuple[Code, Bool[np.ndarray, " r"]]:
    """The code of the rows that have a direction, and which of all do."""
    if isinstance(code, Mixture):
        return _mixed(features, code.atoms, threads, track)
    if isinstance(code, PQ):
        code = _scene_codebook(features, encoder, code.parts(encoder.dim), threads, track)
    return _quantised(features, code, threads, track)


def _mixed(features: Aggregated, atoms_per_row: int, threads: int, track: Track) -> tuple[Code, Bool[np.ndarray, " r"]]:
    source = features.evidence
    if features.donors is not None:
        source = source.rows(features.donors)
    code = encode_mixture(canonical(source), atoms_per_row, threads=threads, track=track)
    directed = code.blocks.scales > 0
    return code if directed.all() else code.rows(np.flatnonzero(directed)), directed


def _quantised(
    features: Aggregated, codebook: Codebook, threads: int, track: Track
) -> tuple[Code, Bool[np.ndarray, " r"]]:
    """Embeddings can cancel out."""
    codes, directed = _encode_rows(features, codebook, threads, track)
    if not directed.all():
        codes = codes.rows(np.flatnonzero(directed))
    return pq_code(codebook, codes), directed


def _scene_codebook(features: Aggregated, encoder: EncoderIdentity, parts: int, threads: int, track: Track) -> Codebook:
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
