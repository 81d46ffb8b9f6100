"""`read_gaussians`: any scene file in, by the table of `known`."""

import re
from os import PathLike
from pathlib import Path

from ..base.contents import file_bytes
from ..errors import FormatError, placed, warn
from ..scene.gaussians import Gaussians
from ..scene.units import lost_precision
from .known import format_at, parse_gaussians
from .recognising import Kind, mistaken, recognised
from .sog import META
from .streamed_sog import LOD_META
from .tiles import TILES


def read_gaussians(path: str | PathLike[str]) -> Gaussians:
    """Read a scene: PLY of 3DGS, compressed PLY, SPZ 2-4, SOG, KSPLAT, `.splat`, GLB, USD, tiles, or a model.

    The format is told by the file's first bytes; `.splat` and `.gltf`, which have no mark, by their suffix.
    In a folder, its tiles, its SOG (meta.json; lod-meta.json of a streamed one, the finest level; they may be named
    themselves) or the PLY of the highest `point_cloud/iteration_*` is read. Row order is the file's.
    The result is in the axes of the trained scene (RDF for SPZ, see formats.spz) and owns its
    memory. A scene far from zero for its size is counted from a local origin (`placing.local_origin`).

    Warns: DrSplatWarning: such a scene in a file of float32 positions, which have lost precision already.
    Raises: InputError: nothing at `path`. FormatError: a format that is not known, a damaged or truncated file, or rows
    that are no Gaussians; the message says how many, which is the first, and the cure.

    >>> len(ds.read_gaussians("scene.ply"))
    300
    """
    path = scene_file(Path(path))
    try:
        known = format_at(path)
        if known is not None and known.read is not None:
            scene = known.read(path)
            return scene if path.name == TILES else local(scene, str(path))  # tiles have their origin
        content = file_bytes(path)
        if not content.size:
            raise FormatError("the file is empty")
        return local(parse_gaussians(content.data, path.suffix), str(path))
    except FormatError as error:
        if recognised(path) not in (Kind.SCENE, Kind.OTHER):
            raise mistaken(path, Kind.SCENE) from None
        raise FormatError(placed(path, error)) from None


def local(gaussians: Gaussians, where: str) -> Gaussians:
    """Move Gaussians far from zero to a local origin, and warn of what float32 has lost by then."""
    for loss in lost_precision(gaussians):
        warn(f"{where}: {loss}", 3)
    return gaussians.localized()


def scene_file(path: Path) -> Path:
    """Return the scene file at `path`, or in that folder: tiles, a SOG, or the latest PLY of a trained model.

    Raises: InputError: there is none.
    """
    if path.is_file():
        return path
    of_folder = next((path / mark for mark in (TILES, LOD_META) if (path / mark).is_file()), None)
    if of_folder is not None:
        return of_folder
    if not path.is_dir():
        raise mistaken(path, Kind.SCENE)
    found = {
        int(match[1]): ply
        for ply in path.glob("point_cloud/iteration_*/point_cloud.ply")
        if (match := re.fullmatch(r"iteration_(\d{1,9})", ply.parent.name))
    }
    if not found and (path / META).is_file():
        return path / META
    if not found:
        raise mistaken(path, Kind.SCENE)
    return found[max(found)]


def companion(scene: str | PathLike[str], kind: str) -> Path:
    """Return the path of a file beside a scene: NAME.kind.json of the file NAME.ply, or of the folder NAME."""
    path = Path(scene)
    path = path.resolve() if path.is_dir() else path
    return path.with_name(f"{path.name if path.is_dir() else path.stem}.{kind}.json")
