"""Read any scene, still or moving, and write moving ones in our format or as numbered PLY files."""

from pathlib import Path

from ..base.contents import open_file
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians
from ..scene.moving import Moving
from .motion import read_motion, write_motion
from .ply_header import MAX_HEADER_BYTES, read_header
from .ply_sequence import frames_of, read_ply_sequence, write_ply_sequence
from .recognising import MOTION
from .scenes import read_gaussians, scene_file
from .spacetime_ply import is_spacetime, read_spacetime

SUFFIX = ".motion"
ROWS = (
    "| moving: numbered PLY files in a folder (`time_00000.ply` of 4DGaussians, `frame0001.ply` of SuperSplat) | "
    "yes | yes | the same rows in each; a frame's time is its number, or evenly between two given times "
    "([motion](#motion)) | frames of different counts, two sequences in a folder |",
    "| moving: SpacetimeGaussians PLY | yes | no | `trbf_center`, `trbf_scale`, `motion_0..8`, `omega_0..3`; "
    "times 0 to 1; not `f_t_*`, which feed a decoder of colours | columns that are missing or not finite |",
    "| moving: ours, a folder NAME.motion | 1 | yes | [layout](#motion) | motion of other Gaussians, times that "
    "do not increase, frames that are no Gaussians |",
)  # fmt: skip
"""Rows of moving scenes in the table of docs/formats.md, as `known.SceneFormat.row`."""


def read_scene(path: str | Path, times: tuple[float, float] | None = None) -> Gaussians | Moving:
    """Read a scene: a moving one as `Moving`, a still one as `read_gaussians` does.

    These move: a folder with motion.safetensors, or that file; a folder of two or more numbered PLY files; a PLY of
    SpacetimeGaussians.

    Args:
        path: the file or folder.
        times: times of the first and the last frame, for numbered PLY files only.

    Raises: as `read_gaussians` and the readers of moving scenes. InputError: times for a scene that has its own.
    """
    path = Path(path)
    if is_sequence(path):
        return read_ply_sequence(path, times)
    if times is not None:
        raise InputError(f"{path}: times are given to numbered PLY files only, this scene has its own or stands still")
    if path.name == MOTION or (path / MOTION).is_file():
        return read_motion(path.parent if path.name == MOTION else path)
    if _is_spacetime(path):
        return read_spacetime(path)
    return read_gaussians(path)


def read_moving(path: str | Path, times: tuple[float, float] | None = None) -> Moving:
    """Read a moving scene, see `read_scene`. Raises: InputError: a scene that stands still."""
    scene = read_scene(path, times)
    if not isinstance(scene, Moving):
        raise InputError(
            f"{path}: this scene stands still; moving are a folder of numbered PLY files, a folder with {MOTION} and "
            "PLY files of SpacetimeGaussians"
        )
    return scene


def is_moving(path: str | Path) -> bool:
    """Return whether `read_scene` would return a moving scene, judging by file names and a PLY's header."""
    path = Path(path)
    return path.name == MOTION or (path / MOTION).is_file() or is_sequence(path) or _is_spacetime(path)


def is_sequence(path: Path) -> bool:
    """Return whether a folder holds numbered PLY files, and is neither a trained model nor tiles."""
    if not path.is_dir() or (path / MOTION).is_file():
        return False
    try:
        scene_file(path)
    except InputError:
        return bool(frames_of(path))
    return False


def write_moving(path: str | Path, moving: Moving, overwrite: bool = False) -> None:
    """Write a moving scene to a folder: in our format if its name ends in .motion, else as numbered PLY files.

    Raises: InputError: the folder exists without `overwrite`, or holds something else.
    """
    path = Path(path)
    (write_motion if path.suffix == SUFFIX else write_ply_sequence)(path, moving, overwrite)


def _is_spacetime(path: Path) -> bool:
    if path.suffix.lower() != ".ply" or not path.is_file():
        return False
    with open_file(path) as file:
        head = file.read(MAX_HEADER_BYTES)
    try:
        return is_spacetime(read_header(memoryview(head)))
    except FormatError:
        return False  # reading it reports what is wrong
