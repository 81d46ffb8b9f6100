"""Numbered PLY files with the same rows, one for each time: time_00000.ply (4DGaussians), frame0001.ply (SuperSplat).

A frame's time is its number, unless other times are given.
"""

import re
from pathlib import Path

import numpy as np

from ..base.contents import open_file
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians
from ..scene.moving import Frames, Moving, counted_from
from .field_folder import replacing_folder
from .gaussian_ply import write_gaussians
from .ply_header import read_header
from .scenes import read_gaussians

NUMBERED = re.compile(r"(.*?)(\d{1,12})\.ply", re.IGNORECASE)
MAX_HEADER_BYTES = 1 << 16
MAX_FRAMES = 100_000


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


def read_ply_sequence(folder: Path, times: tuple[float, float] | None = None) -> Moving:
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
        return _same_rows(read_gaussians(paths[number]), canonical, paths[number])

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


def _same_rows(gaussians: Gaussians, canonical: Gaussians, path: Path) -> Gaussians:
    if gaussians.sh.shape != canonical.sh.shape:
        raise FormatError(f"{path}: harmonics {gaussians.sh.shape}, those of the first frame {canonical.sh.shape}")
    if gaussians.antialiased != canonical.antialiased:
        raise FormatError(f"{path}: marked antialiased {gaussians.antialiased}, the first frame is the other way")
    return counted_from(gaussians, canonical.origin)


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
        head = file.read(MAX_HEADER_BYTES)
    try:
        header = read_header(memoryview(head))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    if "vertex" not in header.elements:
        raise FormatError(f"{path}: PLY has no element 'vertex'")
    return header.elements["vertex"].count
