"""Captures written by hand, after the formats' public descriptions and without drsplat's code.

A camera is (id, model, width, height, parameters), an image (id, quaternion wxyz, translation,
camera id, name), a point (id, xyz, rgb). Images with odd numbers have two observations, of
which the second is of the first point.
"""

import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")

NO_POINT = 2**64 - 1  # of an observation without a point

CAMERAS = [
    (1, "PINHOLE", 64, 48, (70.0, 71.0, 32.0, 24.0)),
    (7, "OPENCV", 64, 48, (60.0, 61.0, 30.5, 25.25, 0.05, -0.01, 0.002, -0.003)),
]
IMAGES = [
    (3, (0.9, 0.1, -0.2, 0.3), (0.1, -0.2, 3.0), 1, "b.png"),
    (1, (0.5, -0.5, 0.5, 0.5), (1.0, 2.0, 5.0), 1, "a photo.png"),
    (2, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 4.0), 7, "cam0/c.png"),
]
POINTS = [(9, (0.5, -0.25, 1.5), (255, 0, 7)), (4, (1.0, 2.0, -3.0), (10, 20, 30))]


def write_colmap_text(folder: Path, cameras=CAMERAS, images=IMAGES, points=POINTS) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"{i} {model} {w} {h} {' '.join(map(repr, p))}" for i, model, w, h, p in cameras]
    (folder / "cameras.txt").write_text("# a comment\n" + "\n".join(lines) + "\n")
    lines = []
    for i, q, t, camera, name in images:
        seen = f"1.5 2.5 -1 3.0 4.0 {points[0][0] if points else -1}" if i % 2 else ""
        lines += [f"{i} {' '.join(map(repr, (*q, *t)))} {camera} {name}", seen]
    (folder / "images.txt").write_text("# a comment\n" + "\n".join(lines) + "\n")
    track = [f" {i} 1" for i, *_ in images if i % 2]
    lines = [
        f"{i} {' '.join(map(repr, (*x, *c)))} 0.5{''.join(track if i == points[0][0] else [])}" for i, x, c in points
    ]
    (folder / "points3D.txt").write_text("# a comment\n" + "\n".join(lines) + "\n")


def write_colmap_binary(folder: Path, cameras=CAMERAS, images=IMAGES, points=POINTS) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    data = struct.pack("<Q", len(cameras))
    for i, model, w, h, p in cameras:
        data += struct.pack(f"<IiQQ{len(p)}d", i, MODELS.index(model), w, h, *p)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for i, q, t, camera, name in images:
        data += struct.pack("<I7dI", i, *q, *t, camera) + name.encode() + b"\0"
        first = points[0][0] if points else NO_POINT
        data += struct.pack("<QddQddQ", 2, 1.5, 2.5, NO_POINT, 3.0, 4.0, first) if i % 2 else struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for i, x, c in points:
        track = [number for i, *_ in images if i % 2 for number in (i, 1)] if i == points[0][0] else []
        data += struct.pack("<Q3d3BdQ", i, *x, *c, 0.5, len(track) // 2) + struct.pack(f"<{len(track)}I", *track)
    (folder / "points3D.bin").write_bytes(data)


def write_photo(path: Path, width: int = 64, height: int = 48) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (width, height), (40, 80, 120)).save(path)


def write_photos(folder: Path, images=IMAGES, width: int = 64, height: int = 48) -> None:
    for *_, name in images:
        write_photo(folder / name, width, height)


def model_of(views) -> tuple[list, list]:
    """Cameras and images of pinhole views, for the writers."""
    cameras, images = [], []
    for number, view in enumerate(views, 1):
        lens, pose = view.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), view.cam_from_world
        quaternion = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1).tolist()
        cameras.append((number, "PINHOLE", view.width, view.height, lens))
        images.append((number, quaternion, pose[:3, 3].tolist(), number, view.name))
    return cameras, images


def camera_to_world(quaternion, translation) -> np.ndarray:
    """4x4, OpenCV axes, by SciPy."""
    w, x, y, z = quaternion
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    world_to_camera[:3, 3] = translation
    return np.linalg.inv(world_to_camera)


def transforms_document(cameras=CAMERAS, images=IMAGES, folder: str = "images/") -> dict:
    """With intrinsics per frame, in OpenGL axes."""
    by_id = {camera[0]: camera for camera in cameras}
    frames = []
    for _, q, t, camera, name in images:
        _, model, w, h, p = by_id[camera]
        frame = {"file_path": folder + name, "w": w, "h": h, "camera_model": model}
        frame |= dict(zip(("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"), p, strict=False))
        pose = camera_to_world(q, t) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append(frame | {"transform_matrix": pose.tolist()})
    return {"frames": frames}


def cameras_json_document(cameras=CAMERAS[:1], images=IMAGES[:2]) -> list:
    """What 3DGS training writes; of centred pinhole cameras only."""
    by_id = {camera[0]: camera for camera in cameras}
    entries = []
    for i, q, t, camera, name in images:
        _, _, w, h, (fx, fy, *_) = by_id[camera]
        pose = camera_to_world(q, t)
        entry = {"id": i, "img_name": name.rsplit(".", 1)[0], "width": w, "height": h, "fx": fx, "fy": fy}
        entries.append(entry | {"position": pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist()})
    return entries


def write_json(path: Path, document) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))
    return path
