"""Our own moving scenes: a folder with the canonical scene, scene.ply, and where its rows are, motion.safetensors.

Layout: docs/formats.md. Frames are mapped and used when they are needed, and each is compared with its checksums then.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import FormatError, InputError, MismatchError
from ..scene.gaussians import Gaussians
from ..scene.moving import Frames, Moving, counted_from
from .activation import checked
from .checksums import check_checksums, check_row, file_checksum, row_checksums, written_rows
from .field_folder import replacing_folder
from .gaussian_ply import write_gaussians
from .recognising import MOTION
from .scenes import read_gaussians
from .tensors import check_tensors, map_tensors, write_tensors

SCENE = "scene.ply"
FORMAT, VERSION = "drsplat motion", "1"
SCENE_SUM = "crc32_scene"
CURE = "Restore the folder from a copy, or write it anew with `drsplat motion`"
SHAPES = ("means", "quats", "scales", "opacities")
_ARRAYS = {
    "times": ("float64", "t"), "origin": ("float64", "k"), "means": ("float32", "t n k"), "quats": ("float32", "t n q"),
}  # fmt: skip
_FURTHER = {"scales": ("float32", "t n k"), "opacities": ("float32", "t n")}


def read_motion(folder: Path) -> Moving:
    """Read the folder that `write_motion` wrote; frames stay on disk until they are used.

    Raises: InputError: there is no such folder. FormatError: damaged, truncated, of a newer version, or times that
    do not increase; a frame that is damaged or holds no Gaussians, when it is used. MismatchError: motion of other
    Gaussians.
    """
    where = str(folder / MOTION)
    tensors, metadata = map_tensors(folder / MOTION)
    if (metadata.get("format"), metadata.get("version")) != (FORMAT, VERSION):
        version = ascii(metadata.get("version"))[:20]
        raise FormatError(f"{where}: expected '{FORMAT}' of version {VERSION}, got version {version}")
    check_tensors(tensors, _ARRAYS | {name: how for name, how in _FURTHER.items() if name in tensors}, where)
    canonical = read_gaussians(folder / SCENE)
    _check(tensors, metadata, canonical, where)
    _check_scene_file(folder, metadata)
    shapes = {name: tensors[name] for name in SHAPES if name in tensors}
    sums = written_rows(shapes, metadata, where)
    check_checksums(tensors, metadata, where, names=None if sums is None else tensors.keys() - shapes.keys())
    times = np.array(tensors["times"])
    try:
        return Moving(canonical, times, Frames(times, _frames(tensors, canonical, sums, where)))
    except InputError as error:
        raise FormatError(f"{where}: {error}") from None


def verify_motion(folder: Path) -> list[str]:
    """Compare all of a folder with its checksums; return the names of the files that have some.

    Raises: as `read_motion`.
    """
    read_motion(folder)
    tensors, metadata = map_tensors(folder / MOTION)
    check_checksums(tensors, metadata, f"{folder / MOTION}")
    return [MOTION, SCENE] if SCENE_SUM in metadata else [MOTION]


def write_motion(folder: Path, moving: Moving, overwrite: bool = False) -> None:
    """Write a frame for each of `moving.times`; colours are those of `canonical`.

    28 bytes for each row and time, 12 more where sizes change and 4 where opacities do, all of it in memory at once.

    Raises: InputError: as `replacing_folder`.
    """
    canonical = moving.canonical
    frames = [counted_from(moving.at(time), canonical.origin) for time in moving.times.tolist()]
    tensors = {name: np.stack([getattr(frame, name) for frame in frames]) for name in SHAPES}
    for name in _FURTHER:
        if (tensors[name] == getattr(canonical, name)).all():
            del tensors[name]
    metadata = {"format": FORMAT, "version": VERSION, "scene": canonical.fingerprint}
    with replacing_folder(folder, overwrite, MOTION) as temporary:
        write_gaussians(temporary / SCENE, canonical)
        stamps = {"times": moving.times, "origin": canonical.origin}
        sums = row_checksums(tensors) | {SCENE_SUM: file_checksum(temporary / SCENE)}
        write_tensors(temporary / MOTION, {**stamps, **tensors}, metadata | sums)


def _check(tensors: dict[str, np.ndarray], metadata: dict[str, str], canonical: Gaussians, where: str) -> None:
    scene = metadata.get("scene")
    if scene != canonical.fingerprint:
        raise MismatchError(
            f"{where}: moves the Gaussians {ascii(scene)[:60]}, {SCENE} beside it has {canonical.fingerprint}: keep "
            "the two files together as they were written"
        )
    _, count, three = tensors["means"].shape
    if count != len(canonical) or three != 3 or tensors["quats"].shape[2] != 4:
        raise FormatError(f"{where}: means {tensors['means'].shape} for {len(canonical)} Gaussians")
    if not np.isfinite(tensors["origin"]).all():
        raise FormatError(f"{where}: origin: expected three finite numbers")


def _check_scene_file(folder: Path, metadata: dict[str, str]) -> None:
    """Compare scene.ply with its checksum, which folders of older versions lack."""
    if metadata.get(SCENE_SUM, "") not in ("", file_checksum(folder / SCENE)):
        raise FormatError(f"{folder / SCENE}: damaged or edited: it is not what was written. {CURE}")


def _frames(
    tensors: dict[str, np.ndarray], canonical: Gaussians, sums: dict[str, list[str]] | None, where: str
) -> Callable[[int], Gaussians]:
    def value(name: str, number: int) -> np.ndarray:
        if name not in tensors:
            return np.array(getattr(canonical, name))
        row = np.array(tensors[name][number])
        if sums is not None:
            check_row(row, sums[name], number, f"{where}: {name}")
        return row

    def frame(number: int) -> Gaussians:
        try:
            means, quats, scales, opacities = (value(name, number) for name in SHAPES)
            moved = checked(means, quats, scales, opacities, canonical.sh)
        except FormatError as error:
            raise FormatError(f"{where}: frame {number}: {error}. {CURE}") from None
        origin, antialiased = np.array(tensors["origin"]), canonical.antialiased
        moved = replace(moved, extra=canonical.extra, origin=origin, antialiased=antialiased)
        return counted_from(moved, canonical.origin)

    return frame
