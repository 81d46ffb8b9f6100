"""From what each Gaussian says to what whole objects say."""

import numpy as np
from jaxtyping import Float32

from ..field import LanguageField
from ..field.objects import Objects
from .thresholds import CUT, CUT_OF_OBJECTS


def by_object(
    field: LanguageField, values: Float32[np.ndarray, " r"], query: Float32[np.ndarray, " D"] | None = None
) -> Float32[np.ndarray, " r"]:
    """Values per row of a field: in an object those of the whole, loose ones as they are.

    What single Gaussians at its border or in its shade say of a thing is noise: a whole has the mean of its rows. Of
    cosines, with their unit query, it is the mean of that and of the cosine with the descriptor that fits best, which
    the masks that hold nothing else have most part in. A field without objects gives the values themselves.
    """
    if field.objects is None or not len(values):
        return values
    numbers = field.objects.thing_of() + 1  # 0: loose
    counts = np.bincount(numbers, minlength=1)
    means = np.bincount(numbers, values, minlength=1) / np.maximum(counts, 1)
    if query is not None:
        means[1:] = (means[1:] + _best_descriptors(field.objects, query)[: len(means) - 1]) / 2
    return np.where(numbers > 0, means.astype(np.float32)[numbers], values)


def _best_descriptors(objects: Objects, query: Float32[np.ndarray, " D"]) -> Float32[np.ndarray, " o"]:
    """Per object the highest cosine of a query with one of its descriptors."""
    cosines = objects.descriptors @ (query / np.linalg.norm(query))
    starts = objects.descriptor_starts
    best = np.full(objects.num_nodes, -1, np.float32)
    (some,) = np.nonzero(np.diff(starts))
    if len(some):
        best[some] = np.maximum.reduceat(cosines, starts[some])
    return np.asarray(best[objects.things])


def cut_of(field: LanguageField) -> float:
    """Of the way to the peak, where a query's values are cut."""
    return CUT if field.objects is None else CUT_OF_OBJECTS
