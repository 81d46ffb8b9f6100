"""Writing a recording of rerun (`.rrd`) with its own SDK: splats, boxes with names, and photos where they were taken.

Rerun's splats are marked unstable in its SDK (0.41). Axes are those of the scene.
"""

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MissingExtraError
from ..scene.gaussians import SH_C0, Gaussians
from ..scene.labelled import LabelledScene, Thing
from ..scene.similarity import quaternion_of
from ..scene.views import View
from .replacing import replacing
from .usd_writing import refuse_unwritable

INSTALL = 'pip install "drsplat[rerun]"'
MAX_HARMONICS = 15  # of a Gaussian, without the constant one


def write_rrd(path: Path, scene: LabelledScene, overwrite: bool = False, views: Sequence[View] = ()) -> None:
    """Write a scene, its objects, matches and annotations, and photos with their cameras.

    Raises: InputError: no Gaussians, or some that no file could give back; `path` exists and not `overwrite`.
    MissingExtraError: the SDK is not installed.
    """
    rerun = _sdk()
    refuse_unwritable(scene.gaussians)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "scene.rrd"
        stream = rerun.RecordingStream("drsplat")
        stream.save(str(made))
        _log(rerun, stream, scene, views)
        stream.flush()
        stream.disconnect()
        with replacing(path, overwrite) as file, made.open("rb") as source:
            shutil.copyfileobj(source, file, 1 << 20)


def _sdk() -> Any:
    try:
        import rerun
    except ModuleNotFoundError:
        raise MissingExtraError(f"a recording of rerun needs its SDK: {INSTALL}") from None
    return rerun


def _log(rerun: Any, stream: Any, scene: LabelledScene, views: Sequence[View]) -> None:
    stream.log("world", rerun.ViewCoordinates.RDF, static=True)
    stream.log("world/splats", _splats(rerun, scene.gaussians), static=True)
    for name in ("things", "groups", "matches"):
        things = getattr(scene, name)
        if things:
            stream.log(f"world/{name}", _boxes(rerun, things), static=True)
    notes = scene.annotations
    if notes:
        places = rerun.Points3D([note.center for note in notes], labels=[note.text for note in notes])
        stream.log("world/annotations", places, static=True)
    for number, view in enumerate(views):
        _log_view(rerun, stream, f"world/photos/{number}", view)


def _splats(rerun: Any, gaussians: Gaussians) -> Any:
    shown = np.clip(0.5 + SH_C0 * gaussians.sh[:, 0], 0, 1)
    colors = np.rint(255 * np.column_stack([shown, gaussians.opacities])).astype(np.uint8)
    harmonics = np.zeros((len(gaussians), MAX_HARMONICS, 3), np.float16)
    harmonics[:, : gaussians.sh.shape[1] - 1] = gaussians.sh[:, 1:]
    return rerun.GaussianSplats3D(
        gaussians.positions, scales=gaussians.scales, quaternions=gaussians.quats[:, [1, 2, 3, 0]], colors=colors,
        sh_coefficients=harmonics if gaussians.sh_degree else None, spherical_harmonics_degree=gaussians.sh_degree,
    )  # fmt: skip


def _boxes(rerun: Any, things: Sequence[Thing]) -> Any:
    turns = np.array([quaternion_of(np.asarray(thing.axes, np.float64).T) for thing in things])
    return rerun.Boxes3D(
        centers=[thing.center for thing in things], half_sizes=[thing.extent / 2 for thing in things],
        quaternions=turns[:, [1, 2, 3, 0]], labels=[thing.name for thing in things],
    )  # fmt: skip


def _log_view(rerun: Any, stream: Any, entity: str, view: View) -> None:
    world_from_cam = np.linalg.inv(view.cam_from_world)
    place = rerun.Transform3D(translation=world_from_cam[:3, 3], mat3x3=world_from_cam[:3, :3])
    stream.log(
        entity, place, rerun.Pinhole(image_from_camera=view.K, resolution=[view.width, view.height]), static=True
    )
    if view.image_path is not None and view.distortion is None:
        stream.log(entity, rerun.EncodedImage(path=view.image_path), static=True)
