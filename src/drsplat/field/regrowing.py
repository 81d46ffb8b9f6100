"""A field after some of its views have come or gone: equal to one built anew, to the bit, for less work.

A row of a code depends on its own row of W, and on what was learnt from a few views (`learning`). Where neither has
changed the row is copied.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array, vstack

from ..base.arrays import Flags, Ids, Indices, OtherIds, OtherIndices
from ..errors import InputError
from ..kernels.mixture import MAX_ATOMS
from ..scene.gaussians import Gaussians
from ..scene.moving import Span
from .building import Coded, build_field, chosen_code, encode_features, grown_of
from .codes import PQ, Codebook, Codes, Mixture, PQCode, Track, pq_code, untracked
from .codes.mixture import Mixed, MixtureCode, regrown_mixture
from .evidence.aggregation import MEAN, aggregator
from .evidence.aggregation.entries import canonical, with_weights
from .evidence.changing import REMOVED_COLUMN
from .evidence.evidence import Evidence, MaskIds, csr_of
from .evidence.provenance import Provenance
from .growth import Growth
from .language_field import LanguageField
from .learning import Learnt, learning_views


def whole_evidence(field: LanguageField) -> Evidence:
    """Return evidence with a row for each Gaussian of the scene, also for those without a feature, as far as kept.

    Raises: InputError: the field was saved without its evidence.
    """
    if field.evidence is None:
        raise InputError("this field holds no evidence: register again and keep it")
    kept, ids = field.evidence.weights, field.gaussian_ids.astype(np.int64)
    if field.growth is not None and len(field.growth.rest_ids):
        kept = vstack([kept, field.growth.rest], format="csr")
        ids = np.concatenate([ids, field.growth.rest_ids])
        order = np.argsort(ids)
        kept, ids = csr_array(kept[order]), ids[order]
    starts = np.zeros(field.num_gaussians + 1, np.int64)
    starts[1 + ids] = np.diff(kept.indptr)
    weights = csr_of(np.cumsum(starts), kept.indices, kept.data, kept.shape[1])
    return Evidence(weights, field.evidence.masks, field.evidence.embeddings)


def regrown_field(
    field: LanguageField,
    evidence: Evidence,
    provenance: Provenance,
    touched: Flags,
    changed: Collection[str],
    *,
    threads: int = 0,
    track: Track = untracked,
) -> LanguageField | None:
    """Return the field of changed evidence of the same Gaussians, or None where it has to be built anew.

    evidence: in canonical order. touched: the Gaussians whose rows of W have changed, before or now. changed: the
    views that have come, gone or become others. What features do not decide (words, objects, what is up) is left out.
    """
    growth = field.growth
    if growth is None or field.evidence is None or not _can_stay(field, growth, evidence, changed):
        return None
    rows = np.flatnonzero(~touched[field.gaussian_ids])
    seen = np.flatnonzero(touched & (np.diff(evidence.weights.indptr) > 0))
    weights = evidence.weights  # rows under one mask share their others, which then stay in caches
    seen = seen[np.argsort(weights.indices[weights.indptr[seen]], kind="stable")]
    ids = np.concatenate([field.gaussian_ids[rows].astype(np.int64), seen])
    columns = _columns(field.evidence.masks, evidence.masks, changed)
    coded = _coded_again(field, rows, columns, evidence.rows(seen), ids, threads=threads, track=track)
    has_code = np.concatenate([np.ones(len(rows), np.bool_), coded.directed])
    ids = np.sort(ids[has_code]).astype(np.uint32)
    learnt = Learnt(growth.learnt_from, atoms=growth.scene_atoms)
    more = grown_of(provenance, growth.specification(field.code), evidence, ids, learnt, coded.scene_places)
    return LanguageField(
        ids, coded.code, field.encoder, field.scene, len(evidence), evidence.rows(ids),
        aggregator=field.aggregator, growth=more,
    )  # fmt: skip


def _can_stay(field: LanguageField, growth: Growth, evidence: Evidence, changed: Collection[str]) -> bool:
    """Return True if rows that have not changed have the same code as if all were coded anew."""
    how = aggregator(field.aggregator.name)
    code = chosen_code(growth.specification(field.code), evidence)
    assert field.evidence is not None
    if how.steps or how.voting or not evidence.weights.nnz or canonical(field.evidence) is not field.evidence:
        return False
    if isinstance(code, Codebook):
        return True
    if isinstance(code, Mixture) != isinstance(field.code, MixtureCode):
        return False  # another one is the smaller now
    most = max(len(field.evidence.masks), len(evidence.masks)) + len(growth.scene_atoms or ())
    if isinstance(code, Mixture) and most > MAX_ATOMS:
        return False  # columns were left out, or are now
    return growth.learnt_from == learning_views(evidence) and not set(changed) & set(growth.learnt_from)


def _columns(before: MaskIds, now: MaskIds, changed: Collection[str]) -> Ids:
    """Return the new number of each old column, GONE for those of views that have changed."""
    number = {name: place for place, name in enumerate(now.view_names)}
    views = np.array([REMOVED_COLUMN if name in changed else number[name] for name in before.view_names], np.int32)
    within = np.arange(len(before)) - np.searchsorted(before.views, before.views)
    stays = views[before.views]
    return np.where(stays == REMOVED_COLUMN, REMOVED_COLUMN, np.searchsorted(now.views, stays) + within).astype(
        np.int32
    )


def _coded_again(
    field: LanguageField,
    rows: OtherIndices,
    columns: OtherIds,
    some: Evidence,
    ids: Indices,
    *,
    threads: int,
    track: Track,
) -> Coded:
    """Return old codes of some rows and new ones of the evidence `some`, in the order of their ids."""
    if isinstance(field.code, MixtureCode):
        assert field.growth is not None
        places, scene = field.growth.scene_places, field.growth.scene_atoms
        before = Mixed(field.code, np.empty(0, np.int32) if places is None else places)
        again = regrown_mixture(before, scene, columns, rows, some, ids, threads=threads, track=track)
        return Coded(again.mixed.code, again.directed, again.mixed.scene_places)
    assert isinstance(field.code, PQCode)
    codes, directed = encode_features(MEAN(some), field.codebook, threads, track)
    codes = codes.rows(np.flatnonzero(directed))
    norms = np.concatenate([field.code.inverse_norms[rows], field.codebook.inverse_norms(codes)])
    order = np.argsort(np.concatenate([ids[: len(rows)], ids[len(rows) :][directed]]))
    both = zip(field.code.codes(rows), codes, strict=True)
    arrays = [None if new is None else np.concatenate([old, new])[order] for old, new in both]
    joined = Codes(*arrays)  # type: ignore[arg-type]  # that codes are never None is not told of both at once
    return Coded(pq_code(field.codebook, joined, norms[order]), directed)


def field_during(
    field: LanguageField, during: Span, gaussians: Gaussians | None = None, *, threads: int = 0
) -> LanguageField:
    """Return the field as if only the views of a span of time, its ends included, had been registered.

    It is coded with the same codebook, where it has one. Columns of the evidence keep their numbers. Words and
    negatives stay, objects do not.

    gaussians: the canonical ones, for aggregators that look at neighbours.

    Raises: InputError: a field without evidence or of a scene that stands still, no view in the span, or none that
    shows anything.
    """
    inside = views_during(field, during)
    evidence = whole_evidence(field)
    weights = evidence.weights
    entries = inside[evidence.masks.views][weights.indices]
    some = with_weights(evidence, np.where(entries, weights.data, np.float32(0)))
    how = aggregator(field.aggregator.name)
    aggregated = replace(how(some, gaussians, threads=threads), record=field.aggregator)
    wish = None if field.growth is None else field.growth.code
    code: PQ | Mixture | Codebook = Mixture() if wish is None or isinstance(wish, PQ) else Mixture(wish.atoms)
    if isinstance(field.code, PQCode):
        code = field.code.codebook
    made = build_field(some, field.scene, field.encoder, code, aggregated=aggregated, threads=threads)
    return replace(made, up=field.up, left_out=field.left_out).with_words_of(field, threads=threads)


def views_during(field: LanguageField, during: Span) -> Flags:
    """Return which views of a field were taken in a span of time. Raises: InputError: as `field_during`."""
    if field.evidence is None:
        raise InputError("during: this field holds no evidence of what the photos of that time have shown")
    if field.times is None:
        raise InputError("during: only fields of scenes that move have times: the photos of this one have none")
    start, end = during
    inside: np.ndarray = (field.times >= start) & (field.times <= end)
    if not inside.any():
        raise InputError(
            f"no photo was taken from {start:g} to {end:g}: those of this field are from {field.times.min():g} to "
            f"{field.times.max():g}"
        )
    return inside
