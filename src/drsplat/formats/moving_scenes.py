"""Read any scene, still or moving, and write moving ones in our format or as numbered PLY files.

Numbered PLY files have the same rows, one file for each time: time_00000.ply (4DGaussians), frame0001.ply (SuperSplat).
A frame's time is its number, unless other times are given.

Our own moving scenes: a folder with the canonical scene, scene.ply, and where its rows are, motion.safetensors.

Layout: docs/formats.md. Frames are mapped and used when they are needed, and each is compared with its checksums then.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Arrays
from ..base.contents import open_file
from ..errors import FormatError, InputError, MismatchError
from ..scene.gaussians import Gaussians
from ..scene.moving import Frames, Moving, counted_from
from .activation import checked
from .field_folder import replacing_folder
from .gaussian_ply import write_gaussians
from .ply import read_header
from .scenes import MOTION, read_gaussians, scene_file
from .tensors import (
    check_checksums,
    check_row,
    check_tensors,
    file_checksum,
    map_tensors,
    row_checksums,
    write_tensors,
    written_rows,
)

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
    if metadata.get(SCENE_SUM) != file_checksum(folder / SCENE):
        raise FormatError(f"{folder / SCENE}: damaged or edited: it is not what was written. {CURE}")
    shapes = {name: tensors[name] for name in SHAPES if name in tensors}
    sums = written_rows(shapes, metadata, where)
    check_checksums(tensors, metadata, where, names=tensors.keys() - shapes.keys())
    times = np.array(tensors["times"])
    try:
        return Moving(canonical, times, Frames(times, _frames(tensors, canonical, sums, where)))
    except InputError as error:
        raise FormatError(f"{where}: {error}") from None


def verify_motion(folder: Path) -> list[str]:
    """Compare all of a folder with its checksums; return the names of its files.

    Raises: as `read_motion`.
    """
    read_motion(folder)
    tensors, metadata = map_tensors(folder / MOTION)
    check_checksums(tensors, metadata, f"{folder / MOTION}")
    return [MOTION, SCENE]


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


def _check(tensors: Arrays, metadata: dict[str, str], canonical: Gaussians, where: str) -> None:
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


def _frames(
    tensors: Arrays, canonical: Gaussians, sums: dict[str, list[str]], where: str
) -> Callable[[int], Gaussians]:
    def value(name: str, number: int) -> np.ndarray:
        if name not in tensors:
            return np.array(getattr(canonical, name))
        row = np.array(tensors[name][number])
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


NUMBERED = re.compile(r"(.*?)(\d{1,12})\.ply", re.IGNORECASE)
MAX_FRAME_HEADER_BYTES = 1 << 16
MAX_FRAMES = 100_000
SUFFIX = ".motion"
Times = tuple[float, float] | None


def read_scene(path: str | Path, times: Times = None) -> Gaussians | Moving:
    """Read a scene: a moving one as `Moving`, a still one as `read_gaussians` does.

    These move: a folder with motion.safetensors, or that file; a folder of two or more numbered PLY files.

    Args:
        path: the file or folder.
        times: times of the first and the last frame, for numbered PLY files only.

    Raises: as `read_gaussians` and the readers of moving scenes. InputError: times for a scene that has its own.
    """
    path = Path(path)
    known = next((one for one in MOVING if one.tells(path)), None)
    if times is not None and (known is None or not known.takes_times):
        raise InputError(f"{path}: times are given to numbered PLY files only, this scene has its own or stands still")
    return read_gaussians(path) if known is None else known.read(path, times)


def read_moving(path: str | Path, times: Times = None) -> Moving:
    """Read a moving scene, see `read_scene`. Raises: InputError: a scene that stands still."""
    scene = read_scene(path, times)
    if not isinstance(scene, Moving):
        raise InputError(
            f"{path}: this scene stands still; moving are a folder of numbered PLY files and a folder with {MOTION}"
        )
    return scene


def is_moving(path: str | Path) -> bool:
    """Return whether `read_scene` would return a moving scene, judging by file names."""
    return any(one.tells(Path(path)) for one in MOVING)


def _is_ours(path: Path) -> bool:
    return path.name == MOTION or (path / MOTION).is_file()


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


def frames_of(folder: Path) -> dict[int, Path]:
    """Return the numbered PLY files of a folder by their number, ascending; none where there are not two.

    Raises: FormatError: of several sequences, or two of one number.
    """
    named = [(match, path) for path in sorted(folder.iterdir()) if (match := NUMBERED.fullmatch(path.name))]
    if len(named) < 2:
        return {}
    prefixes = sorted({match[1] for match, _ in named})
    if len(prefixes) > 1:
        raise FormatError(
            f"{folder}: expected one sequence, got {prefixes[0]}*.ply and {prefixes[1]}*.ply: keep each in a folder"
        )
    found = {int(match[2]): path for match, path in named}
    if len(found) < len(named):
        raise FormatError(f"{folder}: two frames have the same number: {len(named)} files, {len(found)} numbers")
    return dict(sorted(found.items()))


def read_ply_sequence(folder: Path, times: Times = None) -> Moving:
    """Read frames when they are needed, and hold two.

    times: of the first and the last frame, and the others evenly between them; None: the frames' numbers.

    Raises: InputError: no two numbered PLY files, or times that do not increase. FormatError: as `frames_of`; frames of
    different numbers of rows, or of no 3DGS.
    """
    found = frames_of(folder)
    if not found or len(found) > MAX_FRAMES:
        raise InputError(
            f"{folder}: expected 2 to {MAX_FRAMES:,} numbered PLY files (frame0001.ply), got {len(found):,}"
        )
    paths = list(found.values())
    _check_counts(paths)
    canonical = read_gaussians(paths[0])

    def frame(number: int) -> Gaussians:
        gaussians = read_gaussians(paths[number])
        path = paths[number]
        if gaussians.sh.shape != canonical.sh.shape:
            raise FormatError(f"{path}: harmonics {gaussians.sh.shape}, those of the first frame {canonical.sh.shape}")
        if gaussians.antialiased != canonical.antialiased:
            raise FormatError(f"{path}: marked antialiased {gaussians.antialiased}, the first frame is the other way")
        return counted_from(gaussians, canonical.origin)

    stamps = np.array(list(found), np.float64) if times is None else np.linspace(*times, len(paths))
    return Moving(canonical, stamps, Frames(stamps, frame))


def write_ply_sequence(folder: Path, moving: Moving, overwrite: bool = False) -> None:
    """Write frame0000.ply and so on, one for each of `moving.times`, all or none.

    Raises: InputError: as `replacing_folder`.
    """
    digits = max(4, len(str(len(moving.times) - 1)))
    with replacing_folder(folder, overwrite, f"frame{0:0{digits}d}.ply") as temporary:
        for number, time in enumerate(moving.times.tolist()):
            write_gaussians(temporary / f"frame{number:0{digits}d}.ply", moving.at(time))


def _check_counts(paths: list[Path]) -> None:
    counts = [_count(path) for path in paths]
    for path, count in zip(paths, counts, strict=True):
        if count != counts[0]:
            raise FormatError(
                f"{path}: {count} rows, {paths[0].name} has {counts[0]}: rows are one Gaussian through all frames only "
                "where every frame has the same ones, as exporters of deformed scenes write them; frames that were "
                "trained one by one have no rows in common"
            )


def _count(path: Path) -> int:
    with open_file(path) as file:
        head = file.read(MAX_FRAME_HEADER_BYTES)
    try:
        header = read_header(memoryview(head))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    if "vertex" not in header.elements:
        raise FormatError(f"{path}: PLY has no element 'vertex'")
    return header.elements["vertex"].count


class MovingFormat(NamedTuple):
    """A format of moving scenes.

    tells: whether a file or folder is one, by its names. read: `takes_times` of the first and the last frame, or
    has its own. row: in the table of docs/formats.md, as `known.SceneFormat.row`.
    """

    tells: Callable[[Path], bool]
    read: Callable[[Path, Times], Moving]
    takes_times: bool
    row: str


MOVING = (
    MovingFormat(
        is_sequence, read_ply_sequence, True,
        "| moving: numbered PLY files in a folder (`time_00000.ply` of 4DGaussians, `frame0001.ply` of SuperSplat) | "
        "yes | yes | the same rows in each; a frame's time is its number, or evenly between two given times "
        "([motion](#motion)) | frames of different counts, two sequences in a folder |",
    ),
    MovingFormat(
        _is_ours, lambda path, _: read_motion(path.parent if path.name == MOTION else path), False,
        "| moving: ours, a folder NAME.motion | 1 | yes | [layout](#motion) | motion of other Gaussians, times that "
        "do not increase, frames that are no Gaussians |",
    ),
)  # fmt: skip
