"""COLMAP models between COLMAP's own package and ours: what it writes, what it reads, and what it undistorts."""

import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

import drsplat.evaluation.demo
from drsplat.errors import FormatError
from drsplat.formats.captures import read_views
from drsplat.formats.colmap import read_colmap, read_points
from drsplat.formats.colmap_binary import MODEL_NAMES, PARAMETERS
from drsplat.scene.lens import distort_points, undistort_points
from drsplat.scene.photos import load_image, photo_coverage
from drsplat.scene.views import View
from places import SUPPORT
from written_captures import write_colmap_binary, write_colmap_text

pytestmark = [
    pytest.mark.oracle,
    pytest.mark.skipif(find_spec("pycolmap") is None, reason="pycolmap is not installed: pip install pycolmap"),
]
PROGRAM = SUPPORT / "colmap_program.py"
WIDTH, HEIGHT = 160, 120
LENSES = {
    "SIMPLE_PINHOLE": [150, 80, 60],
    "PINHOLE": [150, 155, 80.5, 59.25],
    "SIMPLE_RADIAL": [150, 80, 60, 0.03],
    "RADIAL": [150, 80, 60, 0.08, -0.02],
    "OPENCV": [150, 155, 80, 60, 0.08, -0.03, 0.002, -0.003],
}
NAMES = ["a.png", "two  spaces.png", "sub folder/Über ñ 写真.png", "sub folder/deeper/b.JPG", "#1.png"]
PROBES = np.random.default_rng(3).uniform(-1, 1, (40, 3))  # world positions, before every camera below
POINTS = [([0.5, -0.25, 1.5], [255, 0, 7]), ([1e-9, 2.0, -3.1], [10, 20, 30])]


def colmap(verb: str, **request: Any) -> Any:
    """Ask COLMAP in a process of its own."""
    finished = subprocess.run(
        [sys.executable, str(PROGRAM), verb], input=json.dumps(request), capture_output=True, text=True, timeout=300
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


def request_for(lenses: dict[str, list[float]], names: list[str]) -> dict[str, Any]:
    """Describe a model with a camera for each lens; images take them in turn."""
    rng = np.random.default_rng(0)
    cameras = [
        {"camera_id": 3 + 2 * k, "model": model, "width": WIDTH, "height": HEIGHT, "params": parameters}
        for k, (model, parameters) in enumerate(lenses.items())
    ]
    images = [
        {
            "image_id": 9 - k,
            "name": name,
            "camera_id": cameras[k % len(cameras)]["camera_id"],
            "quaternion": (rng.normal(size=4) / 4 + [1, 0, 0, 0]).tolist(),
            "translation": [0.3 * k, -0.1, 5],
            "observations": [[1.5, 2.5], [3.0, 4.25]] if k % 2 else [],
        }
        for k, name in enumerate(names)
    ]
    for image in images:
        image["quaternion"] = (np.array(image["quaternion"]) / np.linalg.norm(image["quaternion"])).tolist()
    return {"cameras": cameras, "images": images, "points": POINTS, "probes": PROBES.tolist()}


def write_photos(folder: Path, names: list[str]) -> None:
    """Write smooth pictures, of which bilinear interpolation is well-behaved."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for k, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = [127 + 100 * np.sin(x / (9 + channel) + k) * np.cos(y / 11) for channel in range(3)]
        Image.fromarray(np.stack(pixels, -1).astype(np.uint8)).save(path)


def assert_same_views(views: list[View], theirs: list[dict[str, Any]]) -> None:
    """Compare by name: size, intrinsics, pose, and where on the photo the probes are seen, through the lens."""
    by_name = {image["name"]: image for image in theirs}
    assert sorted(view.name for view in views) == sorted(by_name)
    for view in views:
        image = by_name[view.name]
        assert [view.width, view.height] == image["size"]
        assert_allclose(view.K, image["K"], rtol=0, atol=1e-12)
        assert_allclose(view.cam_from_world[:3], image["cam_from_world"], rtol=0, atol=1e-12)
        camera = PROBES @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
        pinhole = (camera / camera[:, 2:]) @ view.K[:2].T
        assert_allclose(distort_points(view, pinhole), image["seen"], rtol=0, atol=1e-9)
        rays = (undistort_points(view, np.array(image["seen"])) - view.K[:2, 2]) / view.K[[0, 1], [0, 1]]
        assert_allclose(rays, image["rays"], rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_models_that_colmap_writes_are_read(kind, tmp_path):
    """All lenses that we read, names with spaces and letters of other scripts, sub-folders, observations, points."""
    request = request_for(LENSES, NAMES)
    theirs = colmap("write", folder=str(tmp_path / "sparse/0"), kind=kind, **request)
    write_photos(tmp_path / "images", NAMES)
    views = read_views(tmp_path)
    assert_same_views(views, theirs)
    assert all(view.image_path == tmp_path / "images" / view.name for view in views)
    positions, colors = read_points(tmp_path)
    order = np.argsort(positions[:, 0])[::-1]
    assert_allclose(positions[order], [xyz for xyz, _ in POINTS], rtol=1e-12)
    assert colors[order].tolist() == [rgb for _, rgb in POINTS]


@pytest.mark.parametrize("kind", ["demo", "text", "binary"])
def test_colmap_reads_what_we_write(kind, tmp_path):
    """The model of the demo, and those that the tests write after COLMAP's description, so that these are right."""
    folder = tmp_path / "model"
    if kind == "demo":
        folder = Path(drsplat.evaluation.demo.__file__).parent / "scene/sparse/0"
    else:
        cameras = [(k, name, WIDTH, HEIGHT, tuple(map(float, LENSES[name]))) for k, name in enumerate(LENSES, 1)]
        images = [
            (k, (0.5, -0.5, 0.5, 0.5), (0.1, -0.2, 5.0), k, f"sub/photo_{k}.png") for k in range(1, len(cameras) + 1)
        ]
        points = [(9, (0.5, -0.25, 1.5), (255, 0, 7))]
        (write_colmap_text if kind == "text" else write_colmap_binary)(folder, cameras, images, points)
    views = read_colmap(folder)
    assert len(views) >= 4
    assert_same_views(views, colmap("read", folder=str(folder), probes=PROBES.tolist()))


def test_the_list_of_lenses_is_that_of_colmap():
    """By number, as binary models name them; a later COLMAP may have more."""
    theirs = colmap("lenses")
    assert theirs[: len(MODEL_NAMES)] == list(MODEL_NAMES)
    assert set(LENSES) == set(PARAMETERS) < set(theirs)


def test_photos_are_undistorted_as_by_colmap(tmp_path):
    """To a grey level, with size and focal lengths kept and black beyond the photo.

    The photo's outermost half pixel is black too for COLMAP, which wants four neighbours; ours repeats the border.
    """
    lenses = {name: parameters for name, parameters in LENSES.items() if len(parameters) > 3 and name != "PINHOLE"}
    names = [f"{name}.png" for name in lenses]
    colmap("write", folder=str(tmp_path / "sparse/0"), kind="binary", **request_for(lenses, names))
    write_photos(tmp_path / "images", names)
    folders = {"model": tmp_path / "sparse/0", "images": tmp_path / "images", "output": tmp_path / "undistorted"}
    colmap("undistort", same_raster=True, **{name: str(folder) for name, folder in folders.items()})
    for view, plain in zip(read_views(tmp_path), read_views(tmp_path / "undistorted"), strict=True):
        assert view.distortion is not None
        assert plain.distortion is None
        assert_allclose(plain.K, view.K, atol=1e-12)
        ours, theirs = (load_image(v).astype(int) for v in (view, plain))
        shown, inner = photo_coverage(view), within_photo(view, 0.5)
        assert 0.9 < inner.mean() < shown.mean() < 1
        assert np.abs(ours - theirs)[inner].max() <= 1
        assert not ours[~shown].any()
        assert not theirs[~within_photo(view, 0.499)].any()


def within_photo(view: View, margin: float) -> np.ndarray:
    """Return which pixels of the pinhole lie on the photo, and so far from its border."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    low, high = margin, np.array([view.width, view.height]) - margin
    at = distort_points(view, np.stack([x, y], -1))
    return np.asarray(((at >= low) & (at <= high)).all(-1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("FULL_OPENCV", [150, 155, 80, 60, 0.08, -0.03, 0.002, -0.003, 0.01, 0, 0, 0]),
        ("OPENCV_FISHEYE", [150, 155, 80, 60, 0.03, -0.01, 0.001, 0.002]),
        ("SIMPLE_RADIAL_FISHEYE", [150, 80, 60, 0.01]),
        ("FOV", [150, 150, 80, 60, 0.5]),
    ],
)
def test_the_cure_for_other_lenses_works(model, parameters, tmp_path):
    """They are refused with `colmap image_undistorter`, whose output is a capture with the same poses."""
    request = request_for({model: parameters}, NAMES[:3])
    theirs = colmap("write", folder=str(tmp_path / "sparse/0"), kind="binary", **request)
    write_photos(tmp_path / "images", NAMES[:3])
    with pytest.raises(FormatError, match=rf"camera model '{re.escape(model)}' is not supported.*image_undistorter"):
        read_views(tmp_path)
    folders = {"model": tmp_path / "sparse/0", "images": tmp_path / "images", "output": tmp_path / "undistorted"}
    colmap("undistort", same_raster=False, **{name: str(folder) for name, folder in folders.items()})
    views = {view.name: view for view in read_views(tmp_path / "undistorted")}
    assert sorted(views) == sorted(NAMES[:3])
    for image in theirs:
        view = views[image["name"]]
        assert_allclose(view.cam_from_world[:3], image["cam_from_world"], rtol=0, atol=1e-12)
        assert load_image(view).shape == (view.height, view.width, 3)
