"""Adaptive density control: Gaussians are cloned or split where the picture pulls at them.

Source: 3DGS Sec. 5.2 and its published defaults. Two things are ours and stated where they are: the
budget, and that a refinement comes after the optimiser's step and not in its place.

A budget of Gaussians that wander, die and come back where they are needed.

Source: Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo" (2024): Eq. 8 (noise), Eq. 9 (opacity and
covariance of Gaussians that share a place), Sec. 3 (relocation, growth by 5 %, regularisers).
"""

import math
from collections.abc import Callable
from math import comb, sqrt

import numpy as np

from ..base.arrays import Anywhere, Arrays, ArraysByName, Bool, Float32, Float64, Integer
from ..formats.activation import sigmoid
from ..kernels.cuda.devices import on_host, placed
from ..kernels.training import SceneParameters
from ..scene.gaussians import rotation_rows
from .optimizer import Optimizer, Slopes
from .settings import TrainingSettings, refines, resets_opacity

SPLIT_CHILDREN = 2
OBSERVED = ("pull", "times_seen", "radii")


class AdaptiveDensity:
    """Accumulates the screen-space gradients of all views since the last refinement."""

    def __init__(
        self, settings: TrainingSettings, extent: float, count: int, zeros: Callable[..., Anywhere] = np.zeros
    ) -> None:
        """Begin with nothing summed. zeros: of the library whose arrays the gradients are."""
        self.settings, self.extent, self._zeros = settings, extent, zeros
        self._forget(count)

    def _forget(self, count: int) -> None:
        self.pull, self.times_seen, self.radii = (self._zeros(count, np.float32) for _ in range(3))

    def observe(self, gradients: Slopes, iteration: int) -> None:
        """Take note of one view: who was pulled how far, and who was how large."""
        if iteration >= self.settings.last_refinement:
            return
        self.pull += gradients.screen
        self.times_seen += gradients.radii > 0
        np.maximum(self.radii, gradients.radii, out=self.radii)

    def penalize(self, optimizer: Optimizer, gradients: Slopes) -> None:
        """Add what the settings say of opacities; the original method penalises nothing but the picture."""
        add_opacity_penalty(optimizer, gradients, self.settings.penalty_of_opacity)

    def before_step(self, optimizer: Optimizer, iteration: int) -> None:
        """Reset, where the schedule says so of the iteration before this one.

        So what is seen between two iterations (scenes that are saved, measures, checkpoints) is as it was trained,
        not the moment when hardly anything is visible.
        """
        if resets_opacity(self.settings, iteration - 1):
            reset_opacity(optimizer, self.settings.reset_opacity)

    def after_step(self, optimizer: Optimizer, iteration: int, rng: np.random.Generator, rate: float) -> None:
        """Refine, where the schedule says so."""
        if not refines(self.settings, iteration):
            return
        small, large = self._chosen(optimizer)
        radii = np.concatenate([self.radii, self.radii[small], np.repeat(self.radii[large], SPLIT_CHILDREN)])
        clones = optimizer.rows(small)
        children = split(optimizer.rows(large), rng, self.settings.split_shrink)
        optimizer.append(clones)
        optimizer.append(children)
        gone = self._zeros(len(optimizer), bool)
        gone[np.flatnonzero(large)] = True
        s, parameters = self.settings, optimizer.parameters
        useless: Anywhere = parameters.logits < _logit(s.min_opacity)
        if iteration > s.reset_every:
            largest = parameters.log_scales.max(1)
            useless |= largest > math.log(s.max_scale * self.extent)
            if s.max_screen_px is not None:
                useless |= radii > s.max_screen_px
        if useless.all():  # rather a poor scene than none
            useless[parameters.logits.argmax()] = False
        gone |= useless
        optimizer.keep(~gone)
        self._forget(len(optimizer))

    def _chosen(self, optimizer: Optimizer) -> tuple[Bool[Anywhere, " n"], Bool[Anywhere, " n"]]:
        """Return marks of those to clone and of those to split."""
        mean_pull = self.pull / np.maximum(self.times_seen, 1)
        chosen = mean_pull >= self.settings.gradient_threshold
        if self.settings.max_gaussians is not None:
            # mark the `count` largest values, equal ones by index. Each clone or split adds one Gaussian.
            marked = np.zeros_like(mean_pull, bool)
            order: Integer[Anywhere, " n"] = np.argsort(-mean_pull, kind="stable")
            marked[order[: max(self.settings.max_gaussians - len(optimizer), 0)]] = True
            chosen &= marked
        largest = optimizer.parameters.log_scales.max(1)
        large = largest > math.log(self.settings.dense_scale * self.extent)
        return chosen & ~large, chosen & large

    def state(self) -> Arrays:
        return {f"density.{name}": on_host(getattr(self, name)) for name in OBSERVED}

    def restore(self, state: ArraysByName) -> None:
        for name in OBSERVED:
            setattr(self, name, placed(np.array(state[f"density.{name}"], np.float32), getattr(self, name)))


def split(parents: SceneParameters, rng: np.random.Generator, shrink: float = 1.6) -> SceneParameters:
    """Return two smaller Gaussians for each: places drawn from the parent's own distribution.

    Row order: the first child of every parent, then the second of every parent.
    Source: 3DGS Sec. 5.2 (scale divided by phi = 1.6).
    """
    twice = SceneParameters(*(np.concatenate([array] * SPLIT_CHILDREN) for array in parents))
    drawn = rng.standard_normal(twice.means.shape, np.float32)  # few: the host draws them for every device
    x, y, z = (placed(drawn, twice.means) * np.exp(twice.log_scales)).T
    offsets = np.stack([a * x + b * y + c * z for a, b, c in rotation_rows(unit(twice.quats).T)], -1)
    log_scales = twice.log_scales - np.float32(math.log(shrink))
    return twice._replace(means=twice.means + offsets, log_scales=log_scales)


def add_opacity_penalty(optimizer: Optimizer, gradients: Slopes, weight: float) -> None:
    """Add to the gradients those of weight x mean(opacity). Source: 3DGS as MCMC, Sec. 3.4."""
    if weight:
        opacities = sigmoid(optimizer.parameters.logits)
        gradients.logits[:] += np.float32(weight / len(optimizer)) * opacities * (1 - opacities)


def reset_opacity(optimizer: Optimizer, ceiling: float) -> None:
    """Lower all opacities to `ceiling`; those that are needed grow back (3DGS Sec. 5.2)."""
    logits = optimizer.parameters.logits
    np.minimum(logits, np.float32(_logit(ceiling)), out=logits)
    for moments in (optimizer.first, optimizer.second):
        moments.logits[:] = 0


def _logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))


def unit(quats: Float32[Anywhere, "n 4"]) -> Float32[Anywhere, "n 4"]:
    w, x, y, z = quats.T
    return quats / np.sqrt(w * w + x * x + y * y + z * z)[:, None]


def spread(
    quats: Float32[Anywhere, "n 4"], scales: Float32[Anywhere, "n 3"], vectors: Float32[Anywhere, "n 3"]
) -> Float32[Anywhere, "n 3"]:
    """Return the covariance times vector: R S S^T R^T v."""
    rows = rotation_rows(unit(quats).T)
    x, y, z = vectors.T
    local = [(rows[0][k] * x + rows[1][k] * y + rows[2][k] * z) * scales[:, k] ** 2 for k in range(3)]
    return np.stack([a * local[0] + b * local[1] + c * local[2] for a, b, c in rows], -1)


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
        # add noise in the shape of each Gaussian; none for those that are well visible (Eq. 8).
        s, p = self.settings, optimizer.parameters
        distance = s.noise_opacity - sigmoid(p.logits)
        strength = sigmoid(np.float32(s.noise_steepness) * distance.astype(np.float32))
        rows = np.flatnonzero(strength > MIN_STRENGTH)
        noise = optimizer.noise(rng, len(rows))
        noise *= (strength[rows] * np.float32(s.noise_rate * rate))[:, None]
        p.means[rows] += spread(p.quats[rows], np.exp(p.log_scales[rows]), noise)

    def state(self) -> Arrays:
        return {}

    def restore(self, state: ArraysByName) -> None:
        """Restore nothing: the generator's state is all that there is, and the loop restores it."""


def relocate(optimizer: Optimizer, rng: np.random.Generator, min_opacity: float) -> None:
    """Move each dead Gaussian onto a living one, drawn by opacity; all on a place share it."""
    opacities = sigmoid(optimizer.parameters.logits)
    dead, alive = (np.flatnonzero(mask) for mask in (opacities <= min_opacity, opacities > min_opacity))
    if len(dead) and len(alive):
        chosen = alive[drawn(opacities[alive], len(dead), rng)]
        optimizer.overwrite(dead, _shared(optimizer, chosen, min_opacity))


def grow(optimizer: Optimizer, rng: np.random.Generator, growth: float, limit: int, min_opacity: float) -> None:
    """Add a share of new Gaussians, up to the limit, on places drawn by opacity."""
    count = min(limit, int((1 + growth) * len(optimizer))) - len(optimizer)
    if count > 0:
        chosen = drawn(sigmoid(optimizer.parameters.logits), count, rng)
        optimizer.append(_shared(optimizer, chosen, min_opacity))


def _shared(optimizer: Optimizer, chosen: Integer[Anywhere, " m"], min_opacity: float) -> SceneParameters:
    """Give the Gaussians at `chosen` what each of several on their place must have, and return it."""
    places, guests = np.unique(chosen, return_counts=True)
    parameters = optimizer.parameters
    opacities = sigmoid(parameters.logits[places]).astype(np.float64)
    shared, shrink = shared_place(opacities, guests + 1)
    shared = np.clip(shared, min_opacity, MAX_OPACITY)
    parameters.logits[places] = np.log(shared) - np.log1p(-shared)
    parameters.log_scales[places] += np.log(shrink)[:, None].astype(np.float32)
    optimizer.forget(places)
    return optimizer.rows(chosen)


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
        # the integral of 1 - (1 - o g(x))^N along a line, in units of that of g, a Gaussian of unit height
        opacity = each[rows]
        total: Anywhere = sum(comb(n, k) * (-1) ** (k - 1) / sqrt(k) * opacity**k for k in range(1, n + 1))
        shrink[rows] = opacities[rows] / total
    return each, shrink


def drawn(weights: Float32[Anywhere, " n"], count: int, rng: np.random.Generator) -> Integer[Anywhere, " count"]:
    """Draw indices with replacement, in proportion to the weights."""
    steps = np.cumsum(weights, dtype=np.float64)
    at = np.searchsorted(steps, placed(rng.random(count), steps) * steps[-1], side="right")
    return np.minimum(at, len(weights) - 1)
