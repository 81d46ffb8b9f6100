"""How the number of Gaussians changes on the device: by gsplat's strategies, on our schedule.

Both are called after the optimiser's step, with iterations counted from 1.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from .schedules import refines, resets_opacity
from .settings import TrainingSettings
from .torch_parameters import DeviceParameters

# gsplat has these as constants
FIXED_BY_DEFAULT = {"split_shrink": 1.6, "max_screen_px": None}
FIXED_BY_MCMC = {"growth": 0.05, "noise_steepness": 100.0, "noise_opacity": 0.005}
OBSERVED = {"pull": "grad2d", "times_seen": "count"}  # ours, gsplat's


class Strategies(NamedTuple):
    """gsplat's two classes, or what stands in for them."""

    DefaultStrategy: Any
    MCMCStrategy: Any


def default_arguments(settings: TrainingSettings) -> dict[str, Any]:
    """Return the arguments of gsplat's DefaultStrategy.

    Its opacity reset never happens in 1.5 (an operator of the wrong precedence) and may in another
    release; an interval that is no whole number is met by no iteration, so that ours alone happens.
    """
    return {
        "prune_opa": settings.min_opacity,
        "grow_grad2d": settings.gradient_threshold,
        "grow_scale3d": settings.dense_scale,
        "prune_scale3d": settings.max_scale,
        "refine_start_iter": settings.refine_from,
        "refine_stop_iter": settings.last_refinement,
        "refine_every": settings.refine_every,
        "reset_every": settings.reset_every + 1e-3,
    }


def mcmc_arguments(settings: TrainingSettings) -> dict[str, Any]:
    """Return the arguments of gsplat's MCMCStrategy."""
    return {
        "cap_max": settings.max_gaussians,
        "noise_lr": settings.noise_rate,
        "refine_start_iter": settings.refine_from,
        "refine_stop_iter": min(settings.last_refinement, settings.iterations),
        "refine_every": settings.refine_every,
        "min_opacity": settings.min_opacity,
    }


def require_what_gsplat_can(settings: TrainingSettings) -> None:
    """Check the settings. Raises: InputError: a setting that gsplat has fixed at another value."""
    fixed = FIXED_BY_MCMC if settings.strategy == "mcmc" else FIXED_BY_DEFAULT
    for name, value in fixed.items():
        given = getattr(settings, name)
        if given != value:
            raise InputError(
                f"{name}: gsplat has {value} built in, got {given}: leave it, or train on the CPU (device 'cpu')"
            )


class DefaultControl:
    """Adaptive density control within a budget."""

    def __init__(self, settings: TrainingSettings, extent: float, scene: DeviceParameters, kinds: Strategies) -> None:
        self.settings, self.scene = settings, scene
        self.strategy = kinds.DefaultStrategy(**default_arguments(settings))
        self.strategy.check_sanity(scene.tensors, scene.adams)
        self.state: dict[str, Any] = self.strategy.initialize_state(scene_scale=extent)
        for theirs in OBSERVED.values():
            self.state[theirs] = torch.zeros(len(scene), device=scene.tensors["means"].device)

    def penalty(self) -> tuple[Tensor, ...]:
        """lambda_o mean(opacities), where the settings have one."""
        weight = self.settings.penalty_of_opacity
        return (weight * torch.sigmoid(self.scene.tensors["opacities"]).mean(),) if weight else ()

    def before_step(self, iteration: int) -> None:
        """Do as `density.AdaptiveDensity.before_step`."""
        if resets_opacity(self.settings, iteration - 1):
            self.scene.reset_opacity(self.settings.reset_opacity)

    def before_backward(self, seen: dict[str, Any], iteration: int) -> None:
        tensors, adams = self.scene.tensors, self.scene.adams
        self.strategy.step_pre_backward(tensors, adams, self.state, iteration, seen)

    def after_step(self, seen: dict[str, Any], iteration: int, rate: float) -> None:
        """seen: what `rasterization` returned about the view."""
        if iteration < self.settings.last_refinement:
            self._observe(seen)
        if refines(self.settings, iteration):
            self.strategy.grow_grad2d = self._threshold()
            tensors, adams = self.scene.tensors, self.scene.adams
            nobody = seen | {"radii": torch.zeros_like(seen["radii"])}  # they are observed already
            self.strategy.step_post_backward(tensors, adams, self.state, iteration, nobody, packed=False)

    @torch.no_grad()
    def _observe(self, seen: dict[str, Any]) -> None:
        """Observe as gsplat does, without the lists of those seen, for which the host would wait."""
        slopes = seen["means2d"].grad[0]
        pull = torch.hypot(slopes[:, 0] * (seen["width"] / 2), slopes[:, 1] * (seen["height"] / 2))
        self.state["grad2d"] += pull  # 0 of those not seen
        visible = (seen["radii"][0] > 0).all(-1)
        if seen.get("masked"):  # those that only left-out pixels show are not seen
            visible &= pull > 0
        self.state["count"] += visible

    def _threshold(self) -> float:
        """Return that of the settings, or one so high that no more grow than the budget has room for."""
        s = self.settings
        if s.max_gaussians is None:
            return s.gradient_threshold
        room = max(s.max_gaussians - len(self.scene), 0)
        pulls = self.state["grad2d"] / self.state["count"].clamp_min(1)
        if int((pulls > s.gradient_threshold).sum()) <= room:
            return s.gradient_threshold
        return float(torch.topk(pulls, room + 1).values[-1])

    def tell(self, density: Any) -> None:
        """Bring what was observed to the host, for a checkpoint."""
        density.radii = np.zeros(len(self.scene), np.float32)
        for ours, theirs in OBSERVED.items():
            setattr(density, ours, _copied(self.state[theirs]))

    def learn(self, density: Any) -> None:
        """Copy the density control's observations into gsplat's state."""
        device = self.scene.tensors["means"].device
        for ours, theirs in OBSERVED.items():
            self.state[theirs] = torch.tensor(getattr(density, ours), device=device)


class MonteCarloControl:
    """Relocation, growth to the budget, and noise."""

    def __init__(self, settings: TrainingSettings, extent: float, scene: DeviceParameters, kinds: Strategies) -> None:
        self.settings, self.scene = settings, scene
        self.strategy = kinds.MCMCStrategy(**mcmc_arguments(settings))
        self.strategy.check_sanity(scene.tensors, scene.adams)
        self.state: dict[str, Any] = self.strategy.initialize_state()

    def penalty(self) -> tuple[Tensor, ...]:
        """lambda_o mean(opacities) and lambda_Sigma mean(scales)."""
        s, tensors = self.settings, self.scene.tensors
        opacity = torch.sigmoid(tensors["opacities"]).mean()
        return s.penalty_of_opacity * opacity, s.scale_penalty * torch.exp(tensors["scales"]).mean()

    def before_step(self, iteration: int) -> None:
        """No opacity is reset."""

    def before_backward(self, seen: dict[str, Any], iteration: int) -> None:
        """Nothing to keep."""

    def after_step(self, seen: dict[str, Any], iteration: int, rate: float) -> None:
        """rate: of the positions in this iteration, in scene units."""
        tensors, adams = self.scene.tensors, self.scene.adams
        self.strategy.step_post_backward(tensors, adams, self.state, iteration, seen, lr=rate)

    def tell(self, density: Any) -> None:
        """Do nothing: this strategy remembers nothing."""

    def learn(self, density: Any) -> None:
        """Do nothing: this strategy remembers nothing."""


def _copied(tensor: Tensor) -> np.ndarray:
    return np.array(tensor.cpu().numpy(), np.float32)
