"""The objects of a scene as matches, and as nodes of the forest that they stand in.

Why an answer was given: the photos and masks behind a set of Gaussians.
"""

from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np

from ..base.arrays import Embedding, Float, RowIds, WholeNumbers
from ..errors import InputError
from ..field import LanguageField
from ..field.evidence.evidence import Explanation
from ..field.forest import Objects
from ..kernels.algebra import row_products
from .answer import Answer, Match

MAX_SUPPORT_MASKS = 3  # listed for an object


def objects_of(field: LanguageField) -> Objects:
    """Return the objects of a field. Raises: InputError: it has none."""
    if field.objects is None:
        raise InputError("nobody has looked for objects in this field: `drsplat objects FIELD --scene SCENE` does")
    return field.objects


def most_seen(objects: Objects, rows: WholeNumbers, weights: Float[np.ndarray, " n"]) -> int:
    """Return the row of the largest weight among those of the object that is seen most at a place."""
    numbers = objects.thing_of(rows)
    most = np.bincount(numbers + 1, weights).argmax() - 1
    return int(rows[np.where(numbers == most, weights, -1).argmax()])


def answer_of(field: LanguageField, nodes: Sequence[int], rule: str) -> Answer:
    """Return exactly some nodes, one or more. Raises: InputError: the field has no objects, or no such node."""
    objects = objects_of(field)
    return Answer.of_rows(field, np.concatenate([objects.rows(node) for node in nodes]), rule)


def match_of(field: LanguageField, node: int, label: str | None = None) -> Match:
    """Return a node as a match: its own box, and how far the photos agree on it as its score.

    Raises: InputError: the field has no objects, or no such node.
    """
    objects = objects_of(field)
    rows = objects.rows(node)
    number = int(objects.number_of[node])
    return Match(
        objects.centers[node],
        objects.axes[node],
        objects.extents[node],
        float(objects.sure[node]),
        field.gaussian_ids[rows].astype(np.int64),
        tuple(support_of(field, node))[:MAX_SUPPORT_MASKS],
        number if number >= 0 and objects.things[number] == node else None,
        label,
    )


def object_of(field: LanguageField, match: Match) -> int | None:
    """Return the number of the object that has most of a match's Gaussians, None where none has half of them."""
    if match.object_id is not None or field.objects is None:
        return match.object_id
    rows = field.rows_of(match.gaussian_ids)
    counts = np.bincount(field.objects.thing_of(rows[rows >= 0]) + 1, minlength=1)[1:]
    return int(counts.argmax()) if len(counts) and counts.max() >= len(match) / 2 else None


def support_of(field: LanguageField, node: int) -> Iterable[Explanation]:
    """Yield the masks that speak for a node, the largest share first; none where the field kept no evidence."""
    if field.evidence is None:
        return
    masks = field.evidence.masks
    for mask, share in zip(*objects_of(field).masks_of(node), strict=True):
        yield Explanation(masks.view_names[masks.views[mask]], int(masks.ids[mask]), float(share))


def photos_of(field: LanguageField, node: int) -> list[str]:
    """Return the names of the photos that show a node, those that show most of it first, by its masks."""
    shown: dict[str, float] = {}
    for mask in support_of(field, node):
        shown[mask.view_name] = shown.get(mask.view_name, 0.0) + mask.share
    return sorted(shown, key=lambda name: -shown[name])


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
