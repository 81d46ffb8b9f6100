"""Colours in viewers that keep a Gaussian's constant colour in a byte for each channel.

Spark and GaussianSplats3D round 0.5 + SH_C0 * sh[:, 0] to bytes, add the harmonics and clamp again. A constant colour
above 1 or below 0 is shown there as 1 or 0.
"""

from dataclasses import replace

import numpy as np

from ..base.arrays import Array, Flags, Float64, Harmonics, Points
from .gaussians import SH_C0, Gaussians
from .similarity import sh_basis

NUM_DIRECTIONS, FIT_ROUNDS, CHUNK_ROWS = 128, 30, 4096
MAX_ABS_CONSTANT = 0.5 / SH_C0  # of a coefficient sh[:, 0] whose colour is between 0 and 1
BYTE_ROUNDING = 0.5 / 255  # of a colour


def clamped_in_bytes(gaussians: Gaussians) -> Flags:
    """Return which Gaussians have a constant colour that a byte for each channel does not hold."""
    return np.any(np.abs(SH_C0 * gaussians.sh[:, 0]) > 0.5 + BYTE_ROUNDING, 1)


def fitted_to_8_bits(gaussians: Gaussians) -> Gaussians:
    """Return the scene with constant colours from 0 to 1, and harmonics that change least what is seen of it.

    The colours of a Gaussian in all directions, between 0 and 1, are fitted in least squares by those that such a
    viewer shows of it. Gaussians whose constant colours fit into bytes stay as they are, to the bit.
    """
    rows = np.flatnonzero(clamped_in_bytes(gaussians))
    sh = gaussians.sh.copy()
    basis = sh_basis(_directions(NUM_DIRECTIONS))[:, : sh.shape[1]]
    for at in range(0, len(rows), CHUNK_ROWS):
        some = rows[at : at + CHUNK_ROWS]
        sh[some] = _fitted(sh[some].astype(np.float64), basis)
    return replace(gaussians, sh=sh)


def _directions(count: int) -> Points:
    """Return unit vectors that are spread evenly over a sphere (Fibonacci's lattice)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _fitted(sh: Float64[Array, "n k 3"], basis: Float64[Array, "d k"]) -> Harmonics:
    """Fit harmonics of limited constants to the clamped colours of `sh`, by projected steps that never fit worse."""
    wanted = np.clip(0.5 + basis @ sh, 0, 1)
    fitted, inverse = _within(sh.copy()), np.linalg.pinv(basis)
    for _ in range(FIT_ROUNDS):
        fitted = _within(fitted + inverse @ (wanted - np.clip(0.5 + basis @ fitted, 0, 1)))
    return fitted.astype(np.float32)


def _within(sh: Float64[Array, "n k 3"]) -> Float64[Array, "n k 3"]:
    sh[:, 0] = np.clip(sh[:, 0], -MAX_ABS_CONSTANT, MAX_ABS_CONSTANT)
    return sh
