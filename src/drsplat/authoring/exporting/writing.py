"""Writing a scene in a format of other programs, and what the format could not hold."""

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from ...base.system import folder_bytes
from ...errors import InputError
from ...formats.georeference import Georeference
from ...formats.known import TILES3D, format_of, lacks, write_scene
from ...formats.streamed_sog import LOD_META, write_streamed_sog
from ...formats.tiles import Tiles
from ...formats.tiles3d_writing import TiledScene, write_tiles3d
from ...query import Query, Scene
from ...scene.eight_bits import fitted_to_8_bits
from ...scene.gaussians import Gaussians
from ...scene.labelled import LabelledScene
from ...scene.moving import Moving
from ..editing.kept import KeptEdits
from .labelling import Only, labelled, labelled_alone


class Exported(NamedTuple):
    """Content of a written file. format: as the suffix says. lacks: what the format could not hold, in sentences."""

    path: Path
    format: str
    bytes: int
    num_gaussians: int
    num_objects: int
    num_matches: int
    num_annotations: int
    num_edits: int
    lacks: tuple[str, ...]


def export(
    path: str | PathLike[str],
    scene: Scene | Gaussians | Moving | LabelledScene,
    query: Query | str | None = None,
    *,
    only: Only = None,
    time: float | None = None,
    edits: KeptEdits = "kept",
    embeddings: bool = False,
    photos: bool = False,
    fit_8bit: bool = False,
    spz_version: int = 3,
    overwrite: bool = False,
) -> Exported:
    """Write a scene as the suffix of `path` says, with its objects and the answer to a query.

    Args:
        path: NAME.glb, .ply, .spz, DIR/lod-meta.json or another that `formats.known.WRITERS` has.
        scene: an opened scene; Gaussians alone; or what `labelled` made, as it is.
        query: as in `labelled`.
        only: as in `labelled`.
        time: as in `labelled`; without one, a `.rrd` of a scene that moves has all of its motion.
        edits: as in `labelled`.
        embeddings: as in `labelled`.
        photos: as in `labelled`.
        fit_8bit: fits colours to viewers that keep them in bytes (`scene.eight_bits.fitted_to_8_bits`).
        spz_version: as of `write_scene`.
        overwrite: replaces what is at `path`.

    Raises: InputError: a suffix that nothing is written as, more than the format can hold, `path` exists and not
    `overwrite`; as `labelled`.
    """
    motion = whole_motion(Path(path), scene.motion if isinstance(scene, Scene) else scene, time)
    time = time if motion is None else motion.span[0]
    if isinstance(scene, Scene):
        carried = labelled(scene, query, only=only, time=time, edits=edits, embeddings=embeddings, photos=photos)
    elif query is not None or only is not None:
        raise InputError("a query is answered by a field: open the scene together with its field")
    else:
        carried = scene if isinstance(scene, LabelledScene) else labelled_alone(scene, time=time)
    carried = carried if motion is None else replace(carried, motion=motion)
    return written(Path(path), for_8_bits(carried) if fit_8bit else carried, overwrite, spz_version)


def whole_motion(path: Path, scene: object, time: float | None) -> Moving | None:
    """Return the scene where all of its motion is written, which a recording of rerun holds; None elsewhere."""
    is_whole = time is None and isinstance(scene, Moving) and format_of(path) == ".rrd"
    return scene if is_whole and isinstance(scene, Moving) else None


def for_8_bits(scene: LabelledScene) -> LabelledScene:
    """Return the scene with colours that viewers which keep them in bytes do not clamp."""
    return replace(scene, gaussians=fitted_to_8_bits(scene.gaussians))


def written(path: Path, scene: LabelledScene, overwrite: bool = False, spz_version: int = 3) -> Exported:
    """Write a labelled scene; returns what is in the file. Raises: as `write_scene`."""
    write_scene(path, scene, overwrite, spz_version=spz_version)
    return described(path, scene, format_of(path, spz_version))


def written_tiles3d(
    path: Path, source: LabelledScene | TiledScene, georeference: Georeference | None = None, overwrite: bool = False
) -> Exported:
    """Write a scene, or tiles without loading them all, as 3D Tiles. Raises: as `write_tiles3d`."""
    write_tiles3d(path, source, georeference=georeference, overwrite=overwrite)
    if isinstance(source, LabelledScene):
        return described(path, source, TILES3D)
    return _of_tiles(path, source.tiles, TILES3D, len(source.things))


def written_streamed_sog(path: Path, source: Tiles, overwrite: bool = False) -> Exported:
    """Write a folder of tiles as a streamed SOG, a tile at a time. Raises: as `write_streamed_sog`."""
    write_streamed_sog(path, source, overwrite)
    return _of_tiles(path, source, LOD_META)


def _of_tiles(path: Path, source: Tiles, kind: str, num_things: int = 0) -> Exported:
    return Exported(path, kind, _size(path), len(source), num_things, 0, 0, 0, ())


def described(path: Path, scene: LabelledScene, kind: str) -> Exported:
    """Return what a file, or a folder, that was written of a scene has in it; kind: one of `formats.known.WRITERS`."""
    counts = (len(scene.gaussians), len(scene.things), len(scene.matches), len(scene.annotations))
    return Exported(path, kind.removeprefix("."), _size(path), *counts, scene.num_edits, lacks(kind, scene))


def _size(path: Path) -> int:
    path = path.parent if path.name == LOD_META else path
    return folder_bytes(path) if path.is_dir() else path.stat().st_size
