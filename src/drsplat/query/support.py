"""Why an answer was given: the photos and masks behind a set of Gaussians."""

from itertools import islice

import numpy as np

from ..base.arrays import Embedding, RowIds
from ..errors import InputError
from ..field import LanguageField
from ..field.evidence.evidence import Explanation
from ..kernels.algebra import row_products
from .answer import Answer, Match
from .objects import MAX_SUPPORT_MASKS, objects_of, support_of


def supporting_masks(field: LanguageField, gaussian_ids: RowIds, query: Embedding, top: int = 5) -> list[Explanation]:
    """Return the masks that speak most for `query` in all the Gaussians together: largest sum of W_ij <q, e_j>.

    Only what speaks for it is listed, so there may be fewer than `top`. Gaussians without a feature
    say nothing.

    Raises: InputError: the field was made without evidence.
    """
    if field.evidence is None:
        raise InputError("this field holds no evidence: register again and keep it")
    evidence = field.evidence
    rows = np.unique(field.rows_of(gaussian_ids))
    rows = rows[rows >= 0]
    weights = evidence.column_sums(rows).astype(np.float64)
    used = np.flatnonzero(weights)
    cosines = row_products(evidence.embeddings[used].astype(np.float64), query / np.linalg.norm(query))
    support = weights[used] * cosines
    total = support[support > 0].sum()
    order = np.argsort(-support, kind="stable")[:top]
    masks = evidence.masks
    return [
        Explanation(masks.view_names[masks.views[used[k]]], int(masks.ids[used[k]]), float(support[k] / total))
        for k in order
        if support[k] > 0
    ]


def support_in(match: Match, answer: Answer) -> tuple[Explanation, ...]:
    """Return the masks that support a match of an answer: those of its query, or of the object that it is."""
    field = answer.field
    if answer.vector is None and match.object_id is not None:
        return tuple(islice(support_of(field, objects_of(field).thing(match.object_id)), MAX_SUPPORT_MASKS))
    if field.evidence is None or answer.vector is None:
        return ()
    return tuple(supporting_masks(field, match.gaussian_ids, answer.vector, top=MAX_SUPPORT_MASKS))
