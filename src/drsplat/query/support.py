"""Why an answer was given: the photos and masks behind a set of Gaussians."""

import numpy as np
from jaxtyping import Float32, Integer

from ..errors import InputError
from ..evidence.evidence import Explanation
from ..field import LanguageField


def supporting_masks(
    field: LanguageField, gaussian_ids: Integer[np.ndarray, " m"], query: Float32[np.ndarray, " D"], top: int = 5
) -> list[Explanation]:
    """The masks that speak most for `query` in the Gaussians together: largest sum of W_ij <q, e_j>.

    Only what speaks for it is listed, so there may be fewer than `top`. Gaussians without a feature
    say nothing.

    Raises: InputError: the field was made without evidence.
    """
    if field.evidence is None:
        raise InputError("this field holds no evidence: register again and keep it")
    evidence = field.evidence
    rows = np.flatnonzero(np.isin(field.gaussian_ids, gaussian_ids))
    weights = np.asarray(evidence.weights[rows].sum(axis=0, dtype=np.float64)).ravel()
    used = np.flatnonzero(weights)
    support = weights[used] * (evidence.embeddings[used].astype(np.float64) @ (query / np.linalg.norm(query)))
    total = support[support > 0].sum()
    order = np.argsort(-support, kind="stable")[:top]
    masks = evidence.masks
    return [
        Explanation(masks.view_names[masks.views[used[k]]], int(masks.ids[used[k]]), float(support[k] / total))
        for k in order
        if support[k] > 0
    ]
