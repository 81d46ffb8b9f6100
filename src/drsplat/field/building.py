"""Evidence to field, a block of rows at a time: there is never a dense matrix of all features."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from scipy.sparse import csr_array

from ..base.arrays import Embeddings, Flags, Indices, OtherIds, UnsignedIds
from ..base.contents import release
from ..base.working import Here, Work
from ..errors import InputError, MismatchError
from ..scene.encoders import EncoderIdentity
from ..scene.gaussians import Gaussians
from .codes import PQ, Code, Codebook, Codes, CodeSpecification, Mixture, Smaller, Track, pq_code, untracked
from .codes.mixture import Mixed, SceneAtoms, encode_with
from .evidence.aggregation import MEAN, Aggregated, Aggregator
from .evidence.aggregation.entries import canonical
from .evidence.evidence import Evidence, csr_of
from .evidence.provenance import Provenance
from .growth import Growth
from .language_field import LanguageField
from .learning import Learnt, learn, rows_of_columns, source_of


@runtime_checkable
class Features(Protocol):
    """Unit features of rows, made when they are asked for, of the entries of `weights`."""

    @property
    def weights(self) -> csr_array: ...
    def __len__(self) -> int: ...
    def features(self, begin: int, end: int, *, threads: int = 0) -> Embeddings: ...


class RowCoder:
    """Makes features of rows and codes them, in this process; others let tasks do it, to the same bits."""

    def aggregated(
        self, how: Aggregator, evidence: Evidence, gaussians: Gaussians | None, threads: int, track: Track
    ) -> Aggregated:
        """Make features of votes; see `Aggregator` for the arguments."""
        return how(evidence, gaussians, threads=threads)

    def of_columns(self, features: Aggregated, kept: Flags) -> Aggregated:
        """Return rows to learn a code from: a `Sampler`."""
        return rows_of_columns(features, kept)

    def work(self, threads: int, track: Track) -> Work:
        """Return who trains a codebook."""
        return Here(threads, track)

    def mixed(
        self, features: Aggregated, seen: Indices, atoms_per_row: int, scene: SceneAtoms | None,
        threads: int, track: Track,
    ) -> Mixed:  # fmt: skip
        """Code rows as mixtures of atoms; see `encode_with` for the arguments."""
        return encode_with(source_of(features.rows(seen)), atoms_per_row, scene, threads=threads, track=track)

    def quantised(
        self, features: Aggregated, seen: Indices, codebook: Codebook, threads: int, track: Track
    ) -> tuple[Codes, Flags]:
        """Code rows by a codebook; see `encode_features` for the arguments."""
        return encode_features(features.rows(seen), codebook, threads, track)


AT_ONCE: RowCoder = RowCoder()


class Coded(NamedTuple):
    """directed: of the rows, which have a direction and so a code. scene_places: of a mixture, as of `Growth`."""

    code: Code
    directed: Flags
    scene_places: OtherIds | None = None


def build_field(
    evidence: Evidence,
    scene: str,
    encoder: EncoderIdentity,
    code: CodeSpecification = PQ(),
    *,
    aggregated: Aggregated | None = None,
    provenance: Provenance | None = None,
    coder: RowCoder = AT_ONCE,
    threads: int = 0,
    track: Track = untracked,
) -> LanguageField:
    """Build the field of evidence: the coded feature of each Gaussian that has one.

    evidence: one row per Gaussian of the scene; the field keeps all of it, whatever the features are made
    of. scene: fingerprint of those Gaussians. code: what features are kept as. aggregated: the features of
    the rows, as an aggregator makes them of the evidence, None for their mean. provenance: of the evidence's columns;
    a field that is to grow needs it. coder: the strategy of coding. track: shows progress. The bits are the same for
    any number of threads.

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
    chosen = chosen_code(code, evidence)
    if isinstance(chosen, Mixture):
        evidence = canonical(evidence)  # a mixture names columns
    learnt = learn(features, chosen, encoder, threads, track, coder.of_columns, coder.work(threads, track))
    coded = _coded(coder, features, seen, chosen, learnt, threads, track)
    ids = seen[coded.directed].astype(np.uint32)
    growth = None if provenance is None else grown_of(provenance, code, evidence, ids, learnt, coded.scene_places)
    return LanguageField(
        ids, coded.code, encoder, scene, len(evidence), evidence.rows(ids), aggregator=features.record, growth=growth
    )


def chosen_code(code: CodeSpecification, evidence: Evidence) -> PQ | Mixture | Codebook:
    """Return the code itself, or, for `Smaller`, the code that makes the smaller field."""
    if isinstance(code, Smaller):
        return code.chosen(evidence.num_seen, len(evidence.masks), evidence.dim)
    return code


def grown_of(
    provenance: Provenance,
    code: CodeSpecification,
    evidence: Evidence,
    gaussian_ids: UnsignedIds,
    learnt: Learnt,
    scene_places: OtherIds | None,
) -> Growth:
    """Return what a field of these Gaussians has to keep beside its rows of the evidence."""
    has_rest = np.diff(evidence.weights.indptr) > 0
    has_rest[gaussian_ids] = False
    rest_ids = np.flatnonzero(has_rest).astype(np.uint32)
    wish = None if isinstance(code, Codebook) else code
    # some rows of W, with int32 columns
    rows = evidence.weights[rest_ids]
    rest = csr_of(rows.indptr, rows.indices.astype(np.int32), rows.data, rows.shape[1])
    return Growth(
        provenance, wish, rest_ids, rest, learnt.views, learnt.atoms,
        None if learnt.atoms is None else scene_places,
    )  # fmt: skip


def _coded(
    coder: RowCoder, features: Aggregated, seen: Indices, code: PQ | Mixture | Codebook,
    learnt: Learnt, threads: int, track: Track,
) -> Coded:  # fmt: skip
    """Code the rows that have a direction, and mark them among those seen: embeddings can cancel out."""
    if isinstance(code, Mixture):
        mixed = coder.mixed(features, seen, code.atoms, learnt.atoms, threads, track)
        directed = mixed.code.blocks.scales > 0
        kept = mixed.code if directed.all() else mixed.code.rows(np.flatnonzero(directed))
        return Coded(kept, directed, mixed.scene_places)
    assert learnt.codebook is not None
    codes, directed = coder.quantised(features, seen, learnt.codebook, threads, track)
    if not directed.all():
        codes = codes.rows(np.flatnonzero(directed))
    return Coded(pq_code(learnt.codebook, codes), directed)


def encode_features(rows: Features, codebook: Codebook, threads: int, track: Track) -> tuple[Codes, Flags]:
    """Return the codes of all rows, and which of them have a direction."""
    directed = np.empty(len(rows), np.bool_)

    def features(begin: int, end: int) -> Embeddings:
        block = rows.features(begin, end, threads=threads)
        directed[begin:end] = block.any(1)
        release(rows.weights.indices, rows.weights.data)
        return block

    return codebook.encode_blocks(len(rows), features, threads=threads, track=track), directed
