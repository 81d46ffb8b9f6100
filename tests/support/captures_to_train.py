"""A small scene of known Gaussians, its photos from a ring of cameras, and perturbed points to start from."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import drsplat as ds
from drsplat.drawing.pictures import as_pixels, write_picture
from drsplat.formats.captures import SparsePoints
from drsplat.scene.gaussians import SH_C0
from scenes import look_at_view, random_gaussians

WIDTH, HEIGHT = 96, 72


def known_scene(count: int = 300) -> ds.Gaussians:
    """Of one degree of harmonics, nearly opaque."""
    scene = random_gaussians(count, seed=5, extent=1.0, size=0.16)
    opacities = np.maximum(scene.opacities, np.float32(0.5))
    sh = scene.sh * np.array([1.6, 0.3, 0.3, 0.3], np.float32)[:, None]
    return replace(scene, opacities=opacities, sh=sh)


def ring(count: int = 12) -> list[ds.View]:
    turns = 2 * np.pi * np.arange(count) / count
    eyes = [(3.2 * np.cos(t), 3.2 * np.sin(t), 1.2 * np.sin(2 * t)) for t in turns]
    views = [look_at_view(eye, width=WIDTH, height=HEIGHT, fov_degrees=50) for eye in eyes]
    return [replace(view, name=f"photo_{index:02}.png") for index, view in enumerate(views)]


def photographed(folder: Path, scene: ds.Gaussians, views: list[ds.View]) -> list[ds.View]:
    """The views with their photos, written to the folder."""
    for view in views:
        write_picture(folder / view.name, as_pixels(ds.render(scene, view).rgb))
    return [replace(view, image_path=folder / view.name) for view in views]


def perturbed_points(scene: ds.Gaussians, seed: int = 0, sigma: float = 0.03) -> SparsePoints:
    rng = np.random.default_rng(seed)
    positions = scene.means + rng.normal(0, sigma, scene.means.shape)
    colors = np.clip(0.5 + SH_C0 * scene.sh[:, 0], 0, 1) * 255
    return SparsePoints(positions, colors.astype(np.uint8))
