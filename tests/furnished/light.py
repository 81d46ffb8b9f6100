"""Light baked into the colours: a few lamps, each with a shadow map rendered from where it hangs."""

import numpy as np
from jaxtyping import Bool, Float64
from world.cameras import look_at

from drsplat.kernels import SplatArrays, render_channels, splat_arrays
from drsplat.scene.gaussians import SH_C0, Gaussians

AMBIENT, SIZE, FOV_DEGREES, BIAS = 0.40, 256, 118.0, 0.045  # BIAS in metres
LAMPS = (  # position, share of the light, radius over which it is spread for soft shadows, samples
    ((3.6, 0.0, 2.9), 0.48, 0.55, 10),
    ((1.3, 0.6, 2.7), 0.20, 0.40, 4),
    ((2.3, 1.9, 2.9), 0.16, 0.40, 4),
    ((4.9, 2.4, 2.4), 0.12, 0.40, 3),
    ((1.6, -0.9, 1.5), 0.14, 0.40, 3),
)


def color_to_sh(colors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 1 3"]:
    sh: np.ndarray = ((colors - 0.5) / SH_C0)[:, None, :]
    return sh


def lit(gaussians: Gaussians, normals: Float64[np.ndarray, "n 3"], glows: Bool[np.ndarray, " n"]) -> Gaussians:
    """The Gaussians with their colours shaded; those that glow keep theirs."""
    splats = splat_arrays(gaussians)
    shade = np.full(len(gaussians), AMBIENT)
    for center, share, radius, samples in LAMPS:
        for turn in np.arange(samples) * 2 * np.pi / samples:
            at = np.add(center, (radius * np.cos(turn), radius * np.sin(turn), 0))
            shade += share / samples * _lamp(gaussians, splats, normals, at)
    shade[glows] = 1.0
    colors = np.clip((0.5 + SH_C0 * gaussians.sh[:, 0]) * shade[:, None], 0, 1)
    columns = gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities
    return Gaussians(*columns, color_to_sh(colors).astype(np.float32))


def _lamp(
    gaussians: Gaussians, splats: SplatArrays, normals: Float64[np.ndarray, "n 3"], at: Float64[np.ndarray, " 3"]
) -> Float64[np.ndarray, " n"]:
    """Cosine of the light's angle where the lamp is seen, else 0."""
    to_lamp = at - gaussians.means.astype(np.float64)
    to_lamp /= np.linalg.norm(to_lamp, axis=1, keepdims=True)
    lambert: np.ndarray = np.clip((to_lamp * normals).sum(1), 0, 1) ** 0.8  # a lamp of some size
    received: np.ndarray = lambert * _seen_from(gaussians, splats, at, BIAS / np.maximum(lambert, 0.25))
    return received


def _seen_from(
    gaussians: Gaussians, splats: SplatArrays, at: Float64[np.ndarray, " 3"], bias: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """1 where the lamp is seen, 0 in its shadow. bias: depth that counts as the same, in metres."""
    view = look_at(at, (2.2, 2.1, 0.3), (SIZE, SIZE), FOV_DEGREES)
    depth = render_channels(splats, view, np.zeros((len(gaussians), 0), np.float32)).depth
    camera = gaussians.means @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    z = np.maximum(camera[:, 2], 1e-3)
    pixel = (camera @ view.K.T)[:, :2] / z[:, None]
    inside = (camera[:, 2] > 0.2) & (pixel >= 0).all(1) & (pixel < SIZE).all(1)
    column, row = np.where(inside[:, None], pixel, 0).astype(int).T
    seen: np.ndarray = np.clip(2 - (z - depth[row, column]) / bias, 0, 1)
    shadow: np.ndarray = np.where(inside, seen, 1.0)
    return shadow
