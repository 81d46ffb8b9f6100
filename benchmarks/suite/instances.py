"""How well found regions are the true things of a scene, whatever they are called: AP and panoptic quality."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64, Integer

from drsplat.evaluation import scorers

LEAST = 60  # Gaussians: a smaller thing is void, and a smaller prediction is not looked at
VOID = 0.5  # of a prediction: with more than that on void it is neither right nor wrong
LEVELS = tuple(level / 100 for level in range(50, 100, 5))


class Region(NamedTuple):
    """ids: its Gaussians. score: how sure it is."""

    ids: Integer[np.ndarray, " m"]
    score: float


class Compared(NamedTuple):
    """Predictions, surest first, against true things. ious: of each with each. void: mostly on what is no thing.

    best: of each thing the IoU with the region most like it, however small that is.
    """

    scores: Float64[np.ndarray, " p"]
    ious: Float64[np.ndarray, "p t"]
    void: Bool[np.ndarray, " p"]
    sizes: Int64[np.ndarray, " t"]
    best: Float64[np.ndarray, " t"]


def compare(regions: Sequence[Region], owners: Integer[np.ndarray, " n"], things: Sequence[int]) -> Compared:
    """owners: per Gaussian a true number, -1 for none. things: numbers of what counts as a thing, if large enough."""
    sizes = np.bincount(owners[owners >= 0], minlength=max(things, default=0) + 1)
    kept = [thing for thing in things if sizes[thing] >= LEAST]
    column = np.full(len(sizes) + 1, len(kept))  # the last is void, for the number -1 as well
    column[kept] = np.arange(len(kept))
    regions = sorted(regions, key=lambda region: -region.score)
    counts = [np.bincount(column[owners[region.ids]], minlength=len(kept) + 1) for region in regions]
    shared = np.array(counts, float).reshape(len(regions), len(kept) + 1)
    total = shared.sum(1)
    ious = shared[:, :-1] / (total[:, None] + sizes[kept] - shared[:, :-1])
    void, scores = shared[:, -1] > VOID * total, np.array([region.score for region in regions], float)
    large = total >= LEAST
    return Compared(scores[large], ious[large], void[large], sizes[kept], ious.max(0, initial=0))


def average_precision(compared: Compared, level: float) -> float:
    """Area under precision over recall at an IoU above `level`, by trapezoids and from precision 1 at recall 0.

    The surest takes the free thing that it fits best. One that fits only things already taken is wrong; one that fits
    none is wrong unless it is void.

    Source: ScanNet's evaluation of instance segmentation.
    """
    right, counted = _matched(compared, level)
    scores, right = compared.scores[counted], right[counted]
    last = np.flatnonzero(np.append(np.diff(scores) != 0, True)[: len(scores)])  # of equal scores, all or none
    found = np.cumsum(right)[last]
    recall = np.append(0.0, found / max(len(compared.sizes), 1))
    precision = np.append(1.0, found / (last + 1))
    return float(np.trapezoid(precision, recall))


def panoptic_quality(compared: Compared) -> float:
    """Sum of IoUs of pairs above 0.5, over pairs and half of what is in no pair; void predictions are left out.

    Predictions may overlap: one that fits a thing that is taken is in no pair.

    Source: Kirillov et al., Panoptic Segmentation, Eq. 1.
    """
    right, counted = _matched(compared, 0.5)
    pairs = int(right.sum())
    quality = float(compared.ious[right].max(1, initial=0).sum())
    alone = int(counted.sum()) - pairs + len(compared.sizes) - pairs
    return quality / max(pairs + alone / 2, 1)


def numbers(compared: Compared) -> dict[str, float]:
    """All of one scene."""
    return {
        "AP": scorers.mean([average_precision(compared, level) for level in LEVELS]),
        "AP50": average_precision(compared, 0.5),
        "AP25": average_precision(compared, 0.25),
        "PQ": panoptic_quality(compared),
        "found": scorers.mean((compared.best >= 0.5).astype(float)),
        "mean IoU": scorers.mean(compared.best),
    }


def _matched(compared: Compared, level: float) -> tuple[Bool[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
    """Which predictions are right, and which are counted at all."""
    free = np.ones(len(compared.sizes), bool)
    right = np.zeros(len(compared.scores), bool)
    fits = compared.ious > level
    for number, fit in enumerate(fits):
        able = np.flatnonzero(fit & free)
        if len(able):
            right[number] = True
            free[able[compared.ious[number, able].argmax()]] = False
    return right, right | fits.any(1) | ~compared.void
