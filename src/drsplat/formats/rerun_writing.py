"""Writing a recording of rerun (`.rrd`) with its own SDK: splats, boxes with names, and photos where they were taken.

A scene that moves has all of its times on the timeline "time", with the tracks of its objects.
Rerun's splats are marked unstable in its SDK (0.41). Axes are those of the scene.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Points
from ..errors import MissingExtraError, pip_install
from ..scene.gaussians import SH_C0, Gaussians
from ..scene.labelled import LabelledScene, Thing
from ..scene.moving import Moving
from ..scene.similarity import quaternion_of
from .activation import refuse_unwritable
from .replacing import take_over

TIMELINE = "time"
MAX_HARMONICS = 15  # of a Gaussian, without the constant term


def write_rrd(path: Path, scene: LabelledScene, overwrite: bool = False) -> None:
    """Write a scene, its objects, matches and annotations, its photos with their cameras, and its motion.

    Raises: InputError: no Gaussians, or some that no file could give back; `path` exists and not `overwrite`.
    MissingExtraError: the SDK is not installed. FormatError: a damaged frame of a scene that moves.
    """
    try:
        import rerun
    except ModuleNotFoundError:
        raise MissingExtraError(f"a recording of rerun needs its SDK: {pip_install('rerun')}") from None
    refuse_unwritable(scene.gaussians)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "scene.rrd"
        stream = rerun.RecordingStream("drsplat")
        stream.save(str(made))
        stream.set_log_time_enabled(False)
        _log(rerun, stream, scene)
        stream.flush()
        stream.disconnect()
        take_over(made, path, overwrite)


def _log(rerun: Any, stream: Any, scene: LabelledScene) -> None:
    stream.log("world", rerun.ViewCoordinates.RDF, static=True)
    for name in ("groups", "matches"):
        things = getattr(scene, name)
        if things:
            stream.log(f"world/{name}", _boxes(rerun, things), static=True)
    if scene.motion is None:
        stream.log("world/splats", _splats(rerun, scene.gaussians), static=True)
        if scene.things:
            stream.log("world/things", _boxes(rerun, scene.things), static=True)
    else:
        _log_motion(rerun, stream, scene, scene.motion)
    notes = scene.annotations
    if notes:
        places = rerun.Points3D([note.center for note in notes], labels=[note.text for note in notes])
        stream.log("world/annotations", places, static=True)
    for number, view in enumerate(scene.views):
        entity = f"world/photos/{number}"
        world_from_cam = np.linalg.inv(view.cam_from_world)
        place = rerun.Transform3D(translation=world_from_cam[:3, 3], mat3x3=world_from_cam[:3, :3])
        stream.log(
            entity, place, rerun.Pinhole(image_from_camera=view.K, resolution=[view.width, view.height]), static=True
        )
        if view.image_path is not None and view.distortion is None:
            stream.log(entity, rerun.EncodedImage(path=view.image_path), static=True)


def _log_motion(rerun: Any, stream: Any, scene: LabelledScene, motion: Moving) -> None:
    """Log each time of a scene that moves: all of its splats, and boxes of objects that go along with their middles."""
    tracks: list[Points] = []
    for time in motion.times.tolist():
        stream.set_time(TIMELINE, duration=time)
        gaussians = motion.at(time)
        stream.log("world/splats", _splats(rerun, gaussians))
        if scene.things:
            # the mean position of the Gaussians of each object; zero for those without
            owners = np.full(len(gaussians), -1) if scene.object_of is None else scene.object_of
            own, count = owners >= 0, len(scene.things)
            sizes = np.maximum(np.bincount(owners[own], minlength=count), 1)
            sums = [np.bincount(owners[own], column, count) for column in gaussians.positions[own].T]
            tracks.append(np.asarray(np.stack(sums, axis=1) / sizes[:, None]))
            moved = zip(scene.things, tracks[-1] - tracks[0], strict=True)
            boxes = [replace(thing, center=thing.center + by) for thing, by in moved]
            stream.log("world/things", _boxes(rerun, boxes))
    stream.reset_time()
    if tracks:
        strips = np.array([thing.center for thing in scene.things]) + np.stack(tracks) - tracks[0]
        names = [thing.name for thing in scene.things]
        stream.log("world/tracks", rerun.LineStrips3D(strips.swapaxes(0, 1), labels=names), static=True)


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
