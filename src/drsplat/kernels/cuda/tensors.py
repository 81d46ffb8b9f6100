"""Scenes that are on the GPU already, as tensors of any library that speaks DLPack: torch's are taken without a copy.

splats = splats_of_tensors(means, quats, scales, opacities, near=0.2)
image, alpha, depth = drawn_channels(splats, view, as_array(colors), as_array(background))
image = torch.from_dlpack(image)
"""

from typing import Any

import numpy as np

from ...errors import InputError
from ...scene.gaussians import UPPER, rotation_rows
from ..splats import SplatArrays
from .drawing import drawn_channels
from .engine import Engine, cuda_engine

__all__ = ["as_array", "drawn_channels", "splats_of_tensors"]


def as_array(tensor: Any, engine: Engine | None = None) -> Any:
    """Return a tensor as an array that the kernels read: float32, contiguous; shared with it where it is both.

    Raises: InputError: it speaks no DLPack, or lies on another device. MissingExtraError: no GPU, or no CuPy.
    """
    xp = (engine or cuda_engine()).xp
    try:
        array = xp.from_dlpack(tensor.detach() if hasattr(tensor, "detach") else tensor)
    except Exception as error:
        raise InputError(
            f"expected a tensor on the GPU that speaks DLPack, such as torch's, got {type(tensor).__name__}: {error}"
        ) from error
    return xp.ascontiguousarray(array, dtype=xp.float32)


def splats_of_tensors(
    means: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    *,
    near: float,
    antialiased: bool = False,
    engine: Engine | None = None,
) -> SplatArrays:
    """Lay out a scene that is on the device: what `kernels.splat_arrays` does for one that is not.

    means (n, 3): scene units. quats (n, 4): wxyz, of any length but 0. scales (n, 3) and opacities (n): after
    activation. near: camera z up to which nothing is drawn.

    Raises: InputError: tensors that do not fit each other; see also `as_array`.
    """
    engine = engine or cuda_engine()
    xp, arrays = engine.xp, [as_array(tensor, engine) for tensor in (means, quats, scales, opacities)]
    shapes, count = [tuple(array.shape) for array in arrays], len(arrays[0])
    if shapes != [(count, 3), (count, 4), (count, 3), (count,)]:
        raise InputError(f"expected means (n, 3), quats (n, 4), scales (n, 3) and opacities (n), got {shapes}")
    if not 0 < near < np.inf:
        raise InputError(f"near: expected a distance in front of the camera, got {near}")
    unit = arrays[1] / xp.sqrt((arrays[1] ** 2).sum(1, keepdims=True))
    axes = [[entry * arrays[2][:, k] for k, entry in enumerate(row)] for row in rotation_rows(unit.T)]
    covariances = xp.stack([sum(a * b for a, b in zip(axes[r], axes[c], strict=True)) for r, c in UPPER])
    return SplatArrays(
        xp.ascontiguousarray(arrays[0].T), covariances.astype(xp.float32), arrays[3], near, np.zeros(3), antialiased,
        engine,
    )  # fmt: skip
