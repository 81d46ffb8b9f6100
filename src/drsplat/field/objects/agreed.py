"""Which objects photos agree on well enough to be shown to people first."""

import numpy as np

from ...base.arrays import Doubles, Flags, Numbers, WholeNumbers

MIN_AGREEMENT = 0.25
FEW_PHOTOS = 3  # or fewer: from most sides, nobody has seen the object
PRIOR_PHOTOS = 2  # of no object at all, counted with those of each object


def agreed(sure: Numbers, num_views: WholeNumbers) -> Flags:
    """Return per object whether photos agree on it: those that are listed first.

    An object of many photos needs a sureness of 0.25, one of three 0.42, of two 0.5 and of a single one 0.75.

    Args:
        sure: how well single masks fit each object, from 0 to 1, as of `Objects`.
        num_views: photos that see it.

    Source: chosen and measured by study_list.py, whose numbers are in docs/measured/objects.md.
    """
    return np.asarray(agreement(sure, num_views) >= MIN_AGREEMENT)


def agreement(sure: Numbers, num_views: WholeNumbers) -> Doubles:
    """Return the mean sureness of an object's photos and of two that know nothing of it.

    The two are there because a photo alone only agrees with itself. Arguments are those of `agreed`.
    """
    photos = num_views.astype(np.float64)
    return np.asarray(sure * photos / (photos + PRIOR_PHOTOS))
