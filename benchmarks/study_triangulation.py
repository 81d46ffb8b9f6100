"""Points for known poses: our triangulation, COLMAP's and random ones, as starts of training.

    python benchmarks/study_triangulation.py CAPTURE... [--resolution 168] [--iterations 2000] [--seed 0] [--threads 1]
                                             [--starts ours colmap random]

ours      triangulation/, from the photos to train on
colmap    SIFT features of photos of up to 1,200 pixels, matches of the same pairs, pycolmap.triangulate_points with the
          poses as they are (pip install "drsplat[capture]")
random    20,000 points where three cameras look

Points that captures have are not read. Photos are given to COLMAP with their lens undone. Settings are the defaults;
every eighth photo is held out, and no start sees it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bench_starts import start as random_start
from machine import describe
from PIL import Image
from scipy.spatial.transform import Rotation

import drsplat as ds
from drsplat.formats.captures import SparsePoints
from drsplat.training.start import split_views
from drsplat.training.triangulation import triangulate
from drsplat.training.triangulation.structure import neighbours

OURS, COLMAP, RANDOM = "ours", "colmap", "random"
MAX_SIDE, MAX_FEATURES = 1200, 4096  # as drsplat capture
WORKER = "--colmap-worker"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--resolution", type=int, default=168, help="longer side to train at, in pixels")
    parser.add_argument("--iterations", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--starts", nargs="*", choices=(OURS, COLMAP, RANDOM), default=[OURS, COLMAP, RANDOM])
    arguments = parser.parse_args()
    print(describe())
    print("capture          start      points  found in s  PSNR held out    SSIM  Gaussians")
    for capture in arguments.captures:
        views = ds.read_views(capture)
        train = split_views(views, ds.TrainingSettings().test_every).train
        small = [view.limited(arguments.resolution) for view in views]
        for name in arguments.starts:
            begin = time.perf_counter()
            points = start_points(name, capture, train, arguments.threads)
            seconds = time.perf_counter() - begin
            settings = ds.TrainingSettings(iterations=arguments.iterations, seed=arguments.seed)
            training = ds.train(small, settings, points=points, device="cpu", threads=arguments.threads)
            scores = training.evaluation
            print(
                f"{Path(capture).name:16} {name:8} {len(points.positions):8,} {seconds:11.1f} {scores.psnr:14.2f} "
                f"{scores.ssim:7.3f} {len(training.gaussians):10,}",
                flush=True,
            )


def start_points(name: str, capture: str, train: Sequence[ds.View], threads: int) -> SparsePoints:
    if name == COLMAP:
        return colmap_points(train, threads)
    if name == RANDOM:
        return random_start("seen", capture, train)
    found = triangulate(train, threads=threads)
    return SparsePoints(found.positions, found.colors)


def colmap_points(views: Sequence[ds.View], threads: int) -> SparsePoints:
    """Write photos without their lens, let COLMAP work in a process of its own, and read its points."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "photos").mkdir()
        cameras = []
        for index, view in enumerate(view.limited(MAX_SIDE) for view in views):
            Image.fromarray(ds.load_image(view)).save(folder / "photos" / f"{index:05}.png", compress_level=1)
            params = [view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]]
            quaternion = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat(scalar_first=True).tolist()
            cameras.append([view.width, view.height, params, quaternion, view.cam_from_world[:3, 3].tolist()])
        pairs = [[int(one), int(other)] for one, other in neighbours(views)]
        (folder / "asked.json").write_text(json.dumps({"cameras": cameras, "pairs": pairs, "threads": threads}))
        subprocess.run([sys.executable, __file__, WORKER, name], check=True, capture_output=True)
        with np.load(folder / "points.npz") as found:
            return SparsePoints(found["positions"], found["colors"])


def work(folder: Path) -> None:
    """Triangulate with COLMAP; in a process without Pillow's decoders, whose zlib is another."""
    import pycolmap

    asked = json.loads((folder / "asked.json").read_text())
    pycolmap.set_random_seed(0)
    database, photos = folder / "database.db", folder / "photos"
    names = [f"{index:05}.png" for index in range(len(asked["cameras"]))]
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.sift.max_num_features = asked["threads"], MAX_FEATURES
    with pycolmap.Database.open(str(database)) as opened:
        ids = [
            opened.write_camera(pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params))
            for width, height, params, _, _ in asked["cameras"]
        ]
    for camera_id, name in zip(ids, names, strict=True):
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = camera_id
        pycolmap.extract_features(
            str(database), str(photos), image_names=[name], camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader, extraction_options=options, device=pycolmap.Device.cpu,
        )  # fmt: skip
    (folder / "pairs.txt").write_text("".join(f"{names[one]} {names[other]}\n" for one, other in asked["pairs"]))
    pairing, matching = pycolmap.ImportedPairingOptions(), pycolmap.FeatureMatchingOptions()
    pairing.match_list_path, matching.num_threads = str(folder / "pairs.txt"), asked["threads"]
    pycolmap.match_image_pairs(
        str(database), matching_options=matching, pairing_options=pairing, device=pycolmap.Device.cpu
    )
    with pycolmap.Database.open(str(database)) as opened:
        image_ids = {image.name: image.image_id for image in opened.read_all_images()}
    write_poses(folder / "poses", asked["cameras"], ids, [image_ids[name] for name in names], names)
    (folder / "out").mkdir()
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.num_threads = asked["threads"]
    mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = False
    model = pycolmap.triangulate_points(
        pycolmap.Reconstruction(str(folder / "poses")), str(database), str(photos), str(folder / "out"),
        options=mapping,
    )  # fmt: skip
    points = list(model.points3D.values())
    np.savez(
        folder / "points.npz",
        positions=np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        colors=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
    )


def write_poses(
    folder: Path, cameras: Sequence[list], camera_ids: Sequence[int], image_ids: Sequence[int], names: Sequence[str]
) -> None:
    """Write a model without points in COLMAP's text format."""
    folder.mkdir()
    lines, posed = [], []
    for (width, height, params, quaternion, shift), camera, image, name in zip(
        cameras, camera_ids, image_ids, names, strict=True
    ):
        lines.append(f"{camera} PINHOLE {width} {height} {' '.join(map(repr, params))}\n")
        posed.append(f"{image} {' '.join(map(repr, [*quaternion, *shift]))} {camera} {name}\n\n")
    (folder / "cameras.txt").write_text("".join(lines))
    (folder / "images.txt").write_text("".join(posed))
    (folder / "points3D.txt").write_text("")


if __name__ == "__main__":
    if sys.argv[1:2] == [WORKER]:
        work(Path(sys.argv[2]))
    else:
        main()
