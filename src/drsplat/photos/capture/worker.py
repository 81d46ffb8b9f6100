"""Worker that runs COLMAP's package: a task as JSON on stdin, lines of JSON on stdout.

The program never imports it: pycolmap brings a zlib whose functions Pillow would call in the same process,
which ends it. A crash of COLMAP ends this process and no other.

A line is {"done": N} as a task goes on, and at its end {"answer": ...} or {"error": text}.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any, TextIO

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


def add_cameras(request: dict[str, Any], _: TextIO) -> list[int]:
    """Write the cameras of a new database; return their ids, in order."""
    with _database(request) as database:
        return [database.write_camera(pycolmap.Camera(**camera)) for camera in request["cameras"]]


def extract(request: dict[str, Any], line: TextIO) -> None:
    """Find SIFT features of the photos of each group, which share a camera; photos with features are skipped."""
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size, options.num_threads = request["max_side"], request["threads"]
    options.sift.max_num_features = MAX_FEATURES
    done = 0
    for group in request["groups"]:
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = group["camera_id"]
        if group["masks"]:  # where COLMAP wants one for every photo
            reader.mask_path = group["masks"]
        for at in range(0, len(group["names"]), BATCH_PHOTOS):
            names = group["names"][at : at + BATCH_PHOTOS]
            pycolmap.extract_features(
                request["database"], request["images"], image_names=names, camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader, extraction_options=options, device=pycolmap.Device.cpu,
            )  # fmt: skip
            done += len(names)
            _say(line, done=done)


def match(request: dict[str, Any], line: TextIO) -> None:
    """Match and verify pairs of photos, from a file with a pair of names in each line; known pairs are skipped."""
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.num_threads = request["threads"]
    verification.ransac.random_seed = SEED
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = request["batch"]
    lines = Path(request["pairs"]).read_text(encoding="utf-8").splitlines(keepends=True)
    for at in range(0, len(lines), BATCH_PAIRS):
        Path(request["batch"]).write_text("".join(lines[at : at + BATCH_PAIRS]), encoding="utf-8")
        pycolmap.match_image_pairs(
            request["database"], matching_options=matching, pairing_options=pairing,
            verification_options=verification, device=pycolmap.Device.cpu,
        )  # fmt: skip
        _say(line, done=min(at + BATCH_PAIRS, len(lines)))


def map_globally(request: dict[str, Any], _: TextIO) -> list[dict[str, Any]]:
    """Pose all photos at once (GLOMAP); return the models, written as folders below `output`."""
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed = request["threads"], SEED
    options.min_model_size, options.image_names = MIN_PHOTOS, request["names"]
    models = pycolmap.global_mapping(request["database"], request["images"], request["output"], options)
    return _described(models, request["output"])


def map_incrementally(request: dict[str, Any], line: TextIO) -> list[dict[str, Any]]:
    """Pose one photo after another; return the models as `map_globally`."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = request["threads"], SEED
    options.min_model_size, options.image_names = MIN_PHOTOS, request["names"]
    posed = 0

    def count() -> None:
        nonlocal posed
        posed += 1
        _say(line, done=posed)

    models = pycolmap.incremental_mapping(
        request["database"], request["images"], request["output"], options, next_image_callback=count
    )
    return _described(models, request["output"])


def undistort(request: dict[str, Any], _: TextIO) -> None:
    """Write a model's photos and cameras as pinholes, without black borders: `output`/images and /sparse."""
    pycolmap.undistort_images(
        request["output"], request["model"], request["images"], jpeg_quality=JPEG_QUALITY,
        num_threads=request["threads"],
    )  # fmt: skip


def undistort_masks(request: dict[str, Any], _: TextIO) -> None:
    """Write the masks of a model's photos as pinhole masks, as `undistort` does with photos; to `output`."""
    model = pycolmap.Reconstruction(request["model"])
    for image in model.images.values():
        mask = Path(request["masks"], image.name + MASK_SUFFIX)
        picture = pycolmap.Bitmap.read(str(mask), as_rgb=False) if image.has_pose and mask.is_file() else None
        if picture is None:
            continue
        warped = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), picture, model.cameras[image.camera_id])[0]
        white = np.where(warped.to_array() >= MIN_WHITE, np.uint8(255), np.uint8(0))
        pycolmap.Bitmap.from_array(white).write(str(Path(request["output"], mask.name)))


def place(request: dict[str, Any], _: TextIO) -> None:
    """Write a model after a similarity of its world (scale, rotation by rows, translation), with photos renamed."""
    model = pycolmap.Reconstruction(request["model"])
    for image in model.images.values():
        image.name = request["names"].get(image.name, image.name)
    rows = [
        [request["scale"] * part for part in row] + [shift]
        for row, shift in zip(request["rotation"], request["translation"], strict=True)
    ]
    model.transform(pycolmap.Sim3d(rows))
    Path(request["output"]).mkdir(parents=True, exist_ok=True)
    model.write_binary(request["output"])


def look(request: dict[str, Any], _: TextIO) -> list[dict[str, Any]]:
    """Return the ray and the points near each place; a place is a photo's name and a pixel."""
    model = pycolmap.Reconstruction(request["model"])
    images = {image.name: image for image in model.images.values()}
    return [_looked(model, images[name], pixel) for name, pixel in request["places"]]


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
            "names": sorted(model.images[key].name for key in model.reg_image_ids()),
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
    while True:
        weak = [
            image.frame_id
            for image in model.images.values()
            if image.has_pose and sum(point.has_point3D() for point in image.points2D) < MIN_POINTS
        ]
        if not weak:
            return dropped
        dropped = True
        for frame in weak:
            model.deregister_frame(frame)


def _typical_depth(model: pycolmap.Reconstruction) -> float:
    """Return the median distance, along the camera's axis, of points from the first photo that saw them."""
    depths = []
    for point in list(model.points3D.values())[:: max(1, model.num_points3D() // DEPTH_SAMPLE_POINTS)]:
        seen_by = model.images[point.track.elements[0].image_id]
        depths.append(float((seen_by.cam_from_world() * point.xyz)[2]))
    return sorted(depths)[len(depths) // 2] if depths else 0.0


def _database(request: dict[str, Any]) -> Any:
    return pycolmap.Database.open(request["database"])


def _say(line: TextIO, **message: Any) -> None:
    print(json.dumps(message), file=line, flush=True)


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
    try:
        _say(line, answer=TASKS[request["task"]](request, line))
    except Exception as error:  # any error of COLMAP is reported in one line
        _say(line, error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
