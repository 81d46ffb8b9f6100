"""Why an answer is bad: what each step from the photos to the answer loses, measured with the truth.

| cause | what is lost there |
|---|---|
| scene | 1, less the IoU in photos of the thing's true Gaussians, drawn alone into the scene, with its outline |
| masks | 1, less the IoU of the best threshold on the share of each Gaussian's weight that is in masks of the thing |
| encoder | that IoU, less the one of the best threshold on the answer of the plain field |
| threshold | that IoU, less the one of the plain field at its own threshold |
| objects | that IoU, less the one of the answer in whole objects |

The cause is the step that loses most.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int32

from drsplat import View
from drsplat.drawing.pictures import visible_share
from drsplat.kernels import SplatArrays, splat_arrays

from .answers import Answered, best_iou
from .outlines import iou
from .places import SIDE, Place
from .trials import Trial

SHOWN = 0.5  # of a pixel: what a selection is most of
PHOTOS = 4  # those with the largest outlines of a thing


CAUSES = ("scene", "masks", "encoder", "threshold", "objects")


class Steps(NamedTuple):
    """IoU after each step, from 0 to 1."""

    scene: float
    masks: float
    best: float
    plain: float
    objects: float

    @property
    def losses(self) -> dict[str, float]:
        """By cause.

        >>> Steps(0.9, 0.8, 0.7, 0.3, 0.35).losses["threshold"]
        0.39999999999999997
        """
        lost = (
            1 - self.scene,
            1 - self.masks,
            self.masks - self.best,
            self.best - self.plain,
            self.plain - self.objects,
        )
        return dict(zip(CAUSES, lost, strict=True))

    @property
    def cause(self) -> str:
        """The step that loses most.

        >>> Steps(0.9, 0.8, 0.7, 0.3, 0.35).cause
        'threshold'
        """
        losses = self.losses
        return max(losses, key=lambda name: losses[name])


@dataclass(frozen=True, eq=False)
class Seen:
    """A photo in which a thing was outlined. view: without lens, of the size that pictures are drawn in."""

    stored: View
    view: View
    outline: Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Culprits:
    """The steps of answers in one place; what is drawn for one is kept for the others."""

    place: Place

    @cached_property
    def splats(self) -> SplatArrays:
        return splat_arrays(self.place.gaussians)

    @cached_property
    def covered(self) -> dict[tuple[int, ...], float]:
        """Mean IoU of the true Gaussians of some things with their outlines, as far as anybody asked."""
        return {}

    def steps(self, case: Trial, answer: Answered) -> Steps:
        things = self.things(case, answer.text)
        masks = self.best_of_masks(case, answer.text, things)
        return Steps(self.cover(things), masks, answer.best, answer.plain, answer.objects)

    def cover(self, things: Int32[np.ndarray, " t"]) -> float:
        """Return how well the scene shows some things; 1, so that it is no cause, where no photo has their outline."""
        key = tuple(things.tolist())
        if key not in self.covered:
            ids = np.flatnonzero(np.isin(self.place.labels, things))
            ious = [iou(self.drawn(seen.view, ids), seen.outline) for seen in self.seen(things)]
            self.covered[key] = float(np.mean(ious)) if ious else 1.0
        return self.covered[key]

    def things(self, case: Trial, text: str) -> Int32[np.ndarray, " t"]:
        """Return the numbers of what is called so."""
        labels = self.place.labels[case.field.gaussian_ids]
        return np.unique(labels[case.present[text]])

    def best_of_masks(self, case: Trial, text: str, things: Int32[np.ndarray, " t"]) -> float:
        """Return what an encoder without a fault would reach: each mask shows the thing that it shows most of."""
        theirs = np.isin(self.place.owners, things).astype(np.float64)
        weights = self.place.evidence.weights[case.field.gaussian_ids]
        share = (weights @ theirs) / np.maximum(np.asarray(weights.sum(1)).ravel(), 1e-12)
        return best_iou(share, case.present[text], case.mass)

    def seen(self, things: Int32[np.ndarray, " t"]) -> list[Seen]:
        """Return the photos with the largest outlines of some things, the largest first."""
        found = sorted(self._seen(things), key=lambda seen: -np.count_nonzero(seen.outline))
        return found[:PHOTOS]

    def _seen(self, things: Int32[np.ndarray, " t"]) -> Iterator[Seen]:
        for stored in self.place.views:
            view = _pinhole(stored)
            outline = _nearest(np.isin(self.place.shown(stored), things), view)
            if outline.any():
                yield Seen(stored, view, outline)

    def drawn(self, view: View, ids: np.ndarray) -> Bool[np.ndarray, "h w"]:
        """Return where Gaussians are most of what is seen, behind what hides them."""
        shown: np.ndarray = visible_share(self.place.gaussians, view, ids, splats=self.splats) > SHOWN
        return shown


def _pinhole(view: View) -> View:
    return replace(view, distortion=None).limited(SIDE)


def _nearest(mask: Bool[np.ndarray, "h w"], view: View) -> Bool[np.ndarray, "_ _"]:
    """Return a mask at the size of a view."""
    rows = (np.arange(view.height) + 0.5) * mask.shape[0] / view.height
    columns = (np.arange(view.width) + 0.5) * mask.shape[1] / view.width
    result: np.ndarray = mask[rows.astype(int)[:, None], columns.astype(int)]
    return result
