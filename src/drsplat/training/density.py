"""Adaptive density control: Gaussians are cloned or split where the picture pulls at them.

Source: 3DGS Sec. 5.2 and its published defaults. Two things are ours and stated where they are: the
budget, and that a refinement comes after the optimiser's step and not in its place.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from ..base.arrays import Anywhere, Bool, Float32, Integer
from ..formats.activation import sigmoid
from ..kernels.cuda.devices import on_host, placed
from ..kernels.training import SceneParameters
from ..scene.gaussians import rotation_rows
from .optimizer import Optimizer, Slopes
from .schedules import refines, resets_opacity
from .settings import TrainingSettings

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
        if refines(self.settings, iteration):
            self._refine(optimizer, iteration, rng)

    def _refine(self, optimizer: Optimizer, iteration: int, rng: np.random.Generator) -> None:
        small, large = self._chosen(optimizer)
        radii = np.concatenate([self.radii, self.radii[small], np.repeat(self.radii[large], SPLIT_CHILDREN)])
        clones = optimizer.rows(small)
        children = split(optimizer.rows(large), rng, self.settings.split_shrink)
        optimizer.append(clones)
        optimizer.append(children)
        gone = self._zeros(len(optimizer), bool)
        gone[np.flatnonzero(large)] = True
        gone |= self._is_useless(optimizer, radii, iteration)
        optimizer.keep(~gone)
        self._forget(len(optimizer))

    def _chosen(self, optimizer: Optimizer) -> tuple[Bool[Anywhere, " n"], Bool[Anywhere, " n"]]:
        """Return marks of those to clone and of those to split."""
        mean_pull = self.pull / np.maximum(self.times_seen, 1)
        chosen = mean_pull >= self.settings.gradient_threshold
        if self.settings.max_gaussians is not None:
            chosen &= _largest(mean_pull, self.settings.max_gaussians - len(optimizer))
        largest = optimizer.parameters.log_scales.max(axis=1)
        large = largest > math.log(self.settings.dense_scale * self.extent)
        return chosen & ~large, chosen & large

    def _is_useless(self, optimizer: Optimizer, radii: Float32[Anywhere, " m"], iteration: int) -> Bool[Anywhere, " m"]:
        s, parameters = self.settings, optimizer.parameters
        useless: Anywhere = parameters.logits < _logit(s.min_opacity)
        if iteration > s.reset_every:
            largest = parameters.log_scales.max(axis=1)
            useless |= largest > math.log(s.max_scale * self.extent)
            if s.max_screen_px is not None:
                useless |= radii > s.max_screen_px
        if useless.all():  # rather a poor scene than none
            useless[parameters.logits.argmax()] = False
        return useless

    def state(self) -> dict[str, np.ndarray]:
        return {f"density.{name}": on_host(getattr(self, name)) for name in OBSERVED}

    def restore(self, state: Mapping[str, np.ndarray]) -> None:
        for name in OBSERVED:
            setattr(self, name, placed(np.array(state[f"density.{name}"], np.float32), getattr(self, name)))


def split(parents: SceneParameters, rng: np.random.Generator, shrink: float = 1.6) -> SceneParameters:
    """Return two smaller Gaussians for each: places drawn from the parent's own distribution.

    Row order: the first child of every parent, then the second of every parent.
    Source: 3DGS Sec. 5.2 (scale divided by phi = 1.6).
    """
    twice = SceneParameters(*(np.concatenate([array] * SPLIT_CHILDREN) for array in parents))
    drawn = rng.standard_normal(twice.means.shape, np.float32)  # few: the host draws them for every device
    local = placed(drawn, twice.means) * np.exp(twice.log_scales)
    means = twice.means + rotated(twice.quats, local)
    log_scales = twice.log_scales - np.float32(math.log(shrink))
    return twice._replace(means=means, log_scales=log_scales)


def add_opacity_penalty(optimizer: Optimizer, gradients: Slopes, weight: float) -> None:
    """Add to the gradients those of weight x mean(opacity). Source: 3DGS as MCMC, Sec. 3.4."""
    if weight:
        opacities = sigmoid(optimizer.parameters.logits)
        gradients.logits[:] += np.float32(weight / len(optimizer)) * opacities * (1 - opacities)


def reset_opacity(optimizer: Optimizer, ceiling: float) -> None:
    """Lower all opacities to `ceiling`; those that are needed grow back (3DGS Sec. 5.2)."""
    logits = np.minimum(optimizer.parameters.logits, np.float32(_logit(ceiling)))
    optimizer.replace_logits(logits)


def _logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))


def _largest(values: Float32[Anywhere, " n"], count: int) -> Bool[Anywhere, " n"]:
    """Mark the `count` largest values, equal ones by index. Each clone or split adds one Gaussian."""
    marked = np.zeros_like(values, bool)
    order: Integer[Anywhere, " n"] = np.argsort(-values, kind="stable")
    marked[order[: max(count, 0)]] = True
    return marked


def unit(quats: Float32[Anywhere, "n 4"]) -> Float32[Anywhere, "n 4"]:
    w, x, y, z = quats.T
    unit: Anywhere = quats / np.sqrt(w * w + x * x + y * y + z * z)[:, None]
    return unit


def rotated(quats: Float32[Anywhere, "n 4"], vectors: Float32[Anywhere, "n 3"]) -> Float32[Anywhere, "n 3"]:
    """Rotate vectors from the local axes of each row to the world."""
    x, y, z = vectors.T
    turned: Anywhere = np.stack([a * x + b * y + c * z for a, b, c in rotation_rows(unit(quats).T)], -1)
    return turned


def spread(
    quats: Float32[Anywhere, "n 4"], scales: Float32[Anywhere, "n 3"], vectors: Float32[Anywhere, "n 3"]
) -> Float32[Anywhere, "n 3"]:
    """Return the covariance times vector: R S S^T R^T v."""
    rows = rotation_rows(unit(quats).T)
    x, y, z = vectors.T
    local = [(rows[0][k] * x + rows[1][k] * y + rows[2][k] * z) * scales[:, k] ** 2 for k in range(3)]
    world: Anywhere = np.stack([a * local[0] + b * local[1] + c * local[2] for a, b, c in rows], -1)
    return world
