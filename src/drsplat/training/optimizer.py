"""What is optimised, with Adam's moments row by row beside it."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Integer

from ..errors import FormatError
from ..formats.activation import checked, sigmoid
from ..gaussians import Gaussians
from ..kernels.training import Gradients, SceneParameters, adam_step

FLOATING = SceneParameters._fields
COLOR_BLOCK = 1 << 12  # rows of which everything stays in a core's cache
LOG_SCALE_LIMIT = 80.0  # exp of it is still a normal float32
Rows = Integer[np.ndarray, " _"] | Bool[np.ndarray, " _"]


class Rates(NamedTuple):
    """Learning rate of each kind of parameter; sh of the constant term, sh_rest of all others."""

    means: float
    log_scales: float
    quats: float
    logits: float
    sh: float
    sh_rest: float


class Optimizer:
    """Parameters and moments of N Gaussians; every change of rows is one of all three together.

    A Gaussian that is new has zero moments. `step` is the number of the iteration, the same for old
    and new rows, as in the original.
    """

    def __init__(self, parameters: SceneParameters) -> None:
        self.parameters = parameters
        self.first = _zeros_like(parameters)
        self.second = _zeros_like(parameters)

    def __len__(self) -> int:
        return len(self.parameters.means)

    def step(self, gradients: Gradients, rates: Rates, step: int, threads: int = 0) -> None:
        """One step of Adam, in place."""
        p, m, v = self.parameters, self.first, self.second
        for name in ("means", "log_scales", "quats", "logits"):
            parameter, gradient = getattr(p, name), getattr(gradients, name)
            moments, rate = (getattr(m, name), getattr(v, name)), getattr(rates, name)
            adam_step(parameter, gradient, *moments, rate, step, threads=threads)
        self._step_colors(gradients.sh, rates, step, threads)

    def _step_colors(
        self, gradient: Float32[np.ndarray, "n k 3"], rates: Rates, step: int, threads: int
    ) -> None:
        """The constant term is stepped on a copy, at its own rate; its moments come out the same."""
        arrays = (self.parameters.sh, gradient, self.first.sh, self.second.sh)
        for begin in range(0, len(gradient), COLOR_BLOCK):
            p, g, m, v = (array[begin : begin + COLOR_BLOCK] for array in arrays)
            constant, *moments = (_constant_term(array) for array in (p, m, v))
            slope = _constant_term(g)
            adam_step(constant, slope, moments[0], moments[1], rates.sh, step, threads=threads)
            adam_step(p, g, m, v, rates.sh_rest, step, threads=threads)
            for channel in range(3):
                p[:, 0, channel] = constant[channel]

    def keep(self, rows: Rows) -> None:
        """Only these Gaussians remain, in this order."""
        self.parameters = _rows(self.parameters, rows)
        self.first, self.second = _rows(self.first, rows), _rows(self.second, rows)

    def append(self, new: SceneParameters) -> None:
        """Add Gaussians at the end."""
        self.parameters = _joined(self.parameters, new)
        self.first = _joined(self.first, _zeros_like(new))
        self.second = _joined(self.second, _zeros_like(new))

    def overwrite(self, rows: Integer[np.ndarray, " m"], new: SceneParameters) -> None:
        """Put other Gaussians in place of some, with zero moments."""
        for name in FLOATING:
            getattr(self.parameters, name)[rows] = getattr(new, name)
        self.forget(rows)

    def forget(self, rows: Integer[np.ndarray, " m"]) -> None:
        """Zero the moments of some Gaussians."""
        for moment in (self.first, self.second):
            for array in moment:
                array[rows] = 0

    def replace_logits(self, logits: Float32[np.ndarray, " n"]) -> None:
        """New opacities for all, and no memory of the way they came."""
        self.parameters.logits[:] = logits
        self.first.logits[:] = 0
        self.second.logits[:] = 0

    def rows(self, rows: Rows) -> SceneParameters:
        """Copies of the parameters of some Gaussians."""
        return _rows(self.parameters, rows)

    def is_finite(self) -> bool:
        return all(np.isfinite(array).all() for array in self.parameters)

    def gaussians(self) -> Gaussians:
        """The scene as it is now, after activation.

        Raises: FormatError: a value that is not finite.
        """
        p = self.parameters
        limited = np.clip(p.log_scales, -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT)
        try:
            return checked(
                p.means.copy(), p.quats.copy(), np.exp(limited), sigmoid(p.logits), p.sh.copy()
            )
        except FormatError as error:
            raise FormatError(f"the optimisation left the finite numbers: {error}") from None

    def state(self) -> dict[str, np.ndarray]:
        """All arrays by name, for a checkpoint."""
        groups = {"parameters": self.parameters, "first": self.first, "second": self.second}
        return {
            f"{group}.{name}": getattr(arrays, name)
            for group, arrays in groups.items()
            for name in FLOATING
        }

    @classmethod
    def from_state(cls, state: Mapping[str, np.ndarray]) -> "Optimizer":
        """Of what `state` gave; arrays are copied."""
        groups = [
            SceneParameters(*(np.array(state[f"{group}.{name}"], np.float32) for name in FLOATING))
            for group in ("parameters", "first", "second")
        ]
        optimizer = cls(groups[0])
        optimizer.first, optimizer.second = groups[1:]
        return optimizer


def _constant_term(sh: Float32[np.ndarray, "n k 3"]) -> Float32[np.ndarray, "3 n"]:
    """Channel by channel: NumPy copies three long columns several times as fast as n short rows."""
    return np.stack([sh[:, 0, channel] for channel in range(3)])


def _zeros_like(parameters: SceneParameters) -> SceneParameters:
    return SceneParameters(*(np.zeros_like(array) for array in parameters))


def _rows(parameters: SceneParameters, rows: Rows) -> SceneParameters:
    return SceneParameters(*(np.ascontiguousarray(array[rows]) for array in parameters))


def _joined(parameters: SceneParameters, new: SceneParameters) -> SceneParameters:
    return SceneParameters(
        *(np.concatenate([old, more]) for old, more in zip(parameters, new, strict=True))
    )
