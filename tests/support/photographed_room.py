"""A made-up room whose walls and boxes are covered with random blots, photographed by cameras that are known."""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from PIL import Image

from drsplat.base.arrays import Colors, Pixels, PlanePoints, Points, Vector3
from drsplat.scene.views import View
from scenes import look_at_view

WIDTH, HEIGHT = 400, 300
ROOM = np.array([[-3.0, -2.5, 0.0], [3.0, 2.5, 2.6]])  # lowest and highest corner, metres, +z up
BOXES = np.array([[[-0.6, -0.5, 0.0], [0.4, 0.5, 0.9]], [[0.7, -1.2, 0.0], [1.3, -0.4, 1.5]]])
BLOTS_PER_METRE = 90
EXIF_FOCAL_35MM = 41989


def room_views(count: int = 10, height: float = 1.4) -> list[View]:
    """Cameras on an arc of a circle, level to some degrees, that look at the middle of the room."""
    turns = np.linspace(0, 1.6, count)
    eyes = [(2.1 * np.cos(t), 2.0 * np.sin(t), height + 0.12 * np.sin(5 * t)) for t in turns]
    views = [look_at_view(eye, (0.0, 0.0, 0.8), width=WIDTH, height=HEIGHT, fov_degrees=65) for eye in eyes]
    return [replace(view, name=f"photo_{index:02}.jpg") for index, view in enumerate(views)]


def photographed(view: View, seed: int = 0, fisheye: bool = False) -> Pixels:
    """Return what a camera in the room sees.

    seed: of the blots; another one is another room. fisheye: pixels from the middle are focal lengths times the angle.
    """
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    seen = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(view.K).T
    if fisheye:
        angle = np.hypot(seen[:, 0], seen[:, 1])
        seen[:, :2] *= (np.sin(angle) / np.maximum(angle, 1e-9))[:, None]
        seen[:, 2] = np.cos(angle)
    rays, eye = seen @ view.cam_from_world[:3, :3], view.center
    depth, face = _far_wall(eye, rays)
    for number, box in enumerate(BOXES):
        near, side = _near_side(eye, rays, box)
        nearer = near < depth
        depth[nearer], face[nearer] = near[nearer], 6 + 6 * number + side[nearer]
    colors = _blots(eye + depth[:, None] * rays, face, seed)
    return colors.reshape(view.height, view.width, 3)


def write_room(folder: Path, views: Sequence[View], seed: int = 0) -> list[View]:
    """Write the photos with the focal length in their EXIF; return the views with them."""
    folder.mkdir(parents=True, exist_ok=True)
    for view in views:
        (folder / view.name).write_bytes(jpeg(photographed(view, seed), exif_of(view)))
    return [replace(view, image_path=folder / view.name) for view in views]


def exif_of(view: View) -> Image.Exif:
    exif = Image.Exif()
    exif[271], exif[272] = "made-up", "pinhole"
    diagonal = np.hypot(view.width, view.height)
    exif.get_ifd(0x8769)[EXIF_FOCAL_35MM] = round(float(view.K[0, 0]) / diagonal * np.hypot(36, 24))
    return exif


def jpeg(pixels: Pixels, exif: Image.Exif | None = None) -> bytes:
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "JPEG", quality=92, exif=exif or Image.Exif())
    return content.getvalue()


def _far_wall(eye: Vector3, rays: Points) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance along rays to the walls from within, and which of six they are."""
    with np.errstate(divide="ignore"):
        far = np.where(rays > 0, ROOM[1] - eye, ROOM[0] - eye) / rays
    axis = np.abs(far).argmin(axis=1)
    return far[np.arange(len(rays)), axis], 2 * axis + (rays[np.arange(len(rays)), axis] > 0)


def _near_side(eye: Vector3, rays: Points, box: Float64[np.ndarray, "2 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance along rays to a box from outside (inf: missed), and which of its six sides they meet."""
    with np.errstate(divide="ignore"):
        one, other = (box[0] - eye) / rays, (box[1] - eye) / rays
    near, far = np.minimum(one, other), np.maximum(one, other)
    axis, entry = near.argmax(axis=1), near.max(axis=1)
    hit = (entry < far.min(axis=1)) & (entry > 0)
    return np.where(hit, entry, np.inf), 2 * axis + (rays[np.arange(len(rays)), axis] > 0)


def _blots(points: Points, face: np.ndarray, seed: int) -> Colors:
    """Return colours of points on faces: blots of several sizes, of each face its own."""
    across = np.array([[1, 2], [0, 2], [0, 1]])[(face % 6) // 2]
    flat = np.take_along_axis(points, across, axis=1) + 50.0
    total = np.full((len(points), 3), 0.5)
    for scale in (1, 0.45, 0.2, 0.08):
        table = np.random.default_rng([seed, int(100 * scale)]).uniform(-1, 1, (257, 257, 3))
        total += 0.22 * _smooth(table, flat * scale * BLOTS_PER_METRE / 3 + 31.7 * face[:, None])
    return (np.clip(total, 0, 1) * 255).astype(np.uint8)


def _smooth(table: Float64[np.ndarray, "a a 3"], at: PlanePoints) -> Points:
    low = np.floor(at).astype(int)
    fx, fy = (at - low).T[..., None]
    x, y = (low % 256).T
    return (
        table[y, x] * (1 - fx) * (1 - fy)
        + table[y, x + 1] * fx * (1 - fy)
        + table[y + 1, x] * (1 - fx) * fy
        + table[y + 1, x + 1] * fx * fy
    )
