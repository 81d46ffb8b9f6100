"""`read_gaussians` and `write_gaussians`: any scene file in, PLY out."""

import re
import warnings
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from ..base.arrays import Shaped
from ..base.contents import file_bytes
from ..errors import DrSplatWarning, FormatError, InputError, placed
from ..scene.gaussians import SH_COEFFICIENTS, Gaussians, filled
from ..scene.units import lost_precision
from .compressed_ply import is_compressed, parse_compressed_ply
from .gaussian_ply import ANTIALIASED, NORMALS, SURFELS, parse_gaussian_ply, vertex_columns
from .glb import parse_glb, read_glb
from .glb_layout import MAGIC as GLB_MAGIC
from .ksplat import MAGIC as KSPLAT_MAGIC
from .ksplat import parse_ksplat
from .lcc2 import SUFFIX as LCC2
from .lcc2 import read_lcc2
from .ply import write_vertices
from .ply_header import MARK, read_header
from .recognising import Kind, mistaken, recognised
from .sog import parse_sog, read_unpacked_sog
from .sog_files import META, ZIP_MAGIC
from .splat import parse_splat
from .spz import MAGIC as SPZ_MAGIC
from .spz import parse_spz
from .streamed_sog import LOD_META, read_streamed_sog
from .tiles import TILES, read_tiles
from .usd import SUFFIXES as USD_SUFFIXES
from .usd import TEXT as USD_TEXT
from .usd import layer_of, scene_of
from .usd_text import parse_usda
from .writable import refuse_packed_name

GLTF = ".gltf"  # a document of JSON, which has no mark
GZIP_DEFLATE = b"\x1f\x8b\x08"
EDITED, HEADER_BEGIN_BYTES = "edited by drsplat", 256


def read_gaussians(path: str | PathLike[str]) -> Gaussians:
    """Read a scene: PLY of 3DGS, compressed PLY, SPZ 2-4, SOG, KSPLAT, `.splat`, GLB, USD, LCC2, tiles, or a model.

    The format is told by the file's first bytes; `.splat`, `.gltf` and `.lcc2`, which have no mark, by their suffix.
    In a folder, its tiles, its SOG (meta.json; lod-meta.json of a streamed one, the finest level; they may be named
    themselves) or the PLY of the highest `point_cloud/iteration_*` is read. Row order is the file's.
    The result is in the axes of the trained scene (RDF for SPZ, see formats.spz) and owns its
    memory. A scene far from zero for its size is counted from a local origin (`placing.local_origin`).

    Warns: DrSplatWarning: such a scene in a file of float32 positions, which have lost precision already.
    Raises: InputError: nothing at `path`. FormatError: a format that is not known, a damaged or truncated file, or rows
    that are no Gaussians; the message says how many, which is the first, and the cure.
    """
    path = scene_file(Path(path))
    try:
        if path.name == META:
            return local(read_unpacked_sog(path), str(path))
        if path.name == LOD_META:
            return local(read_streamed_sog(path), str(path))
        if path.suffix.lower() == LCC2:
            return local(read_lcc2(path), str(path))
        if path.name == TILES:
            return read_tiles(path.parent).gaussians()
        if path.suffix.lower() == GLTF:
            return local(read_glb(path), str(path))
        if path.suffix.lower() in USD_SUFFIXES:
            return local(scene_of(layer_of(path)).gaussians, str(path))
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
        warnings.warn(f"{where}: {loss}", DrSplatWarning, stacklevel=3)
    return gaussians.localized()


@np.errstate(all="ignore")  # what damaged floats do on the way is judged at its end, row by row
def parse_gaussians(buffer: memoryview, suffix: str = "") -> Gaussians:
    """Parse bytes in memory as `read_gaussians` does; `suffix` (".splat") decides only where no mark does.

    Raises: FormatError: as `read_gaussians`.
    """
    start = bytes(buffer[:7]).removeprefix(MARK)[:4]
    if start.startswith((b"ply\n", b"ply\r")):
        header = read_header(buffer)
        return (parse_compressed_ply if is_compressed(header) else parse_gaussian_ply)(buffer, header)
    if start == SPZ_MAGIC or start.startswith(GZIP_DEFLATE):
        return parse_spz(buffer)
    if start == ZIP_MAGIC:
        return parse_sog(buffer)
    if start == GLB_MAGIC or suffix.lower() == GLTF:
        return parse_glb(buffer)
    if bytes(buffer[: len(USD_TEXT)]) == USD_TEXT:
        return scene_of(parse_usda(buffer)).gaussians
    if start == KSPLAT_MAGIC or suffix.lower() == ".ksplat":
        return parse_ksplat(buffer)
    if suffix.lower() == ".splat":
        return parse_splat(buffer)
    raise FormatError(
        f"no scene format begins with {start!r}; PLY, compressed PLY, SPZ, SOG, KSPLAT, .splat, GLB and USD "
        "can be read. Convert others first, e.g. `splat-transform scene.lcc scene.ply`"
    )


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


def write_gaussians(
    path: str | PathLike[str],
    gaussians: Gaussians,
    columns: Mapping[str, Shaped[np.ndarray, " n"]] = {},
    overwrite: bool = False,
    sh_degree: int | None = None,
    *,
    is_edited: bool = False,
) -> None:
    """Write a 3DGS PLY, `gaussians.extra` and `columns` as further scalar properties, atomically.

    Without further properties the file is what the viewer of 3DGS (SIBR) reads, rows of 62 floats, when it has
    harmonics of degree 3. sh_degree: fills them up to this degree with zeros, which look the same.

    SuperSplat shows and splat-transform filters any such property (`-V relevancy,gt,0.5`). A column
    takes the place of an extra of the same name. Positions are stored exactly, so the fingerprint
    stays: as float32, or as double where they are counted from an origin. The rest passes through a logarithm and back.
    is_edited: says so in the header, see `was_edited`. Antialiased Gaussians and surfels have the comment of Brush.

    Raises: InputError: `path` exists and not `overwrite`, a suffix other than .ply, a column of
    another length, type or name than a PLY can hold, or of a property that the format itself uses; a
    `sh_degree` below that of the Gaussians or above 3.
    """
    refuse_packed_name(path)
    if Path(path).suffix.lower() != ".ply":
        raise InputError(f"scenes are written as PLY: give {Path(path).name} the suffix .ply")
    properties = vertex_columns(gaussians if sh_degree is None else _filled(gaussians, sh_degree))
    own = {name: column for name, column in gaussians.extra.items() if name not in NORMALS}
    further = {**own, **columns}
    for name, column in further.items():
        if name in properties or name.startswith("f_rest_"):
            raise InputError(f"column '{name}' would replace a property of the Gaussians: call it something else")
        if column.shape != (len(gaussians),):
            raise InputError(f"column '{name}': expected shape ({len(gaussians)},), got {column.shape}")
    mark = SURFELS if gaussians.surfels else ANTIALIASED if gaussians.antialiased else ""
    comments = [comment for comment in (EDITED if is_edited else "", mark) if comment]
    write_vertices(path, {**properties, **further}, overwrite, comments)


def was_edited(path: Path) -> bool:
    """Return whether a file is a PLY that was written as edited, beside which the scene itself may lie."""
    with path.open("rb") as file:
        return f"\ncomment {EDITED}\n".encode() in file.read(HEADER_BEGIN_BYTES)


def _filled(gaussians: Gaussians, sh_degree: int) -> Gaussians:
    """Fill in zeros for the harmonics up to a degree."""
    if not gaussians.sh_degree <= sh_degree < len(SH_COEFFICIENTS):
        raise InputError(f"sh_degree: expected {gaussians.sh_degree}, which the Gaussians have, to 3; got {sh_degree}")
    return replace(gaussians, sh=filled(gaussians.sh, SH_COEFFICIENTS[sh_degree]))
