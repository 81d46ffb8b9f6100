"""Gaussians in the form of gsplat's trainers: a dictionary of torch tensors before activation."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import FormatError, MissingExtraError, pip_install
from ...formats.activation import exp, logit, sigmoid, unit_quats
from ...scene.gaussians import Gaussians

NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN")


def to_splats(gaussians: Gaussians, device: str = "cpu") -> dict[str, Any]:
    """Return float32 tensors under the names of gsplat's examples.

    means (N, 3) in the world, quats (N, 4) wxyz, scales (N, 3) as logarithms, opacities (N,) before the sigmoid,
    sh0 (N, 1, 3), shN (N, K-1, 3).

    Raises: MissingExtraError: torch is not installed.
    """
    try:
        import torch
    except ImportError:
        raise MissingExtraError(f"torch is not installed: {pip_install('models')}") from None
    arrays = {
        "means": gaussians.positions.astype(np.float32), "quats": gaussians.quats, "scales": np.log(gaussians.scales),
        "opacities": logit(gaussians.opacities), "sh0": gaussians.sh[:, :1], "shN": gaussians.sh[:, 1:],
    }  # fmt: skip
    return {name: torch.from_numpy(np.array(array)).to(device) for name, array in arrays.items()}


def from_splats(splats: Mapping[str, Any]) -> Gaussians:
    """Return the scene of such a dictionary: a checkpoint's `splats`, or parameters in training.

    Raises: FormatError: a name is missing; InputError: shapes disagree.
    """
    missing = [name for name in NAMES if name not in splats]
    if missing:
        raise FormatError(f"splats: expected {', '.join(NAMES)}; there is no {', '.join(missing)}")
    arrays = {name: _array(splats[name]) for name in NAMES}
    return Gaussians(
        means=arrays["means"], quats=unit_quats(arrays["quats"]), scales=exp(arrays["scales"]),
        opacities=sigmoid(arrays["opacities"].reshape(-1)), sh=np.concatenate([arrays["sh0"], arrays["shN"]], 1),
    )  # fmt: skip


def _array(values: Any) -> np.ndarray:
    """Convert a tensor on any device, or anything that NumPy accepts."""
    host = values.detach().cpu().numpy() if hasattr(values, "detach") else values
    return np.ascontiguousarray(host, np.float32)
