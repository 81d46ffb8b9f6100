"""The optimised parameters, with Adam's moments row by row beside them."""

import numpy as np

from ..base.arrays import Anywhere, Arrays, ArraysByName, Bool, Float32, Integer
from ..errors import FormatError
from ..formats.activation import checked, sigmoid
from ..kernels.cuda.devices import contiguous, on_host
from ..kernels.cuda.training import DeviceGradients
from ..kernels.training import Gradients, HarmonicsStep, Rates, SceneParameters, adam_step
from ..scene.eight_bits import MAX_ABS_CONSTANT
from ..scene.gaussians import Gaussians

FLOATING = SceneParameters._fields
Slopes = Gradients | DeviceGradients  # of the CPU, of a device
MAX_ABS_LOG_SCALE = 80.0  # exp of either end is still a normal float32
Rows = Integer[Anywhere, " _"] | Bool[Anywhere, " _"]


class Optimizer:
    """Parameters and moments of N Gaussians; every change of rows is one of all three together.

    A Gaussian that is new has zero moments. `step` is the number of the iteration, the same for old
    and new rows, as in the original.
    """

    def __init__(self, parameters: SceneParameters, *moments: SceneParameters) -> None:
        """Begin with these moments, first and second, or with zeros."""
        self.parameters = parameters
        self.first, self.second = moments or (_zeros_like(parameters), _zeros_like(parameters))

    def __len__(self) -> int:
        return len(self.parameters.means)

    def step(self, gradients: Slopes, rates: Rates, step: int, threads: int = 0) -> None:
        """Take one step of Adam, in place; the harmonics none, if they took it on the way back."""
        for name in FLOATING:
            parameter, gradient, first, second = (
                getattr(each, name) for each in (self.parameters, gradients, self.first, self.second)
            )
            rate, constant = getattr(rates, name), None
            if name == "sh":
                if gradient.shape[1] == 0:
                    continue
                rate, constant = rates.sh_rest, rates.sh
            adam_step(parameter, gradient, first, second, rate, step, constant_rate=constant, threads=threads)

    def harmonics_step(self, rates: Rates, step: int) -> HarmonicsStep:
        """Return the step of the harmonics, for who takes it on the way back."""
        return HarmonicsStep(self.first.sh, self.second.sh, rates.sh_rest, rates.sh, step)

    def limit_colors(self) -> None:
        """Bring constant colours back into what viewers with 8-bit colours show (`scene.eight_bits`)."""
        constants = self.parameters.sh[:, 0]
        np.clip(constants, -MAX_ABS_CONSTANT, MAX_ABS_CONSTANT, out=constants)

    def noise(self, rng: np.random.Generator, count: int) -> Float32[Anywhere, "count 3"]:
        """Draw normal numbers where the parameters are."""
        return rng.standard_normal((count, 3), np.float32)

    def keep(self, rows: Rows) -> None:
        """Keep only these Gaussians, in this order."""
        self.parameters = _rows(self.parameters, rows)
        self.first, self.second = _rows(self.first, rows), _rows(self.second, rows)

    def append(self, new: SceneParameters) -> None:
        """Add Gaussians at the end."""
        self.parameters = _joined(self.parameters, new)
        self.first = _joined(self.first, _zeros_like(new))
        self.second = _joined(self.second, _zeros_like(new))

    def overwrite(self, rows: Integer[Anywhere, " m"], new: SceneParameters) -> None:
        """Put other Gaussians in place of some, with zero moments."""
        for name in FLOATING:
            getattr(self.parameters, name)[rows] = getattr(new, name)
        self.forget(rows)

    def forget(self, rows: Integer[Anywhere, " m"]) -> None:
        """Set the moments of some Gaussians to zero."""
        for moment in (self.first, self.second):
            for array in moment:
                array[rows] = 0

    def rows(self, rows: Rows) -> SceneParameters:
        """Return copies of the parameters of some Gaussians."""
        return _rows(self.parameters, rows)

    def is_finite(self) -> bool:
        return all(bool(np.isfinite(array).all()) for array in self.parameters)

    def on_host(self) -> SceneParameters:
        """Return the parameters as arrays of NumPy."""
        return self.parameters

    def gaussians(self) -> Gaussians:
        """Return the present scene, after activation. Raises: FormatError: a value that is not finite."""
        p = self.on_host()
        limited = np.clip(p.log_scales, -MAX_ABS_LOG_SCALE, MAX_ABS_LOG_SCALE)
        try:
            return checked(p.means.copy(), p.quats.copy(), np.exp(limited), sigmoid(p.logits), p.sh.copy())
        except FormatError as error:
            raise FormatError(f"the optimisation left the finite numbers: {error}") from None

    def state(self) -> Arrays:
        """Return all arrays by name, for a checkpoint."""
        groups = {"parameters": self.parameters, "first": self.first, "second": self.second}
        return {
            f"{group}.{name}": on_host(getattr(arrays, name)) for group, arrays in groups.items() for name in FLOATING
        }

    @classmethod
    def from_state(cls, state: ArraysByName) -> "Optimizer":
        """Return the optimizer of what `state` returned; arrays are copied."""
        groups = (
            SceneParameters(*(np.array(state[f"{group}.{name}"], np.float32) for name in FLOATING))
            for group in ("parameters", "first", "second")
        )
        return cls(*groups)


def _zeros_like(parameters: SceneParameters) -> SceneParameters:
    return SceneParameters(*(np.zeros_like(array) for array in parameters))


def _rows(parameters: SceneParameters, rows: Rows) -> SceneParameters:
    return SceneParameters(*(contiguous(array[rows]) for array in parameters))


def _joined(parameters: SceneParameters, new: SceneParameters) -> SceneParameters:
    return SceneParameters(
        *(contiguous(np.concatenate([old, more])) for old, more in zip(parameters, new, strict=True))
    )
