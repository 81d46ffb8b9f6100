"""COLMAP, by its own package pycolmap, as a program of its own: a request in JSON on stdin, an answer on stdout.

Not imported by tests: pycolmap brings a zlib whose functions Pillow would call in the same process, which ends it.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap


def write(request: dict[str, Any]) -> list[dict[str, Any]]:
    """Write a model, and return it as COLMAP itself understands it; see `described`."""
    model = pycolmap.Reconstruction()
    for camera in request["cameras"]:
        model.add_camera_with_trivial_rig(pycolmap.Camera(**camera))
    for image in request["images"]:
        w, x, y, z = image["quaternion"]
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, w])), np.array(image["translation"]))
        record = pycolmap.Image(name=image["name"], camera_id=image["camera_id"], image_id=image["image_id"])
        record.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array(xy)) for xy in image["observations"]])
        model.add_image_with_trivial_frame(record, pose)
    for xyz, rgb in request["points"]:
        model.add_point3D(np.array(xyz), pycolmap.Track(), np.array(rgb, np.uint8))
    folder = Path(request["folder"])
    folder.mkdir(parents=True)
    (model.write_binary if request["kind"] == "binary" else model.write_text)(folder)
    return described(model, request["probes"])


def read(request: dict[str, Any]) -> list[dict[str, Any]]:
    return described(pycolmap.Reconstruction(request["folder"]), request["probes"])


def described(model: pycolmap.Reconstruction, probes: list[list[float]]) -> list[dict[str, Any]]:
    """Return name, pose and intrinsics of each image, and where on its photo the probes (world) are seen."""
    images = []
    for image in model.images.values():
        pose, camera = image.cam_from_world(), model.cameras[image.camera_id]
        seen = camera.img_from_cam(np.array([pose * np.array(probe) for probe in probes]))
        images.append(
            {
                "name": image.name,
                "cam_from_world": pose.matrix().tolist(),
                "size": [camera.width, camera.height],
                "K": camera.calibration_matrix().tolist(),
                "seen": seen.tolist(),
                "rays": camera.cam_from_img(seen).tolist(),
                "points": len(model.points3D),
            }
        )
    return images


def undistort(request: dict[str, Any]) -> None:
    """Undistort a capture's photos; `same_raster` keeps their size and focal lengths."""
    options = pycolmap.UndistortCameraOptions()
    if request["same_raster"]:
        options.min_scale = options.max_scale = 1.0
    pycolmap.undistort_images(
        request["output"], request["model"], request["images"], undistort_options=options, num_threads=1
    )


def lenses(_: object) -> list[str]:
    """Return the names of all camera models that COLMAP knows, by their number."""
    members = pycolmap.CameraModelId.__members__.items()
    return [name for name, member in sorted(members, key=lambda item: int(item[1])) if int(member) >= 0]


if __name__ == "__main__":
    answer = {"write": write, "read": read, "undistort": undistort, "lenses": lenses}[sys.argv[1]](json.load(sys.stdin))
    json.dump(answer, sys.stdout)
