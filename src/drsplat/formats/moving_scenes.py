"""`read_scene`: any scene, still or moving; `write_moving`: a moving one for others, or for us."""

from pathlib import Path

from ..base.contents import open_file
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians
from ..scene.moving import Moving
from .motion import MOTION, read_motion, write_motion
from .ply_header import MAX_HEADER_BYTES, read_header
from .ply_sequence import frames_of, read_ply_sequence, write_ply_sequence
from .scenes import read_gaussians, scene_file
from .spacetime_ply import is_spacetime, read_spacetime

SUFFIX = ".motion"


def read_scene(path: str | Path, times: tuple[float, float] | None = None) -> Gaussians | Moving:
    """Read a moving scene, or else a still one as `read_gaussians` reads it.

    Moving are: a folder with motion.safetensors, or that file; a folder of two or more numbered PLY files; a PLY of
    SpacetimeGaussians. times: of the first and the last frame of numbered files.

    Raises: as `read_gaussians` and the readers of moving scenes; InputError: times for what has its own.
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
    """Return True if `read_scene` would read a moving scene, by names and the header of a PLY."""
    path = Path(path)
    return path.name == MOTION or (path / MOTION).is_file() or is_sequence(path) or _is_spacetime(path)


def is_sequence(path: Path) -> bool:
    """Return True for a folder of numbered PLY files that is no trained model and no tiles."""
    if not path.is_dir() or (path / MOTION).is_file():
        return False
    try:
        scene_file(path)
    except InputError:
        return bool(frames_of(path))
    return False


def write_moving(path: str | Path, moving: Moving, overwrite: bool = False) -> None:
    """Write a folder: with our motion where its name ends in .motion, else of numbered PLY files.

    Raises: InputError: it exists and not `overwrite`, or is not such a folder.
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
        return False  # whoever reads it says what is wrong
