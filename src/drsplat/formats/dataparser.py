"""nerfstudio's dataparser_transforms.json: the frame that its splats are trained in."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.arrays import Matrix4, Points
from ..errors import FormatError
from ..scene.views import View
from .json_files import as_fields, as_matrix, as_number, read_json
from .poses import nearest_rotation, pose

FILE_NAME = "dataparser_transforms.json"


@dataclass(frozen=True, eq=False)
class SceneFrame:
    """x_scene = scale * (transform @ x_world), a rigid 4x4 followed by a scale."""

    transform: Matrix4
    scale: float

    def after(self, applied: "SceneFrame") -> "SceneFrame":
        """Return the transform from the frame that `applied` leads to, where this one starts before it."""
        return SceneFrame(self.transform @ np.linalg.inv(applied.transform), self.scale / applied.scale)

    def points(self, points: Points) -> Points:
        """Return the world positions in the scene."""
        moved: np.ndarray = points @ self.transform[:3, :3].T + self.transform[:3, 3]
        return self.scale * moved

    def view(self, view: View) -> View:
        """Return the same camera in the scene: scaled world, scaled distances, every pixel as before."""
        rotation = view.cam_from_world[:3, :3] @ self.transform[:3, :3].T
        translation = self.scale * (view.cam_from_world[:3, 3] - rotation @ self.transform[:3, 3])
        return replace(view, cam_from_world=pose(rotation, translation))


def read_dataparser_transforms(path: Path) -> SceneFrame:
    """Read the file beside a nerfstudio config: {"transform": 3x4, "scale": s}.

    The frame it starts from is that of COLMAP, before the applied_transform of transforms.json.

    Raises: FormatError: a transform that is not rigid, a scale that is not positive.
    """
    document = as_fields(read_json(path), str(path), transform=object, scale=float)
    return scene_frame(document["transform"], document["scale"], str(path))


def scene_frame(transform: object, scale: object, where: str) -> SceneFrame:
    """Return the frame of a 3x4 (or 4x4) matrix and a number from a file."""
    rows = transform[:3] if isinstance(transform, list) else transform
    matrix = as_matrix(rows, 3, 4, f"{where}: transform")
    factor = as_number(scale, f"{where}: scale")
    if not 1e-9 < factor < 1e9:
        raise FormatError(f"{where}: expected a positive scale, got {factor}")
    rotation = nearest_rotation(matrix[:, :3], f"{where}: transform")
    return SceneFrame(pose(rotation, matrix[:, 3]), factor)
