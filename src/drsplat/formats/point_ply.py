"""Point clouds as PLY: positions and colours, of any tool."""

from os import PathLike
from pathlib import Path

import numpy as np

from ..base.arrays import Float64, UInt8
from ..base.contents import file_bytes
from ..errors import FormatError, placed
from .ply import Records, read_elements, read_header

AXES, COLORS = ("x", "y", "z"), ("red", "green", "blue")
DEFAULT_GREY = 128  # of points without colour


def read_point_ply(path: str | PathLike[str]) -> tuple[Float64[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Return the positions and RGB of the element `vertex`, in file order; other elements and properties are left out.

    red, green and blue are whole numbers up to 255, or fractions up to 1; without them points are grey.

    Raises: InputError: there is no such file. FormatError: no PLY, truncated, without x, y, z, or a
    point that is not finite.
    """
    path = Path(path)
    buffer = file_bytes(path).data
    try:
        return _points(read_elements(buffer, read_header(buffer), {"vertex"})["vertex"])
    except FormatError as error:
        raise FormatError(placed(path, error)) from None


def _points(rows: Records) -> tuple[np.ndarray, np.ndarray]:
    names = rows.dtype.names or ()
    missing = [name for name in AXES if name not in names]
    if missing:
        raise FormatError(f"no points: vertex has no {', '.join(missing)}")
    positions = np.stack([rows[name].astype(np.float64) for name in AXES], axis=1)
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if len(bad):
        raise FormatError(f"{len(bad)} of {len(rows)} points are not finite, the first at index {bad[0]}")
    if not set(COLORS) <= set(names):
        return positions, np.full(positions.shape, DEFAULT_GREY, np.uint8)
    return positions, _bytes(np.stack([rows[name] for name in COLORS], axis=1))


def _bytes(colors: np.ndarray) -> UInt8[np.ndarray, "n 3"]:
    with np.errstate(all="ignore"):  # judged below
        scaled = colors * 255.0 if colors.dtype.kind == "f" else colors.astype(np.float64)
    if not ((scaled >= 0) & (scaled <= 255)).all():
        raise FormatError("expected colours of 0 to 255, or of 0 to 1 where they are fractions")
    return np.rint(scaled).astype(np.uint8)
