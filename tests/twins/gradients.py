"""The float64 twin of the backward pass: central differences of the image, its decisions held.

Source: Kerbl et al. 2023 (3D Gaussian Splatting) Sec. 4, 5.2 (the densification measure).
"""

from typing import NamedTuple

import numpy as np

from drsplat.base.arrays import Doubles, Float, Float64, Points
from drsplat.scene.views import View

from .training import Branches, Entries, Footprints, Parameters, alphas_of, composite, decide, float64_of, footprints

# Half widths of the differences. An image is linear in sh, and 1e-4 pixel is little.
STEPS = {"means": 1e-5, "log_scales": 1e-5, "quats": 1e-5, "logits": 1e-4, "sh": 1e-3}
CENTER_STEP = 1e-4


class Gradients(NamedTuple):
    """Derivatives by each parameter, and by the projected centre; all 0 where nothing is seen.

    screen: length of the derivative by the centre in normalised device coordinates, in which an image
    is 2 wide and 2 high.
    """

    means: Points
    log_scales: Points
    quats: Float64[np.ndarray, "n 4"]
    logits: Doubles
    sh: Float64[np.ndarray, "n k 3"]
    screen: Doubles


def gradients(
    parameters: Parameters,
    view: View,
    sh_degree: int,
    background: Float[np.ndarray, " 3"],
    image_gradient: Float[np.ndarray, "h w 3"],
    antialiased: bool = False,
) -> Gradients:
    """Central differences of sum(image * image_gradient) by every parameter, the decisions held.

    One Gaussian is moved at a time, and only the pixels that it adds to are composited again.
    """
    scene = float64_of(parameters)
    decisions = decide(scene, view, sh_degree, antialiased=antialiased)
    marks = footprints(scene, view, sh_degree, decisions.branches, antialiased)
    out = Gradients(*(np.zeros_like(column) for column in [*scene, scene.logits]))
    for i in np.unique(decisions.entries.ids).tolist():
        loss = _LossOfOne(i, marks, decisions.entries, view, background, image_gradient)
        branches = Branches(*(column[[i]] for column in decisions.branches))
        for name, step in STEPS.items():
            up, down = (
                loss(footprints(_variants(scene, i, name, h), view, sh_degree, branches, antialiased))
                for h in (step, -step)
            )
            column = getattr(out, name)
            column[i] = ((up - down) / (2 * step)).reshape(column[i].shape)
        by_center = loss(_shifted(marks, i, CENTER_STEP)) - loss(_shifted(marks, i, -CENTER_STEP))
        half_size = 0.5 * np.array([view.width, view.height])
        out.screen[i] = np.linalg.norm(by_center / (2 * CENTER_STEP) * half_size)
    return out


class _LossOfOne:
    """sum(image * image_gradient) over the pixels of Gaussian i, as a function of its footprint."""

    def __init__(
        self,
        i: int,
        marks: Footprints,
        entries: Entries,
        view: View,
        background: Float[np.ndarray, " 3"],
        image_gradient: Float[np.ndarray, "h w 3"],
    ) -> None:
        touched = np.isin(entries.pixels, entries.pixels[entries.ids == i])
        near = Entries(*(column[touched] for column in entries))
        self.pixels, self.width, self.background = near.pixels, view.width, background
        self.alphas, self.colors = alphas_of(marks, near, view.width), marks.colors[near.ids]
        self.own = near.ids == i
        alone = Entries(*(column[self.own] for column in near))
        self.entries = alone._replace(ids=np.zeros_like(alone.ids))  # of footprints of one row
        self.weights = image_gradient.reshape(-1, 3)[np.unique(near.pixels)]

    def __call__(self, variants: Footprints) -> Float64[np.ndarray, " v"]:
        losses = np.empty(len(variants.opacities))
        for v in range(len(losses)):
            moved = Footprints(*(column[[v]] for column in variants))
            self.alphas[self.own] = alphas_of(moved, self.entries, self.width)
            self.colors[self.own] = moved.colors
            rows = composite(self.alphas, self.colors, self.pixels, self.background)
            losses[v] = (rows * self.weights).sum()
        return losses


def _variants(scene: Parameters, i: int, name: str, step: float) -> Parameters:
    """Copies of Gaussian i, each with one number of one parameter moved by `step`."""
    count = getattr(scene, name)[i].size
    copies = Parameters(*(np.repeat(column[[i]], count, axis=0) for column in scene))
    getattr(copies, name).reshape(count, count)[np.diag_indices(count)] += step
    return copies


def _shifted(marks: Footprints, i: int, step: float) -> Footprints:
    """Two copies of a footprint: its centre moved along x, and along y."""
    copies = Footprints(*(np.repeat(column[[i]], 2, axis=0) for column in marks))
    return copies._replace(centers=copies.centers + step * np.eye(2))
