"""The float64 twin of the training pass: an image as a smooth function of what is optimised.

An image has jumps (the 1/255 cut, the stop, the order in depth) and kinks (the 0.99 cap, colours at
zero, the clamp of the Jacobian), where a finite difference measures nothing. So the *decisions* are
taken once, for the parameters as given, and kept while the parameters move. What is left is smooth,
and its derivative is what a backward pass must return.

Source: Kerbl et al. 2023 (3D Gaussian Splatting) Eq. 3-6; Zwicker et al. 2001 for the projection.
"""

from typing import NamedTuple

import numpy as np

from drsplat.base.arrays import (
    AnyPoints,
    Bool,
    Doubles,
    Float,
    Float64,
    Int,
    Mask,
    Matrices,
    PlanePoints,
    Points,
    Vector3,
)
from drsplat.scene.gaussians import PUBLISHED_NEAR
from drsplat.scene.views import View

from .compositing import ALPHA_BAND, MAX_ALPHA, contributors
from .projection import BLUR, FRUSTUM_MARGIN, dimming
from .registering import sh_basis


class Parameters(NamedTuple):
    """What is optimised, before activation, in any float type.

    Activated: exp of log_scales, sigmoid of logits, quats (w, x, y, z) divided by their length.
    """

    means: AnyPoints
    log_scales: AnyPoints
    quats: Float[np.ndarray, "n 4"]
    logits: Float[np.ndarray, " n"]
    sh: Float[np.ndarray, "n k 3"]


class Branches(NamedTuple):
    """On which side of its kinks each Gaussian is.

    sides: -1, 0, 1 where x/z, y/z are below, within, above the limits of the Jacobian.
    lit: the channels whose colour is above zero.
    """

    sides: Int[np.ndarray, "n 2"]
    lit: Bool[np.ndarray, "n 3"]


class Entries(NamedTuple):
    """Who adds to which pixel (row * width + column): pixel by pixel, front to back.

    capped: alpha is held at 0.99.
    """

    pixels: Int[np.ndarray, " e"]
    ids: Int[np.ndarray, " e"]
    capped: Bool[np.ndarray, " e"]


class Decisions(NamedTuple):
    """All that a forward pass decides. unsure: pixels where float32 may decide otherwise."""

    entries: Entries
    branches: Branches
    unsure: Mask


class Footprints(NamedTuple):
    """What compositing sees of each Gaussian. covariances: xx, xy, yy in pixels squared."""

    centers: PlanePoints
    covariances: Points
    opacities: Doubles
    colors: Points


class _Splats(NamedTuple):
    means: Float64[np.ndarray, "3 n"]
    covariances: Float64[np.ndarray, "6 n"]
    opacities: Doubles
    near: float
    origin: Vector3
    antialiased: bool


def decide(
    parameters: Parameters, view: View, sh_degree: int, near: float = PUBLISHED_NEAR, antialiased: bool = False
) -> Decisions:
    """Take the decisions of the view's forward pass."""
    scene = float64_of(parameters)
    rows, columns = np.triu_indices(3)
    solid = np.ascontiguousarray(_covariances(scene)[:, rows, columns].T)
    splats = _Splats(scene.means.T, solid, _sigmoid(scene.logits), near, np.zeros(3), antialiased)
    seen = contributors(splats, view)
    slopes, limits = _slopes(scene, view), _limits(view)
    sides = (slopes > limits).astype(np.int64) - (slopes < -limits)
    branches = Branches(sides, _raw_colors(scene, view, sh_degree) > 0)
    free = Entries(seen.pixels, seen.ids, np.zeros(len(seen.ids), bool))
    alphas = alphas_of(footprints(scene, view, sh_degree, branches, antialiased), free, view.width)
    unsure = seen.unsure.copy()
    unsure.ravel()[seen.pixels[np.abs(alphas / MAX_ALPHA - 1) < ALPHA_BAND]] = True
    return Decisions(free._replace(capped=alphas > MAX_ALPHA), branches, unsure)


def image(
    parameters: Parameters,
    view: View,
    sh_degree: int,
    background: Float[np.ndarray, " 3"],
    decisions: Decisions,
    antialiased: bool = False,
) -> Float64[np.ndarray, "h w 3"]:
    """The view's image, under decisions that may have been taken for other parameters."""
    marks = footprints(float64_of(parameters), view, sh_degree, decisions.branches, antialiased)
    out = np.tile(background.astype(np.float64), (view.height * view.width, 1))
    pixels, ids, _ = decisions.entries
    alphas = alphas_of(marks, decisions.entries, view.width)
    out[np.unique(pixels)] = composite(alphas, marks.colors[ids], pixels, background)
    return np.asarray(out.reshape(view.height, view.width, 3))


def footprints(
    scene: Parameters, view: View, sh_degree: int, branches: Branches, antialiased: bool = False
) -> Footprints:
    """Activate and project, on the given side of every kink. One row of branches serves for all."""
    rotation, focal = view.cam_from_world[:3, :3], view.K[[0, 1], [0, 1]]
    depths = (scene.means @ rotation[2] + view.cam_from_world[2, 3])[:, None]
    slopes, limits = _slopes(scene, view), _limits(view)
    clamped = np.where(branches.sides == 0, slopes, branches.sides * limits)
    jacobian = np.zeros((len(depths), 2, 3))
    jacobian[:, [0, 1], [0, 1]] = focal / depths
    jacobian[:, :, 2] = -focal * clamped / depths
    jacobian = jacobian @ rotation
    sharp = (jacobian @ _covariances(scene) @ jacobian.transpose(0, 2, 1))[:, [0, 0, 1], [0, 1, 1]]
    widened, opacities = sharp + BLUR * np.array([1, 0, 1]), _sigmoid(scene.logits)
    if antialiased:
        opacities = opacities * dimming(sharp, widened)
    colors = np.where(branches.lit, _raw_colors(scene, view, sh_degree), 0.0)
    centers = focal * slopes + view.K[:2, 2]
    return Footprints(centers, widened, opacities, colors)


def composite(
    alphas: Float64[np.ndarray, " e"],
    colors: Float64[np.ndarray, "e 3"],
    pixels: Int[np.ndarray, " e"],
    background: Float[np.ndarray, " 3"],
) -> Float64[np.ndarray, "p 3"]:
    """Colours of the pixels that occur in `pixels`, in their order."""
    if not len(pixels):
        return np.empty((0, 3))
    starts = np.flatnonzero(np.diff(pixels, prepend=-1))
    passed = np.log1p(-alphas)
    sums = np.cumsum(passed) - passed  # over all entries before this one, of any pixel
    before = np.exp(sums - np.repeat(sums[starts], np.diff(starts, append=len(pixels))))
    total = np.add.reduceat((alphas * before)[:, None] * colors, starts)
    left = np.exp(np.add.reduceat(passed, starts))
    return np.asarray(total + left[:, None] * background)


def alphas_of(marks: Footprints, entries: Entries, width: int) -> Float64[np.ndarray, " e"]:
    rows, columns = np.divmod(entries.pixels, width)
    centers = marks.centers[entries.ids]
    dx, dy = columns + 0.5 - centers[:, 0], rows + 0.5 - centers[:, 1]
    xx, xy, yy = marks.covariances[entries.ids].T
    exponents = 0.5 * (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alphas = marks.opacities[entries.ids] * np.exp(-exponents)
    return np.asarray(np.where(entries.capped, MAX_ALPHA, alphas))


def _raw_colors(scene: Parameters, view: View, sh_degree: int) -> Points:
    """0.5 + SH of the active degrees, not yet cut at zero."""
    directions = scene.means - view.center
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    active = (sh_degree + 1) ** 2
    basis = sh_basis(directions)[:, :active]
    return np.asarray(0.5 + np.einsum("nk,nkc->nc", basis, scene.sh[:, :active]))


def _covariances(scene: Parameters) -> Matrices:
    w, x, y, z = (scene.quats / np.linalg.norm(scene.quats, axis=1, keepdims=True)).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    axes = rotation.transpose(2, 0, 1) * np.exp(scene.log_scales)[:, None, :]
    return np.asarray(axes @ axes.transpose(0, 2, 1))


def _slopes(scene: Parameters, view: View) -> PlanePoints:
    points = scene.means @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    return np.asarray(points[:, :2] / points[:, 2:])


def _limits(view: View) -> Float64[np.ndarray, " 2"]:
    focal = view.K[[0, 1], [0, 1]]
    return np.asarray(FRUSTUM_MARGIN * 0.5 * np.array([view.width, view.height]) / focal)


def _sigmoid(logits: Doubles) -> Doubles:
    return np.asarray(1 / (1 + np.exp(-logits)))


def float64_of(parameters: Parameters) -> Parameters:
    return Parameters(*(column.astype(np.float64) for column in parameters))
