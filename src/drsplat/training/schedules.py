"""Schedules: values that change with the iteration, counted from 1."""

import math

from .settings import TrainingSettings


def means_rate(settings: TrainingSettings, iteration: int) -> float:
    """Return the rate of the positions, in extents: exponential from the first rate to the last, then constant.

    Source: 3DGS Sec. 7.1 ("standard exponential decay scheduling, similar to Plenoxels").
    """
    share = min(iteration / settings.means_rate_steps, 1.0)
    if settings.means_rate == 0 or settings.means_rate_end == 0:
        return settings.means_rate * (1 - share)
    first, last = math.log(settings.means_rate), math.log(settings.means_rate_end)
    return math.exp((1 - share) * first + share * last)


def active_sh_degree(settings: TrainingSettings, iteration: int) -> int:
    """Return the degree in use: one more every `sh_degree_every` iterations (3DGS Sec. 7.1)."""
    return min(settings.sh_degree, iteration // settings.sh_degree_every)


def divisor(settings: TrainingSettings, iteration: int) -> int:
    """Return what the sides of photos are divided by: coarse shapes first, as pixels are what a step costs."""
    if iteration >= settings.full_size_from:
        return 1
    return 4 if iteration < settings.full_size_from / 4 else 2


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
