"""Every number that the optimisation of a scene depends on, with where it comes from.

Sources, in the comments by their letters:
  A  Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023), Sec. 5-7
     and supplement
  B  the published defaults of its optimiser (where the paper is silent), taken as facts
  C  Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo" (2024), Sec. 3-4
  D  ours

Schedules: values that change with the iteration, counted from 1.
"""

import json
import math
from dataclasses import asdict, dataclass
from typing import TypeVar

from ..errors import InputError

N = TypeVar("N", int, float)
STRATEGIES = ("default", "mcmc")
BACKGROUNDS = ("black", "white", "random")
NOT_OF_AN_ITERATION = ("evaluate_every", "photo_memory_bytes", "iterations")  # `iterations` alone may grow

_FROM_ZERO = (
    "seed", "sh_degree", "test_every", "evaluate_every", "refine_from", "full_size_from", "transients_at",
    "rates_fall_from", "refine_until", "photo_memory_bytes", "reset_recovery",
)  # fmt: skip
COARSE_SIZES = ((0.08, 4.0), (0.64, 2.0), (1.0, 1.5))
"""D: what the sides of photos are divided by, up to a share of the iterations before `full_size_from`."""
LAST_RATES_SHARE = 0.1  # D: of the rates that fall (`rates_fall_from`), at the last iteration


@dataclass(frozen=True)
class TrainingSettings:
    """Hyper-parameters; the defaults are those of the original method, `everyday` gives those of drsplat.

    Iteration numbers are absolute, as in the original: a run of 7,000 is the first 7,000 of the same schedule,
    densifies to its end and leaves the positions' rate where it is by then; only an opacity reset that the run is too
    short to recover from is left out. Lengths marked "extents" are in units of `scene_extent`.

    Raises: InputError: a value out of its range.
    """

    iterations: int = 30_000  # A: 30K; 7K is its short setting
    seed: int = 0
    background: str = "black"  # B; "random" is a new colour each iteration
    strategy: str = "default"  # A: adaptive density control; C: mcmc
    max_gaussians: int | None = None  # C: needed for mcmc; D: limits `default` too
    sh_degree: int = 3  # A: 4 bands
    sh_degree_every: int = 1000  # A: one more band every 1000 iterations
    dssim_weight: float = 0.2  # A: lambda
    antialiased: bool = False  # D: splats are dimmed as they are widened (Yu et al., "Mip-Splatting", 2024)
    colors_in_bytes: bool = False  # D: constant colours stay within 0 and 1, as viewers hold them in bytes
    test_every: int = 8  # A: every 8th photo is held out; 0: none
    full_size_from: int = 0  # D: photos are coarser before this iteration (`COARSE_SIZES`)
    transients_at: int = 0  # D: after this iteration what moves between photos is left out (`transients`); 0: never
    evaluate_every: int = 0  # D: also measure held-out photos on the way; 0: at the end only
    photo_memory_bytes: int = 2 << 30  # D: decoded photos that are kept; others are read again

    # rates of Adam (beta 0.9, 0.999; epsilon 1e-15: B)
    means_rate: float = 1.6e-4  # B: extents; decays exponentially (A) to
    means_rate_end: float = 1.6e-6  # B: extents, at
    means_rate_steps: int = 30_000  # B
    sh_rate: float = 2.5e-3  # B: the constant term
    sh_rest_rate: float = 2.5e-3 / 20  # B: all others
    logits_rate: float = 0.05  # B, 2023; later releases have 0.025
    scales_rate: float = 5e-3  # B: of the logarithm
    quats_rate: float = 1e-3  # B
    rates_fall_from: int = 0  # D: all rates but the positions' fall from this iteration to the last one; 0: never

    # where Gaussians start
    start_opacity: float | None = None  # B: 0.1; C: 0.5 with mcmc
    start_scale: float | None = None  # A: 1 distance to the neighbours; C: 0.1 with mcmc
    random_points: int = 100_000  # B: where the capture has no points and few are triangulated

    # how their number changes; to 15,000 and with resets by default, to 25,000 with mcmc
    refine_from: int = 500  # A, C
    refine_until: int | None = None  # B: 15,000; C: 25,000 with mcmc
    refine_every: int = 100  # A, C
    min_opacity: float = 0.005  # B, C: fainter ones are pruned (default) or moved (mcmc)

    opacity_penalty: float | None = None  # C: lambda_o, 0.01 with mcmc; A: none

    # adaptive density control (default)
    gradient_threshold: float = 2e-4  # A: tau_pos, of the centre in normalised device coordinates
    dense_scale: float = 0.01  # B: extents; larger Gaussians are split, smaller cloned
    split_shrink: float = 1.6  # A: phi
    reset_every: int = 3000  # A: opacity reset, every N = 3000
    reset_opacity: float = 0.01  # B
    reset_recovery: int = 500  # D: no reset within so many iterations of the end of a run
    max_scale: float = 0.1  # B: extents; larger ones are pruned after the first reset
    max_screen_px: float | None = None  # B says 20, but compares after clearing the radii: never

    # Markov chain Monte Carlo (mcmc)
    growth: float = 0.05  # C: more Gaussians per refinement
    noise_rate: float = 5e5  # C: lambda_noise
    noise_steepness: float = 100.0  # C: k
    noise_opacity: float = 0.005  # C: 1 - t, where the noise's sigmoid is a half
    scale_penalty: float = 0.01  # C: lambda_Sigma

    def __post_init__(self) -> None:
        for name, allowed in (("background", BACKGROUNDS), ("strategy", STRATEGIES), ("sh_degree", (0, 1, 2, 3))):
            if getattr(self, name) not in allowed:
                raise InputError(f"{name}: expected one of {allowed}, got {getattr(self, name)!r}")
        if self.strategy == "mcmc" and self.max_gaussians is None:
            raise InputError("strategy 'mcmc' fills a budget: set it with max_gaussians, e.g. 500,000")
        for name, value in vars(self).items():
            least = 0 if name in _FROM_ZERO else 4 if name == "max_gaussians" else 1  # sizes come from 3 neighbours
            if isinstance(value, int) and not isinstance(value, bool) and value < least:
                raise InputError(f"{name}: expected at least {least}, got {value}")
            if isinstance(value, float) and not 0 <= value < float("inf"):
                raise InputError(f"{name}: expected a finite number >= 0, got {value}")
        if self.test_every == 1:
            raise InputError("test_every: 1 would hold every photo out; 0 holds none out")
        if not (0 <= self.dssim_weight <= 1 and 0 < self.first_opacity < 1):
            raise InputError(
                f"dssim_weight must be in [0, 1] and start_opacity in (0, 1); got "
                f"{self.dssim_weight} and {self.first_opacity}"
            )

    def _else(self, chosen: N | None, default: N, mcmc: N) -> N:
        """Return what was chosen, else what is usual for the strategy."""
        return chosen if chosen is not None else mcmc if self.strategy == "mcmc" else default

    @property
    def first_opacity(self) -> float:
        return self._else(self.start_opacity, 0.1, 0.5)

    @property
    def first_scale(self) -> float:
        return self._else(self.start_scale, 1.0, 0.1)

    @property
    def last_refinement(self) -> int:
        return self._else(self.refine_until, 15_000, 25_000)

    @property
    def penalty_of_opacity(self) -> float:
        return self._else(self.opacity_penalty, 0.0, 0.01)

    @property
    def backdrop(self) -> tuple[float, float, float]:
        """Return the colour that held-out photos are rendered on."""
        return (1.0, 1.0, 1.0) if self.background == "white" else (0.0, 0.0, 0.0)

    @property
    def fingerprint(self) -> str:
        """JSON of what decides the result of an iteration: a run may go on only with the same."""
        return json.dumps({k: v for k, v in asdict(self).items() if k not in NOT_OF_AN_ITERATION}, sort_keys=True)


def means_rate(settings: TrainingSettings, iteration: int) -> float:
    """Return the rate of the positions, in extents: exponential from the first rate to the last, then constant.

    Source: 3DGS Sec. 7.1 ("standard exponential decay scheduling, similar to Plenoxels").
    """
    share = min(iteration / settings.means_rate_steps, 1.0)
    if settings.means_rate == 0 or settings.means_rate_end == 0:
        return settings.means_rate * (1 - share)
    first, last = math.log(settings.means_rate), math.log(settings.means_rate_end)
    return math.exp((1 - share) * first + share * last)


def other_rates_share(settings: TrainingSettings, iteration: int) -> float:
    """Return what share of their rates all parameters but the positions have: falls exponentially to the last one."""
    left = settings.iterations - settings.rates_fall_from
    if not settings.rates_fall_from or left <= 0:
        return 1.0
    return LAST_RATES_SHARE ** max((iteration - settings.rates_fall_from) / left, 0.0)


def active_sh_degree(settings: TrainingSettings, iteration: int) -> int:
    """Return the degree in use: one more every `sh_degree_every` iterations (3DGS Sec. 7.1)."""
    return min(settings.sh_degree, iteration // settings.sh_degree_every)


def divisor(settings: TrainingSettings, iteration: int) -> float:
    """Return what the sides of photos are divided by: coarse shapes first, as pixels are what a step costs."""
    return next((by for until, by in COARSE_SIZES if iteration < until * settings.full_size_from), 1.0)


def refines(settings: TrainingSettings, iteration: int) -> bool:
    """Return whether Gaussians are added and removed after this iteration; not after the last one."""
    last = min(settings.last_refinement, settings.iterations)
    inside = settings.refine_from < iteration < last
    return inside and iteration % settings.refine_every == 0


def resets_opacity(settings: TrainingSettings, iteration: int) -> bool:
    """Return True if opacities are reset after this iteration, in adaptive density control.

    A white background has one more reset, when refinement starts.

    Source: 3DGS Sec. 5.2; its published defaults for the white one.
    """
    last = min(settings.last_refinement - 1, settings.iterations - settings.reset_recovery)
    if not 0 < iteration <= last:
        return False
    first = settings.background == "white" and iteration == settings.refine_from
    return first or iteration % settings.reset_every == 0


def same_until(one: TrainingSettings, other: TrainingSettings, iteration: int) -> bool:
    """Return whether runs of these settings, which differ in their length alone, are one up to here.

    They are not where the shorter one left out an opacity reset that it was too short to recover from.
    """
    resets = range(1, iteration)  # the one of `iteration` itself is still to come
    return all(resets_opacity(one, i) == resets_opacity(other, i) for i in resets)
