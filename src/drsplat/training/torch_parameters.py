"""Parameters on the device: tensors and their Adams as gsplat's strategies expect them."""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn import Parameter
from torch.optim import Adam

from ..arrays import Float32
from ..kernels.training import SceneParameters
from ..scene.eight_bits import MAX_CONSTANT
from .optimizer import Optimizer, Rates

NAMES = {"means": "means", "log_scales": "scales", "quats": "quats", "logits": "opacities"}
EPSILON = 1e-15
MOMENTS = ("exp_avg", "exp_avg_sq")


class DeviceParameters:
    """`tensors` and `adams` by gsplat's names; its strategies replace the entries of both.

    The harmonics are two tensors of different rates: sh0 (n, 1, 3), and shN (n, k - 1, 3) unless k = 1.
    """

    def __init__(self, optimizer: Optimizer, step: int, device: str) -> None:
        """step: how many steps the moments have seen."""
        parameters, first, second = (
            _by_name(arrays) for arrays in (optimizer.parameters, optimizer.first, optimizer.second)
        )
        self.tensors: dict[str, Parameter] = {}
        self.adams: dict[str, Adam] = {}
        for name, array in parameters.items():
            parameter = Parameter(_tensor(array, device))
            adam = Adam([parameter], lr=0.0, eps=EPSILON, fused=parameter.is_cuda)  # one kernel instead of ten
            moments = (_tensor(moment[name], device) for moment in (first, second))
            taken = torch.tensor(float(step), device=device)
            adam.state[parameter] = {"step": taken} | dict(zip(MOMENTS, moments, strict=True))
            self.tensors[name], self.adams[name] = parameter, adam

    def __len__(self) -> int:
        return len(self.tensors["means"])

    @property
    def sh(self) -> Float32[Tensor, "n k 3"]:
        return _joined_sh(self.tensors)

    def step(self, rates: Rates) -> None:
        """One step of Adam, and the gradients are gone."""
        named = {ours: getattr(rates, ours) for ours in NAMES}
        by_name = {NAMES[ours]: rate for ours, rate in named.items()}
        by_name |= {"sh0": rates.sh, "shN": rates.sh_rest}
        for name, adam in self.adams.items():
            adam.param_groups[0]["lr"] = by_name[name]
            adam.step()
            self.tensors[name].grad = None

    def limit_colors(self) -> None:
        """Bring constant colours back into what viewers with 8-bit colours show, as `Optimizer.limit_colors`."""
        with torch.no_grad():
            self.tensors["sh0"].clamp_(-MAX_CONSTANT, MAX_CONSTANT)

    def reset_opacity(self, ceiling: float) -> None:
        """Reset opacities as `density.reset_opacity` does."""
        opacities = self.tensors["opacities"]
        with torch.no_grad():
            opacities.clamp_(max=math.log(ceiling / (1 - ceiling)))
        for name in MOMENTS:
            self.adams["opacities"].state[opacities][name].zero_()

    def download(self) -> Optimizer:
        """Return copies of parameters and moments on the host."""
        optimizer = Optimizer(self._arrays(lambda name: self.tensors[name]))
        first, second = (
            self._arrays(lambda name, key=key: self.adams[name].state[self.tensors[name]][key])  # type: ignore[misc]
            for key in MOMENTS
        )
        optimizer.first, optimizer.second = first, second
        return optimizer

    def _arrays(self, tensor_of: Callable[[str], Tensor]) -> SceneParameters:
        tensors = {name: tensor_of(name).detach() for name in self.tensors}
        arrays = {ours: _array(tensors[theirs]) for ours, theirs in NAMES.items()}
        return SceneParameters(**arrays, sh=_array(_joined_sh(tensors)))


def _by_name(parameters: SceneParameters) -> dict[str, np.ndarray]:
    named = {theirs: getattr(parameters, ours) for ours, theirs in NAMES.items()}
    named["sh0"] = parameters.sh[:, :1]
    if parameters.sh.shape[1] > 1:
        named["shN"] = parameters.sh[:, 1:]
    return named


def _joined_sh(tensors: "dict[str, Tensor] | dict[str, Parameter]") -> Float32[Tensor, "n k 3"]:
    return torch.cat([tensors[name] for name in ("sh0", "shN") if name in tensors], 1)


def _tensor(array: np.ndarray, device: str) -> Tensor:
    return torch.tensor(array, dtype=torch.float32, device=device)


def _array(tensor: Tensor) -> np.ndarray:
    return np.array(tensor.cpu().numpy(), np.float32, order="C")
