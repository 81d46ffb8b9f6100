"""A budget of Gaussians that wander, die and come back where they are needed.

Source: Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo" (2024): Eq. 8 (noise), Eq. 9 (opacity and
covariance of Gaussians that share a place), Sec. 3 (relocation, growth by 5 %, regularisers).
"""

from collections.abc import Mapping
from math import comb, sqrt

import numpy as np

from ..base.arrays import Anywhere, Float32, Float64, Integer
from ..formats.activation import sigmoid
from ..kernels.cuda.devices import placed
from .density import add_opacity_penalty, spread
from .optimizer import Optimizer, Slopes
from .schedules import refines
from .settings import TrainingSettings

MAX_SHARING = 51  # Gaussians in one place; beyond, the series of Eq. 9 loses its digits (the published constant)
MIN_STRENGTH = 1e-6  # at opacity 0.14; weaker noise is lost in the positions' last digits
MAX_OPACITY = 1 - 1e-6


class MonteCarlo:
    """Relocates the dead, grows to the budget, and shakes what is faint."""

    def __init__(self, settings: TrainingSettings, extent: float, count: int) -> None:
        self.settings, self.extent = settings, extent

    def observe(self, gradients: Slopes, iteration: int) -> None:
        """Observe nothing: chance decides here, not the gradients."""

    def penalize(self, optimizer: Optimizer, gradients: Slopes) -> None:
        """Add to the gradients those of lambda_o mean(o) + lambda_Sigma mean(scales)."""
        add_opacity_penalty(optimizer, gradients, self.settings.penalty_of_opacity)
        weight = np.float32(self.settings.scale_penalty / (3 * len(optimizer)))
        gradients.log_scales[:] += weight * np.exp(optimizer.parameters.log_scales)

    def before_step(self, optimizer: Optimizer, iteration: int) -> None:
        """Reset no opacity."""

    def after_step(self, optimizer: Optimizer, iteration: int, rng: np.random.Generator, rate: float) -> None:
        """Relocate, add and shake Gaussians. rate: of the positions in this iteration, in scene units."""
        if refines(self.settings, iteration):
            relocate(optimizer, rng, self.settings.min_opacity)
            limit = self.settings.max_gaussians or 0
            grow(optimizer, rng, self.settings.growth, limit, self.settings.min_opacity)
        self._shake(optimizer, rng, rate)

    def _shake(self, optimizer: Optimizer, rng: np.random.Generator, rate: float) -> None:
        """Add noise in the shape of each Gaussian; none for those that are well visible (Eq. 8)."""
        s, p = self.settings, optimizer.parameters
        distance = s.noise_opacity - sigmoid(p.logits)
        strength = sigmoid(np.float32(s.noise_steepness) * distance.astype(np.float32))
        rows = np.flatnonzero(strength > MIN_STRENGTH)
        noise = optimizer.noise(rng, len(rows))
        noise *= (strength[rows] * np.float32(s.noise_rate * rate))[:, None]
        p.means[rows] += spread(p.quats[rows], np.exp(p.log_scales[rows]), noise)

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore nothing: the generator's state is all that there is, and the loop restores it."""


def relocate(optimizer: Optimizer, rng: np.random.Generator, min_opacity: float) -> None:
    """Move each dead Gaussian onto a living one, drawn by opacity; all on a place share it."""
    opacities = sigmoid(optimizer.parameters.logits)
    dead, alive = (np.flatnonzero(mask) for mask in (opacities <= min_opacity, opacities > min_opacity))
    if len(dead) == 0 or len(alive) == 0:
        return
    chosen = alive[drawn(opacities[alive], len(dead), rng)]
    _share(optimizer, chosen, min_opacity)
    optimizer.overwrite(dead, optimizer.rows(chosen))


def grow(optimizer: Optimizer, rng: np.random.Generator, growth: float, limit: int, min_opacity: float) -> None:
    """Add a share of new Gaussians, up to the limit, on places drawn by opacity."""
    count = min(limit, int((1 + growth) * len(optimizer))) - len(optimizer)
    if count <= 0:
        return
    chosen = drawn(sigmoid(optimizer.parameters.logits), count, rng)
    _share(optimizer, chosen, min_opacity)
    optimizer.append(optimizer.rows(chosen))


def _share(optimizer: Optimizer, chosen: Integer[Anywhere, " m"], min_opacity: float) -> None:
    """Give the Gaussians at `chosen` what each of several on their place must have."""
    places, guests = np.unique(chosen, return_counts=True)
    parameters = optimizer.parameters
    opacities = sigmoid(parameters.logits[places]).astype(np.float64)
    shared, shrink = shared_place(opacities, guests + 1)
    shared = np.clip(shared, min_opacity, MAX_OPACITY)
    parameters.logits[places] = np.log(shared) - np.log1p(-shared)
    parameters.log_scales[places] += np.log(shrink)[:, None].astype(np.float32)
    optimizer.forget(places)


def shared_place(
    opacities: Float64[Anywhere, " n"], sharing: Integer[Anywhere, " n"]
) -> tuple[Float64[Anywhere, " n"], Float64[Anywhere, " n"]]:
    """Return the opacity of each of N Gaussians on one place, and the factor on their scales (Eq. 9).

    N of them in front of each other block as much light at the centre as the one did; the factor
    keeps the integral of the opacity along a line through it.
    """
    sharing = np.minimum(sharing, MAX_SHARING)
    opacities = np.minimum(opacities, MAX_OPACITY)
    each = -np.expm1(np.log1p(-opacities) / sharing)
    shrink = np.ones_like(opacities)
    for n in map(int, np.unique(sharing)):
        rows = sharing == n
        shrink[rows] = opacities[rows] / _line_integral(each[rows], n)
    return each, shrink


def _line_integral(opacity: Float64[Anywhere, " n"], sharing: int) -> Float64[Anywhere, " n"]:
    """Return the integral of 1 - (1 - o g(x))^N along a line, in units of that of g, a Gaussian of unit height.

    Sum over i = 1..N, k = 0..i-1 of C(i-1, k) (-1)^k o^(k+1) / sqrt(k+1); over i first, that is C(N, k+1).
    """
    terms = [comb(sharing, k) * (-1) ** (k - 1) / sqrt(k) * opacity**k for k in range(1, sharing + 1)]
    total: Anywhere = sum(terms[1:], terms[0])
    return total


def drawn(weights: Float32[Anywhere, " n"], count: int, rng: np.random.Generator) -> Integer[Anywhere, " count"]:
    """Draw indices with replacement, in proportion to the weights."""
    steps = np.cumsum(weights, dtype=np.float64)
    at = np.searchsorted(steps, placed(rng.random(count), steps) * steps[-1], side="right")
    inside: Anywhere = np.minimum(at, len(weights) - 1)
    return inside
