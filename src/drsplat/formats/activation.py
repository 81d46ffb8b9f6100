"""Activation: numbers of scene files (logits, logarithms, bytes) become checked, post-activation Gaussians.

Nothing is repaired: a row that cannot be a Gaussian is an error that says which and how many,
because dropping or mending rows would change what a row number means.

Checks of scenes that no file could give back, the same for every format.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..base.arrays import Anywhere, Array, Bool, Float32, FloatRows, Harmonics, Numbers, Quats, Vectors, WholeNumbers
from ..base.contents import AnyPath
from ..errors import FormatError, InputError
from ..scene.gaussians import Gaussians

BLOCK_ROWS = 1 << 13
CURE = (
    "Delete these Gaussians in the tool that wrote the file (SuperSplat, or splat-transform --filter-nan) and read it "
    "again; rows are never dropped here, because the row number is a Gaussian's identity"
)
MEANT_OTHERWISE = (
    "That is no accident of a few rows: the program that wrote the file means something else by these numbers, such as "
    "logarithms and logits where sizes and opacities belong, or the reverse. Export it again as this format has them"
)
SCALE_RANGE = "that are not finite or, after exp(scale_0..2), not in float32's positive range"
# Column of [three stored, largest] for each of the four components, by the index of the largest.
SMALLEST_THREE = np.array([[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]])


def sigmoid(logits: Float32[Anywhere, " n"]) -> Float32[Anywhere, " n"]:
    """Return 1 / (1 + exp(-x)); plus and minus infinity, which SuperSplat writes, are exactly 1 and 0."""
    wide: Anywhere = 1 / (1 + np.exp(-logits.astype(np.float64)))
    return wide.astype(np.float32)


def logit(opacities: Numbers) -> Numbers:
    """Return the inverse of `sigmoid`, finite: 0 and 1 become the logits that come back as exactly 0 and 1."""
    wide = opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        finite: Array = np.clip(np.log(wide) - np.log1p(-wide), -105, 18)
    return finite.astype(np.float32)


def exp(log_scales: FloatRows) -> FloatRows:
    """Take the natural exponential in place; what overflows is left infinite for `checked` to report."""
    np.exp(log_scales, out=log_scales)
    return log_scales


def unit_quats(quats: Quats) -> Quats:
    """Normalise in place; a row without a direction becomes NaN or infinite."""
    quats /= np.sqrt(np.einsum("ni,ni->n", quats, quats, dtype=np.float64))[:, None]
    return quats


def from_smallest_three(three: Vectors, largest: WholeNumbers) -> Quats:
    """Return unit quaternions from all components but the one at index `largest`, which is positive."""
    rest = 1 - np.einsum("ni,ni->n", three, three)
    four = np.column_stack([three, np.sqrt(np.maximum(rest, 0))])
    return np.take_along_axis(four, SMALLEST_THREE[largest], axis=1)


@np.errstate(all="ignore")
def checked(
    means: Vectors,
    quats: Quats,
    scales: Vectors,
    opacities: Numbers,
    sh: Harmonics,
    extra: Mapping[str, Array] = {},
    antialiased: bool = False,
) -> Gaussians:
    """Return Gaussians with normalised quats (in place), once every row has passed the checks.

    Raises: FormatError: a row with a position or colour that is not finite, a rotation without a
    direction, a scale that is not finite and positive, or an opacity that is no number.
    """
    _require_finite(means, "positions (x, y, z) that are not finite")
    _require_finite(unit_quats(quats), "rotations (rot_0..3) that are zero or not finite")
    _require(np.logical_and(scales > 0, scales < np.inf), f"scales {SCALE_RANGE}")
    shares = np.logical_and(opacities >= 0, opacities <= 1)
    _require(shares, "opacities that are not a number in [0, 1]")
    _require_finite(sh, "colours (f_dc, f_rest) that are not finite")
    return Gaussians(means, quats, scales, opacities, sh, dict(extra), antialiased=antialiased)


def _require_finite(values: Float32[Array, "n ..."], what: str) -> None:
    blocks = range(0, len(values), BLOCK_ROWS)
    if not all(np.isfinite(values[start : start + BLOCK_ROWS]).all() for start in blocks):
        _require(np.isfinite(values), what)


def _require(good: Bool[Array, "n ..."], what: str) -> None:
    if np.all(good):
        return
    bad = np.flatnonzero((~good).reshape(len(good), -1).any(1))
    cure = MEANT_OTHERWISE if 2 * len(bad) > len(good) > 1 else CURE
    raise FormatError(f"{len(bad)} of {len(good)} rows have {what}; the first is row {bad[0]}. {cure}")


PACKED_SUFFIX = ".compressed.ply"


def refuse_packed_name(path: AnyPath) -> None:
    """Refuse a name that promises SuperSplat's packed form. Raises: InputError."""
    name = Path(path).name
    if name.lower().endswith(PACKED_SUFFIX):
        stem = name[: -len(PACKED_SUFFIX)]
        raise InputError(
            f"{name}: a name of SuperSplat's compressed PLY, which is read and not written: name it {stem}.ply; "
            "`drsplat export` writes .sog and .spz, which are as small"
        )


def refuse_unwritable(gaussians: Gaussians) -> None:
    """Refuse a scene that no program can draw. Raises: InputError: no Gaussians, or as `refuse_unreadable`."""
    if not len(gaussians):
        raise InputError("there are no Gaussians to write: choose something that is there")
    refuse_unreadable(gaussians)


def refuse_unreadable(g: Gaussians) -> None:
    """Refuse rows that no reader would take, such as NaN. Raises: InputError: which ones, and how many."""
    try:
        checked(g.means, g.quats.copy(), g.scales, g.opacities, g.sh)
    except FormatError as error:
        raise InputError(f"these Gaussians could not be read back: {error}") from None
