"""3DGS PLY as INRIA's trainer, nerfstudio, gsplat and SuperSplat write it.

The file holds values before their activation: `scale_0..2` are logarithms, `opacity` a logit, `rot_0..3` (w, x, y, z)
not normalised, `f_dc_0..2` the constant SH coefficient and `f_rest_*` the others channel by channel (all of red, then
green, then blue). Axes are the training frame's. Properties are found by name, in any order and of any scalar type.

A comment of the header says whether opacities are of Gaussians that are drawn antialiased, in one of two spellings
(`drawn_as_marked`); without one they are not. A file without `scale_2`, or with the comment "SplatRenderMode: 2dgs",
is of surfels, which are read as Gaussians next to no thickness.

Source: Kerbl et al., "3D Gaussian Splatting" (2023); the PLY properties of its published models, and of those of Huang
et al., "2D Gaussian Splatting" (2024).
"""

from dataclasses import replace

import numpy as np

from ..base.arrays import Float32, Float64
from ..errors import FormatError
from ..scene.gaussians import SH_COEFFICIENTS, Gaussians, flat
from ..scene.placing import local_origin
from .activation import checked, exp, logit, sigmoid
from .ply import Records, gather, read_elements
from .ply_header import Header
from .writable import refuse_unreadable

MEANS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES = ("scale_0", "scale_1", "scale_2")
THICKNESS_PROPERTY = SCALES[2]  # surfels lack it
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
ANTIALIASED, SURFELS = "SplatRenderMode: mip", "SplatRenderMode: 2dgs"  # as Brush writes it
DRAWN_ANTIALIASED = ("splatrendermode: mip", "antialiased 1")
MARKED = ("splatrendermode: ", "antialiased ")
REQUIRED = (*MEANS, *DC, "opacity", *SCALES, *QUATS)


def parse_gaussian_ply(buffer: memoryview, header: Header) -> Gaussians:
    """Return the Gaussians of the element `vertex`.

    Further scalar properties are kept in `extra` with their types; so are normals, unless all are
    zero (trainers write zeros there for want of anything to say).

    Raises: FormatError: no 3DGS PLY, truncated, or rows that are no Gaussians.
    """
    return drawn_as_marked(gaussians_of(gaussian_rows(buffer, header)), header)


def drawn_as_marked(gaussians: Gaussians, header: Header) -> Gaussians:
    """Return Gaussians that are antialiased, or surfels, as the last comment says that speaks of it.

    Brush writes `SplatRenderMode: default`, `mip` or `2dgs`, Postshot `antialiased 0` or `1`; case does not count.
    Those of a file without `scale_2` are surfels already, whatever a comment says.
    """
    comments = [" ".join(comment.lower().split()) for comment in header.comments]
    mark = next((comment for comment in reversed(comments) if comment.startswith(MARKED)), "")
    if gaussians.surfels:
        return gaussians
    return (
        gaussians.flattened() if mark == SURFELS.lower() else replace(gaussians, antialiased=mark in DRAWN_ANTIALIASED)
    )


def gaussian_rows(buffer: memoryview, header: Header) -> Records:
    """Return the rows of `vertex` as they are in the file; of a binary one, a view of `buffer`.

    Raises: FormatError: no 3DGS PLY, or truncated.
    """
    names = header.elements["vertex"].names() if "vertex" in header.elements else []
    missing = [name for name in REQUIRED if name not in names]
    if missing and missing != [THICKNESS_PROPERTY]:
        raise FormatError(
            f"no 3DGS PLY: vertex has no {', '.join(missing)}; it has {', '.join(names[:12]) or 'nothing'}. Point "
            "clouds and meshes have to be trained into Gaussians first"
        )
    _sh_names(names)
    return read_elements(buffer, header, {"vertex"})["vertex"]


def gaussians_of(rows: Records) -> Gaussians:
    """Return some rows of `vertex`. Raises: FormatError: rows that are no Gaussians."""
    sh_names = _sh_names(list(rows.dtype.names or ()))
    means, origin = _means(rows)
    gaussians = checked(
        means,
        gather(rows, QUATS),
        _scales(rows),
        sigmoid(gather(rows, ["opacity"])[:, 0]),
        gather(rows, sh_names).reshape(len(rows), len(sh_names) // 3, 3),
        extra_columns(rows, {*REQUIRED, *sh_names}),
    )
    return replace(gaussians, origin=origin)


def _scales(rows: Records) -> Float32[np.ndarray, "n 3"]:
    if THICKNESS_PROPERTY in (rows.dtype.names or ()):
        return exp(gather(rows, SCALES))
    return flat(exp(gather(rows, SCALES[:2])))


def _means(rows: Records) -> tuple[Float32[np.ndarray, "n 3"], Float64[np.ndarray, " 3"]]:
    """Return the positions and what they are counted from: doubles far from zero would lose as float32."""
    if not any(rows.dtype[name].base == np.float64 for name in MEANS):
        return gather(rows, MEANS), np.zeros(3)
    positions = np.stack([rows[name] for name in MEANS], 1).astype(np.float64)
    origin = local_origin(positions)
    return (positions - origin).astype(np.float32), origin


def _sh_names(names: list[str]) -> list[str]:
    """Return the property names in the memory order of Gaussians.sh: by coefficient, channels innermost."""
    count = sum(name.startswith("f_rest_") for name in names)
    per_channel = count // 3
    rest = [f"f_rest_{channel * per_channel + c}" for c in range(per_channel) for channel in range(3)]
    if count % 3 or 1 + per_channel not in SH_COEFFICIENTS or not set(rest) <= set(names):
        raise FormatError(
            f"vertex has {count} f_rest properties; expected f_rest_0 onwards, 0, 9, 24 or 45 of them (SH degree 0-3)"
        )
    return [*DC, *rest]


def extra_columns(rows: Records, known: set[str]) -> dict[str, np.ndarray]:
    """Return copies, in native byte order, of the columns that are not `known`."""
    names = [name for name in rows.dtype.names or () if name not in known]
    extra = {name: rows[name].astype(rows.dtype[name].newbyteorder("=")) for name in names}
    if not any(extra[name].any() for name in NORMALS if name in extra):
        extra = {name: column for name, column in extra.items() if name not in NORMALS}
    return extra


def vertex_columns(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Return pre-activation columns in the published order, normals among them, without other extras.

    Normals are those of `extra`, or zero, as trainers write them: viewers of 3DGS read rows of a fixed length.

    Positions are those of the world: float64 where float32 would lose some of them, else float32. Surfels have no third
    scale, as 2DGS writes them.

    Raises: InputError: values that could not be read back.
    """
    refuse_unreadable(gaussians)
    widths = SCALES[:2] if gaussians.surfels else SCALES
    rest = [gaussians.sh[:, c, channel] for channel in range(3) for c in range(1, gaussians.sh.shape[1])]
    log_scales = np.log(gaussians.scales)
    return {
        **dict(zip(MEANS, gaussians.narrow_positions.T, strict=True)),
        **{name: np.asarray(gaussians.extra.get(name, np.zeros(len(gaussians))), np.float32) for name in NORMALS},
        **dict(zip(DC, gaussians.sh[:, 0].T, strict=True)),
        **{f"f_rest_{i}": column for i, column in enumerate(rest)},
        "opacity": logit(gaussians.opacities),
        **dict(zip(widths, log_scales.T, strict=False)),
        **dict(zip(QUATS, gaussians.quats.T, strict=True)),
    }
