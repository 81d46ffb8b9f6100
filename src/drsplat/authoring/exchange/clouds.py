"""Scenes and matches for Open3D, pandas, and gsplat's trainers."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ...base.arrays import Vectors, WholeNumbers
from ...errors import FormatError, InputError, MissingExtraError, pip_install
from ...formats.activation import exp, logit, sigmoid, unit_quats
from ...query import Match
from ...scene.gaussians import SH_C0, Gaussians


def to_point_cloud(
    gaussians: Gaussians, gaussian_ids: WholeNumbers | None = None, colors: Vectors | None = None
) -> Any:
    """Return an `open3d.geometry.PointCloud` of the centres, in the world.

    gaussian_ids: of a part, such as `answer.gaussian_ids`. colors: RGB in [0, 1]; None: the Gaussians' own.

    Raises: MissingExtraError: Open3D is not installed. InputError: not one colour per point.
    """
    chosen = np.arange(len(gaussians)) if gaussian_ids is None else gaussian_ids
    if colors is not None and len(colors) != len(chosen):
        raise InputError(f"colors: expected {len(chosen)}, one per point, got {len(colors)}")
    rgb = np.clip(0.5 + SH_C0 * gaussians.sh[chosen, 0], 0, 1) if colors is None else colors
    geometry, utility = _open3d()
    cloud = geometry.PointCloud()
    cloud.points = utility.Vector3dVector(np.asarray(gaussians.positions, np.float64)[chosen])
    cloud.colors = utility.Vector3dVector(np.asarray(rgb, np.float64))
    return cloud


def to_boxes(matches: Iterable[Match]) -> list[Any]:
    """Return an `open3d.geometry.OrientedBoundingBox` per match. Raises: MissingExtraError: Open3D is not installed."""
    geometry, _ = _open3d()
    return [geometry.OrientedBoundingBox(match.center, _rotation(match), match.extent) for match in matches]


def _rotation(match: Match) -> np.ndarray:
    """Return the axes of a match as columns, right-handed, as Open3D expects them."""
    columns = np.array(match.axes, np.float64).T
    return columns * (1, 1, np.sign(np.linalg.det(columns)) or 1)


def _open3d() -> tuple[Any, Any]:
    try:
        import open3d
    except ImportError:
        raise MissingExtraError("Open3D is not installed: pip install open3d") from None
    return open3d.geometry, open3d.utility


def to_frame(matches: Iterable[Match]) -> Any:
    """Return a `pandas.DataFrame` with a row for each match, in order.

    Columns: score, num_gaussians, x, y, z of the centre, length, width, height of the box, object_id, label.

    Raises: MissingExtraError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise MissingExtraError("pandas is not installed: pip install pandas") from None
    return pandas.DataFrame([_row(match) for match in matches], columns=COLUMNS)


COLUMNS = ["score", "num_gaussians", "x", "y", "z", "length", "width", "height", "object_id", "label"]


def _row(match: Match) -> tuple[object, ...]:
    return (match.score, len(match), *match.center.tolist(), *match.extent.tolist(), match.object_id, match.label)


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
