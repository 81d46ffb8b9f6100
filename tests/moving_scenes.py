"""Small scenes that move, for tests; and PLY files of SpacetimeGaussians, written by hand."""

from dataclasses import replace

import numpy as np

from drsplat.formats.ply import write_vertices
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.moving import Frames, Moving
from scenes import random_gaussians


def still(gaussians: Gaussians, times: np.ndarray | None = None) -> Moving:
    """A scene whose frames are all the same."""
    stamps = np.array([0.0, 0.5, 1.0]) if times is None else times
    return Moving(gaussians, stamps, Frames(stamps, lambda _: replace(gaussians)))


def drifting(count: int = 120, seed: int = 0, times: np.ndarray | None = None) -> Moving:
    """Each row along a line of its own, turning about an axis of its own."""
    gaussians = random_gaussians(count, seed)
    rng = np.random.default_rng([seed, 1])
    speed, spin = rng.normal(0, 0.5, (count, 3)), rng.normal(0, 0.3, (count, 4))
    stamps = np.linspace(0, 2, 5) if times is None else times

    def frame(number: int) -> Gaussians:
        quats = gaussians.quats + spin * stamps[number]
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        means = gaussians.means + speed * stamps[number]
        return replace(gaussians, means=means.astype(np.float32), quats=quats.astype(np.float32))

    return Moving(frame(0), stamps, Frames(stamps, frame))


def spacetime_columns(count: int = 60, seed: int = 0) -> dict[str, np.ndarray]:
    """The columns of the published format, before any activation; rotations are of no unit length."""
    rng = np.random.default_rng(seed)
    names = ["x", "y", "z", "trbf_center", "trbf_scale", "nx", "ny", "nz"]
    names += [f"motion_{number}" for number in range(9)] + ["f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += [f"scale_{number}" for number in range(3)] + [f"rot_{number}" for number in range(4)]
    names += [f"omega_{number}" for number in range(4)]
    columns = {name: rng.normal(0, 1, count).astype(np.float32) for name in names}
    columns |= {name: np.zeros(count, np.float32) for name in ("nx", "ny", "nz")}
    columns |= {f"scale_{number}": rng.normal(-3, 0.3, count).astype(np.float32) for number in range(3)}
    columns["trbf_center"] = rng.uniform(0, 1, count).astype(np.float32)
    return columns


def write_spacetime(path: str, columns: dict[str, np.ndarray]) -> None:
    write_vertices(path, columns)
