"""From what each Gaussian says to what whole objects say."""

import numpy as np
from jaxtyping import Float32

from ..field import LanguageField
from .thresholds import CUT, CUT_OF_OBJECTS


def by_object(field: LanguageField, values: Float32[np.ndarray, " r"]) -> Float32[np.ndarray, " r"]:
    """Values per row of a field: in an object the mean of all its rows, loose ones as they are.

    What single Gaussians at its border or in its shade say of a thing is noise; a thing is one of many that lie in
    the same masks. A field without objects gives the values themselves.
    """
    if field.objects is None or not len(values):
        return values
    numbers = field.objects.thing_of() + 1  # 0: loose
    counts = np.bincount(numbers, minlength=1)
    sums = np.bincount(numbers, values, minlength=1)
    means = (sums / np.maximum(counts, 1)).astype(np.float32)
    return np.where(numbers > 0, means[numbers], values)


def cut_of(field: LanguageField) -> float:
    """Of the way to the peak, where a query's values are cut."""
    return CUT if field.objects is None else CUT_OF_OBJECTS
