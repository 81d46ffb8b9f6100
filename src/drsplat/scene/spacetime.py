"""Gaussians that move along polynomials, and come and go (Li et al., "Spacetime Gaussian Feature Splatting", 2024)."""

from dataclasses import dataclass, replace

import numpy as np

from ..base.arrays import Float32, Float64
from ..errors import InputError
from .gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class Spacetime:
    """Motion along polynomials, with opacity over time.

    With dt = t - center: x(t) = x + m_0 dt + m_1 dt^2 + m_2 dt^3, q(t) = q + w dt normalised, and
    o(t) = o exp(-(dt / width)^2).

    canonical: each row at its own centre. centers: times at which rows are most opaque. widths: above 0, in units of
    time. motion: coefficients of dt, dt^2 and dt^3, scene units. turning: w, of unit quaternions.

    Raises: InputError: arrays that do not fit each other, or are not finite.
    """

    canonical: Gaussians
    centers: Float32[np.ndarray, " n"]
    widths: Float64[np.ndarray, " n"]
    motion: Float32[np.ndarray, "n 3 3"]
    turning: Float64[np.ndarray, "n 4"]

    def __post_init__(self) -> None:
        count = len(self.canonical)
        for name, shape in (("centers", (count,)), ("widths", (count,)), ("motion", (count, 3, 3))):
            array = getattr(self, name)
            if array.shape != shape:
                raise InputError(f"{name}: expected {shape}, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"{name}: row {int(np.argwhere(~np.isfinite(array))[0, 0])} is not finite")
        if self.turning.shape != (count, 4) or not np.isfinite(self.turning).all():
            raise InputError(f"turning: expected finite numbers ({count}, 4)")
        if not (self.widths > 0).all():
            raise InputError(f"widths: expected times above 0, row {int(np.argmax(self.widths <= 0))} has none")

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # judged at the end
    def at(self, time: float) -> Gaussians:
        """Return the rows at a time. Raises: InputError: rows whose polynomials overflow."""
        away = time - self.centers.astype(np.float64)
        powers = np.stack([away, away**2, away**3], 1)
        means = self.canonical.means + np.einsum("np,npk->nk", powers, self.motion.astype(np.float64))
        quats = self.canonical.quats + self.turning * away[:, None]
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        opacities = self.canonical.opacities * np.exp(-((away / self.widths) ** 2))
        means, quats = means.astype(np.float32), quats.astype(np.float32)
        sound = np.isfinite(means).all(1) & np.isfinite(quats).all(1)
        if not sound.all():
            raise InputError(f"at time {time:g} {np.count_nonzero(~sound)} rows are nowhere; first {sound.argmin()}")
        return replace(self.canonical, means=means, quats=quats, opacities=opacities.astype(np.float32))
