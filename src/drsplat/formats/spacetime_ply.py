"""PLY of SpacetimeGaussians: 3DGS columns, and how each row moves, turns, comes and goes.

Columns beside x y z, f_dc_*, opacity, scale_*, rot_*: trbf_center and trbf_scale (the logarithm of a width in time),
motion_0..8 (x, y, z for dt, then for dt^2, then for dt^3) and omega_0..3, which is added to the rotation as it is
stored, before it is normalised. Times of a film are 0 at its first frame and 1 at its end.

Source: Li et al., "Spacetime Gaussian Feature Splatting for Real-Time Dynamic View Synthesis" (2024); the PLY of its
published models. f_t_*, of the full model, feed a decoder of colours and are not read.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.contents import file_bytes
from ..errors import FormatError, InputError
from ..scene.moving import Moving, Spacetime
from .gaussian_ply import QUATS, drawn_as_marked, gaussian_rows, gaussians_of
from .ply import Header, gather, read_header

CENTER, WIDTH = "trbf_center", "trbf_scale"
MOTION = tuple(f"motion_{number}" for number in range(9))
TURNING = tuple(f"omega_{number}" for number in range(4))
COLUMNS = (CENTER, WIDTH, *MOTION, *TURNING)
FRAMES = 50  # of the published films


def is_spacetime(header: Header) -> bool:
    """Return True if a PLY has a column for the centre in time."""
    return "vertex" in header.elements and CENTER in header.elements["vertex"].names()


@np.errstate(all="ignore")  # what damaged floats do on the way is judged at its end
def read_spacetime(path: Path) -> Moving:
    """Read a moving scene; times are 0 to 1, `canonical` is each row at its own centre, as `read_gaussians` reads it.

    Raises: InputError: there is no such file. FormatError: no such PLY, truncated, or rows that are no Gaussians, or do
    not move as they may.
    """
    content = file_bytes(path)
    try:
        header = read_header(content.data)
        rows = gaussian_rows(content.data, header)
        missing = [name for name in COLUMNS if name not in (rows.dtype.names or ())]
        if missing:
            raise FormatError(f"no PLY of SpacetimeGaussians: vertex has no {', '.join(missing)}")
        gaussians = gaussians_of(rows)
        lengths = np.linalg.norm(gather(rows, QUATS).astype(np.float64), axis=1, keepdims=True)
        own = {name: column for name, column in gaussians.extra.items() if name not in COLUMNS}
        motion = Spacetime(
            replace(drawn_as_marked(gaussians, header), extra=own).localized(),
            gather(rows, [CENTER])[:, 0],
            np.exp(gather(rows, [WIDTH])[:, 0].astype(np.float64)),
            gather(rows, MOTION).reshape(-1, 3, 3),
            gather(rows, TURNING) / lengths,
        )
    except (FormatError, InputError) as error:
        raise FormatError(f"{path}: {error}") from None
    return Moving(motion.canonical, np.linspace(0, 1, FRAMES + 1), motion)
