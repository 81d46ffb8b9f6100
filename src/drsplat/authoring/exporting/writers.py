"""Writing a scene with what was found in it, in the format that the name of the output says."""

from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ...errors import InputError, did_you_mean
from ...formats.glb_writing import write_glb
from ...formats.replacing import replacing
from ...formats.rerun_writing import write_rrd
from ...formats.scenes import write_gaussians
from ...formats.spz_writing import spz4_bytes, spz_bytes
from ...formats.streamed_sog import LOD_META
from ...formats.usd_library import write_usdc, write_usdz
from ...formats.usd_writing import write_usda
from ...formats.writable import refuse_packed_name, refuse_unwritable
from ...scene.labelled import LabelledScene
from .sog_writing import sog_bytes
from .streamed_sog_writing import write_streamed_sog

TILES3D, SPZ_4 = "3D Tiles", ".spz, version 4"  # formats that no suffix says
ASPECTS: Mapping[str, str] = MappingProxyType(
    {
        "numbers": "object of each Gaussian",
        "names": "names and boxes of objects",
        "relevancy": "relevancy of each Gaussian",
        "matches": "boxes of matches",
        "annotations": "annotations",
        "embeddings": "embeddings of objects",
        "columns": "further columns of the scene",
        "surfels": "mark that its Gaussians are surfels (2DGS)",
        "photos": "photos",
    }
)
Writer = Callable[[Path, LabelledScene, bool], None]


def write_scene(
    path: str | PathLike[str], scene: LabelledScene, overwrite: bool = False, *, spz_version: int = 3
) -> None:
    """Write a scene as the suffix of `path` says; it appears whole or not at all.

    spz_version: 3, which most programs read, or 4, which keeps objects, names and relevancy, of a `.spz`.

    Raises: InputError: a suffix that nothing is written as, a scene without Gaussians or with numbers that are not
    finite, one that the format cannot hold, or `path` exists and not `overwrite`.
    """
    path = Path(path)
    writer = writer_of(path)
    if format_of(path, spz_version) == SPZ_4:
        writer = _encoded_by(spz4_bytes)
    _refuse_unwritable(scene)
    writer(path, scene, overwrite)


def writer_of(path: Path) -> Writer:
    """Return the writer of a file of this name. Raises: InputError: there is none."""
    refuse_packed_name(path)
    writer = WRITERS.get(_kind(path))
    if writer is None:
        near = did_you_mean(path.suffix.lower(), WRITERS)
        raise InputError(f"{path.name}: expected a name that ends in {', '.join(WRITERS)}.{near}")
    return writer


def _kind(path: Path) -> str:
    return LOD_META if path.name == LOD_META else path.suffix.lower()


def format_of(path: Path, spz_version: int = 3) -> str:
    """Return which of `HELD` a file is. Raises: InputError: another version of SPZ than 3 and 4."""
    if spz_version not in (3, 4):
        raise InputError(f"spz_version: expected 3 or 4, got {spz_version}")
    kind = _kind(path)
    return SPZ_4 if kind == ".spz" and spz_version == 4 else kind


def _refuse_unwritable(scene: LabelledScene) -> None:
    """Check a scene. Raises: InputError: what `formats.writable` refuses, or relevancies that are not finite."""
    refuse_unwritable(scene.gaussians)
    if scene.relevancy is not None and not np.isfinite(scene.relevancy).all():
        row = int(np.flatnonzero(~np.isfinite(scene.relevancy))[0])
        raise InputError(f"relevancies: expected finite numbers, got {scene.relevancy[row]} in row {row}: ask anew")


def lacks(kind: str, scene: LabelledScene) -> tuple[str, ...]:
    """Return what of a scene a file of this suffix, or `TILES3D`, cannot hold, in sentences."""
    there = {
        "numbers": scene.object_of is not None,
        "names": bool(scene.things),
        "relevancy": scene.relevancy is not None,
        "matches": bool(scene.matches),
        "annotations": bool(scene.annotations),
        "embeddings": any(thing.embedding is not None for thing in scene.things),
        "columns": bool(scene.gaussians.extra),
        "surfels": scene.gaussians.surfels,
        "photos": bool(scene.views),
    }
    held = HELD[kind]
    return tuple(f"{kind} keeps no {ASPECTS[name]}" for name, has in there.items() if has and name not in held)


def _write_ply(path: Path, scene: LabelledScene, overwrite: bool) -> None:
    write_gaussians(path, scene.gaussians, scene.columns, overwrite, is_edited=scene.num_edits > 0)


def _encoded_by(encode: Callable[[LabelledScene], bytes]) -> Writer:
    """Return a writer of what a function encodes in memory."""

    def write(path: Path, scene: LabelledScene, overwrite: bool) -> None:
        content = encode(scene)
        with replacing(path, overwrite=overwrite) as file:
            file.write(content)

    return write


WRITERS: Mapping[str, Writer] = MappingProxyType(
    {
        ".glb": write_glb,
        ".ply": _write_ply,
        ".rrd": write_rrd,
        ".sog": _encoded_by(sog_bytes),
        ".spz": _encoded_by(lambda scene: spz_bytes(scene.gaussians)),
        ".usda": write_usda,
        ".usdc": write_usdc,
        ".usdz": write_usdz,
        LOD_META: write_streamed_sog,
    }
)
_GLB_HELD = frozenset(ASPECTS) - {"columns", "photos"}
HELD: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        ".glb": _GLB_HELD,
        ".ply": frozenset({"numbers", "relevancy", "columns", "surfels"}),
        ".rrd": frozenset({"names", "matches", "annotations", "photos"}),
        ".sog": frozenset({"numbers", "names", "relevancy", "surfels"}),
        ".spz": frozenset(),
        SPZ_4: frozenset({"numbers", "names", "relevancy"}),
        ".usda": _GLB_HELD,
        ".usdc": _GLB_HELD,
        ".usdz": _GLB_HELD,
        LOD_META: frozenset({"numbers", "names", "relevancy", "surfels"}),
        TILES3D: frozenset({"numbers", "names"}),
    }
)
"""Aspects of a scene, of `ASPECTS`, that each format keeps."""
