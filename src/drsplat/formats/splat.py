"""`.splat` of antimatter15's viewer: records of 32 bytes and no header.

position 3 x float32, scale 3 x float32 (not logarithms), colour and opacity 4 x uint8, rotation
(w, x, y, z) 4 x uint8 as (byte - 128) / 128. Axes are those of the PLY it was made from. There is
no view-dependent colour, and the common converter has sorted the rows by size and opacity.

Source: the format notes of github.com/antimatter15/splat.
"""

import numpy as np

from ..errors import FormatError
from ..scene.gaussians import SH_C0, Gaussians
from .activation import checked

RECORD = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])


def parse_splat(buffer: memoryview) -> Gaussians:
    """Return the Gaussians of a `.splat` file, SH degree 0.

    Raises: FormatError: a size that is no whole number of records, or rows that are no Gaussians.
    """
    if len(buffer) == 0 or len(buffer) % RECORD.itemsize:
        raise FormatError(
            f"a .splat file is records of {RECORD.itemsize} bytes; {len(buffer)} bytes are no whole number of them"
        )
    rows = np.frombuffer(buffer, RECORD)
    colour = rows["rgba"].astype(np.float32) / 255
    return checked(
        rows["means"].astype(np.float32),
        (rows["quats"].astype(np.float32) - 128) / 128,
        rows["scales"].astype(np.float32),
        colour[:, 3].copy(),
        (colour[:, None, :3] - np.float32(0.5)) / np.float32(SH_C0),
    )
