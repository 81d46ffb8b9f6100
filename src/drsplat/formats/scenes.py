"""`read_gaussians` and `write_gaussians`: any scene file in, PLY out."""

import mmap
import re
import warnings
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from ..errors import DrSplatWarning, FormatError, InputError
from ..gaussians import Gaussians
from ..units import lost_precision
from .compressed_ply import is_compressed, parse_compressed_ply
from .gaussian_ply import parse_gaussian_ply, vertex_columns
from .ply import write_vertices
from .ply_header import read_header
from .splat import parse_splat
from .spz import MAGIC, parse_spz

GZIP_DEFLATE = b"\x1f\x8b\x08"


def read_gaussians(path: str | PathLike[str]) -> Gaussians:
    """Read a scene: 3DGS PLY, compressed PLY, SPZ 2-4, `.splat`, or a trained model's folder.

    The format is told by the file's first bytes; only `.splat`, which has no mark, by its suffix.
    In a folder, the PLY of the highest `point_cloud/iteration_*` is read. Row order is the file's.
    The result is in the axes of the trained scene (RDF for SPZ, see formats.spz) and owns its
    memory. A scene far from zero for its size is counted from a local origin (`placing.local_origin`).

    Warns: DrSplatWarning: such a scene in a file of float32 positions, which have lost precision already.
    Raises: InputError: nothing at `path`. FormatError: a format that is not known, a damaged or
    truncated file, or rows that are no Gaussians; the message says how many, which is the first,
    and the cure.
    """
    path = scene_file(Path(path))
    try:
        with open(path, "rb") as file:
            if path.stat().st_size == 0:
                raise FormatError("the file is empty")
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return local(parse_gaussians(memoryview(mapped), path.suffix), str(path))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None


def local(gaussians: Gaussians, where: str) -> Gaussians:
    """Counted from a local origin where they are far from zero; with what float32 has lost by then."""
    for loss in lost_precision(gaussians):
        warnings.warn(f"{where}: {loss}", DrSplatWarning, stacklevel=3)
    return gaussians.localized()


@np.errstate(all="ignore")  # what damaged floats do on the way is judged at its end, row by row
def parse_gaussians(buffer: memoryview, suffix: str = "") -> Gaussians:
    """`read_gaussians` for bytes in memory; `suffix` (".splat") decides only where no mark does.

    Raises: FormatError: as `read_gaussians`.
    """
    start = bytes(buffer[:4])
    if start.startswith((b"ply\n", b"ply\r")):
        header = read_header(buffer)
        return (parse_compressed_ply if is_compressed(header) else parse_gaussian_ply)(
            buffer, header
        )
    if start == MAGIC or start.startswith(GZIP_DEFLATE):
        return parse_spz(buffer)
    if suffix.lower() == ".splat":
        return parse_splat(buffer)
    raise FormatError(
        f"no scene format begins with {start!r}; PLY, compressed PLY, SPZ and .splat can be read. "
        "Convert others first, e.g. `splat-transform scene.sog scene.ply`"
    )


def scene_file(path: Path) -> Path:
    """The scene file at `path`: itself, or the latest PLY of a trained model's folder.

    Raises: InputError: there is none.
    """
    if path.is_file():
        return path
    if not path.is_dir():
        raise InputError(f"there is no file {path}")
    found = {
        int(match[1]): ply
        for ply in path.glob("point_cloud/iteration_*/point_cloud.ply")
        if (match := re.fullmatch(r"iteration_(\d{1,9})", ply.parent.name))
    }
    if not found:
        raise InputError(
            f"{path} is a folder without point_cloud/iteration_*/point_cloud.ply: name the scene "
            "file itself"
        )
    return found[max(found)]


def write_gaussians(
    path: str | PathLike[str],
    gaussians: Gaussians,
    columns: Mapping[str, Shaped[np.ndarray, " n"]] = {},
    overwrite: bool = False,
) -> None:
    """Write a 3DGS PLY, `gaussians.extra` and `columns` as further scalar properties, atomically.

    SuperSplat shows and splat-transform filters any such property (`-V relevancy,gt,0.5`). A column
    takes the place of an extra of the same name. Positions are stored exactly, so the fingerprint
    stays: as float32, or as double where they are counted from an origin. The rest passes through a logarithm and back.

    Raises: InputError: `path` exists and not `overwrite`, a suffix other than .ply, a column of
    another length, type or name than a PLY can hold, or of a property that the format itself uses.
    """
    if Path(path).suffix.lower() != ".ply":
        raise InputError(f"scenes are written as PLY: give {Path(path).name} the suffix .ply")
    properties = vertex_columns(gaussians)
    further = {**gaussians.extra, **columns}
    for name, column in further.items():
        if name in properties or name.startswith("f_rest_"):
            raise InputError(
                f"column '{name}' would replace a property of the Gaussians: call it something else"
            )
        if column.shape != (len(gaussians),):
            raise InputError(
                f"column '{name}': expected shape ({len(gaussians)},), got {column.shape}"
            )
    write_vertices(path, {**properties, **further}, overwrite)
