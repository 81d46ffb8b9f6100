"""Worker that runs COLMAP's package: a task as JSON on stdin, lines of JSON on stdout.

The program never imports it: pycolmap brings a zlib whose functions Pillow would call in the same process,
which ends it. A crash of COLMAP ends this process and no other.

A line is {"done": N} as a task goes on, and at its end {"answer": ...} or {"error": text}.
"""

import json
import os
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ...base.system import end_with

SEED = 0
BATCH_PHOTOS, BATCH_PAIRS = 8, 64
MAX_FEATURES = 4096
JPEG_QUALITY = 95
MASK_SUFFIX = ".png"
MIN_WHITE = 128
MIN_PHOTOS = 3  # of a model
MIN_POINTS = 15  # that a photo has to see
DEPTH_SAMPLE_POINTS = 2000  # for the median depth
GLOG_ERROR_LEVEL = 2

Say = Callable[..., None]
"""Function that writes a line of JSON."""


def add_cameras(say: Say, database: str, cameras: list[dict[str, Any]], **_: Any) -> list[int]:
    """Write the cameras of a new database; return their ids, in order."""
    with pycolmap.Database.open(database) as opened:
        return [opened.write_camera(pycolmap.Camera(**camera)) for camera in cameras]


def extract(
    say: Say, database: str, images: str, groups: list[dict[str, Any]], max_side: int, threads: int, **_: Any
) -> None:
    """Find SIFT features of the photos of each group, which share a camera; photos with features are skipped."""
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size, options.num_threads = max_side, threads
    options.sift.max_num_features = MAX_FEATURES
    done = 0
    for group in groups:
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = group["camera_id"]
        if group["masks"]:  # where COLMAP wants one for every photo
            reader.mask_path = group["masks"]
        for at in range(0, len(group["names"]), BATCH_PHOTOS):
            names = group["names"][at : at + BATCH_PHOTOS]
            pycolmap.extract_features(
                database, images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader, extraction_options=options, device=pycolmap.Device.cpu,
            )  # fmt: skip
            done += len(names)
            say(done=done)


def match(say: Say, database: str, pairs: list[list[str]], batch: str, threads: int, **_: Any) -> None:
    """Match and verify pairs of photos; known pairs are skipped. batch: file for the names of some at a time."""
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.num_threads, verification.ransac.random_seed = threads, SEED
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = batch
    for at in range(0, len(pairs), BATCH_PAIRS):
        some = pairs[at : at + BATCH_PAIRS]
        Path(batch).write_text("".join(f"{first} {second}\n" for first, second in some), encoding="utf-8")
        pycolmap.match_image_pairs(
            database, matching_options=matching, pairing_options=pairing,
            verification_options=verification, device=pycolmap.Device.cpu,
        )  # fmt: skip
        say(done=at + len(some))


def map_globally(say: Say, database: str, images: str, output: str, **more: Any) -> list[dict[str, Any]]:
    """Pose all photos at once (GLOMAP); return the models, written as folders below `output`."""
    options = _set(pycolmap.GlobalPipelineOptions(), **more)
    return _described(pycolmap.global_mapping(database, images, output, options), output)


def map_incrementally(say: Say, database: str, images: str, output: str, **more: Any) -> list[dict[str, Any]]:
    """Pose one photo after another; return the models as `map_globally`."""
    options, posed = _set(pycolmap.IncrementalPipelineOptions(), **more), count(1)
    models = pycolmap.incremental_mapping(
        database, images, output, options, next_image_callback=lambda: say(done=next(posed))
    )
    return _described(models, output)


def _set(options: Any, threads: int, names: list[str]) -> Any:
    options.num_threads, options.random_seed = threads, SEED
    options.min_model_size, options.image_names = MIN_PHOTOS, names
    return options


def undistort(say: Say, output: str, model: str, images: str, threads: int) -> None:
    """Write a model's photos and cameras as pinholes, without black borders: `output`/images and /sparse."""
    pycolmap.undistort_images(output, model, images, jpeg_quality=JPEG_QUALITY, num_threads=threads)


def undistort_masks(say: Say, output: str, model: str, masks: str) -> None:
    """Write the masks of a model's photos as pinhole masks, as `undistort` does with photos; to `output`."""
    posed = pycolmap.Reconstruction(model)
    for image in posed.images.values():
        mask = Path(masks, image.name + MASK_SUFFIX)
        picture = pycolmap.Bitmap.read(str(mask), as_rgb=False) if image.has_pose and mask.is_file() else None
        if picture is None:
            continue
        warped = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), picture, posed.cameras[image.camera_id])[0]
        white = np.where(warped.to_array() >= MIN_WHITE, np.uint8(255), np.uint8(0))
        pycolmap.Bitmap.from_array(white).write(str(Path(output, mask.name)))


def place(
    say: Say,
    output: str,
    model: str,
    scale: float,
    rotation: Any = ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    translation: Any = (0, 0, 0),
    names: dict[str, str] | None = None,
) -> None:
    """Write a model after a similarity of its world (scale, rotation by rows, translation), with photos renamed."""
    moved = pycolmap.Reconstruction(model)
    for image in moved.images.values():
        image.name = (names or {}).get(image.name, image.name)
    moved.transform(pycolmap.Sim3d(np.column_stack([scale * np.array(rotation), translation])))
    Path(output).mkdir(parents=True, exist_ok=True)
    moved.write_binary(output)


def look(say: Say, model: str, places: list[tuple[str, list[float]]]) -> list[dict[str, Any]]:
    """Return the ray and the points near each place; a place is a photo's name and a pixel."""
    posed = pycolmap.Reconstruction(model)
    images = {image.name: image for image in posed.images.values()}
    return [_looked(posed, images[name], pixel) for name, pixel in places]


def _looked(model: pycolmap.Reconstruction, image: pycolmap.Image, pixel: list[float]) -> dict[str, Any]:
    """Return where a photo was taken, the ray of a pixel (of depth 1), and the pixels and depths of its points."""
    camera, pose = model.cameras[image.camera_id], image.cam_from_world()
    seen = [point for point in image.points2D if point.has_point3D()]
    slopes = camera.cam_from_img(pixel)
    if slopes is None:
        raise ValueError(f"no ray of the lens leads to the pixel {pixel}")
    return {
        "size": [camera.width, camera.height],
        "center": image.projection_center().tolist(),
        "ray": (pose.rotation.inverse() * [*slopes, 1.0]).tolist(),
        "pixels": [point.xy.tolist() for point in seen],
        "depths": [float((pose * model.points3D[point.point3D_id].xyz)[2]) for point in seen],
    }


def _described(models: dict[int, pycolmap.Reconstruction], output: str) -> list[dict[str, Any]]:
    for index, model in models.items():
        if _drop_unsupported(model):
            model.write_binary(str(Path(output, str(index))))
    return [
        {
            "folder": str(index),
            "files": sorted(model.images[key].name for key in model.reg_image_ids()),
            "num_points": model.num_points3D(),
            "error_px": model.compute_mean_reprojection_error(),
            "depth": _typical_depth(model),
        }
        for index, model in models.items()
        if model.num_reg_images() >= MIN_PHOTOS
    ]


def _drop_unsupported(model: pycolmap.Reconstruction) -> bool:
    """Remove the poses of photos that see too few points; return whether there were some.

    Global mapping can pose a photo by its relations to others alone: without points such a pose is arbitrary.
    """
    dropped = False
    while weak := [
        image.frame_id
        for image in model.images.values()
        if image.has_pose and sum(point.has_point3D() for point in image.points2D) < MIN_POINTS
    ]:
        dropped = True
        for frame in weak:
            model.deregister_frame(frame)
    return dropped


def _typical_depth(model: pycolmap.Reconstruction) -> float:
    """Return the median distance, along the camera's axis, of points from the first photo that saw them."""
    depths = []
    for point in list(model.points3D.values())[:: max(1, model.num_points3D() // DEPTH_SAMPLE_POINTS)]:
        seen_by = model.images[point.track.elements[0].image_id]
        depths.append(float((seen_by.cam_from_world() * point.xyz)[2]))
    return sorted(depths)[len(depths) // 2] if depths else 0.0


TASKS = {
    task.__name__: task
    for task in (add_cameras, extract, match, map_globally, map_incrementally, undistort, undistort_masks, place, look)
}


def main() -> None:
    """Run the task that stdin names; what COLMAP itself prints to stdout goes to stderr."""
    line = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    request = json.load(sys.stdin)
    end_with(request["parent"])
    pycolmap.logging.minloglevel = GLOG_ERROR_LEVEL
    pycolmap.set_random_seed(SEED)
    task: Any = TASKS[request["task"]]
    arguments = {name: value for name, value in request.items() if name not in ("task", "parent")}

    def say(**message: Any) -> None:
        print(json.dumps(message), file=line, flush=True)

    try:
        say(answer=task(say, **arguments))
    except Exception as error:  # any error of COLMAP is reported in one line
        say(error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
