"""A field of a film, of what the photos of a span of time have shown."""

from dataclasses import replace

import numpy as np

from ..base.arrays import Bool
from ..errors import InputError
from ..scene.gaussians import Gaussians
from ..scene.moving import Span
from .building import build_field
from .codes import PQ, Codebook, Mixture, PQCode
from .evidence.aggregation import aggregator
from .evidence.aggregation.entries import with_weights
from .language_field import LanguageField
from .regrowing import whole_evidence


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
    made = build_field(some, field.scene, field.encoder, _code(field), aggregated=aggregated, threads=threads)
    return replace(made, up=field.up, left_out=field.left_out).with_words_of(field, threads=threads)


def views_during(field: LanguageField, during: Span) -> Bool[np.ndarray, " v"]:
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


def _code(field: LanguageField) -> PQ | Mixture | Codebook:
    """Return the specification of the field's code: its codebook, or as many masks for each row."""
    if isinstance(field.code, PQCode):
        return field.code.codebook
    wish = None if field.growth is None else field.growth.code
    return Mixture() if wish is None or isinstance(wish, PQ) else Mixture(wish.atoms)
