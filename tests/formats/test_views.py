"""Readers of posed photos: COLMAP, transforms.json, cameras.json."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.formats.captures import read_sparse_points, read_views
from drsplat.formats.colmap import read_points
from drsplat.formats.ply import write_vertices
from drsplat.formats.poses import read_cameras_json, write_cameras_json
from drsplat.scene.views import View
from refusing import malformed, refused
from written_captures import (
    CAMERAS,
    IMAGES,
    POINTS,
    camera_to_world,
    cameras_json_document,
    transforms_document,
    write_colmap_binary,
    write_colmap_text,
    write_json,
    write_photo,
    write_photos,
)

PLUSH = Path(__file__).resolve().parents[3] / "shared" / "data" / "plush"
needs_plush = pytest.mark.skipif(not PLUSH.is_dir(), reason="the shared plush capture is absent")
NAMES = ["a photo.png", "b.png", "cam0/c.png"]


@pytest.fixture
def capture(tmp_path) -> Path:
    """A COLMAP binary model with all its photos."""
    write_colmap_binary(tmp_path / "sparse/0")
    write_photos(tmp_path / "images")
    return tmp_path


def same(a: View, b: View, atol: float = 1e-12) -> None:
    assert (a.name, a.width, a.height) == (b.name, b.width, b.height)
    assert_allclose(a.K, b.K, rtol=0, atol=atol)
    assert_allclose(a.cam_from_world, b.cam_from_world, rtol=0, atol=atol)
    assert_allclose(a.distortion or (0,) * 4, b.distortion or (0,) * 4, rtol=0, atol=0)


def project(view: View, points: np.ndarray) -> np.ndarray:
    camera = points @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    pixels = camera @ view.K.T
    return np.column_stack([pixels[:, :2] / pixels[:, 2:], camera[:, 2]])


# COLMAP


def test_colmap_numbers(capture):
    a, _, c = read_views(capture)
    assert_array_equal(c.K, [[60, 0, 30.5], [0, 61, 25.25], [0, 0, 1]])
    assert c.distortion == (0.05, -0.01, 0.002, -0.003)
    assert a.distortion is None
    assert (a.width, a.height) == (64, 48)
    assert a.image_path == capture / "images" / "a photo.png"
    _, q, t, *_ = IMAGES[1]
    assert_allclose(np.linalg.inv(a.cam_from_world), camera_to_world(q, t), atol=1e-12)
    assert_allclose(a.center, camera_to_world(q, t)[:3, 3], atol=1e-12)


def test_colmap_text_equals_binary(tmp_path):
    write_colmap_text(tmp_path / "text/sparse/0")
    write_colmap_binary(tmp_path / "binary/sparse/0")
    for kind in ("text", "binary"):
        write_photos(tmp_path / kind / "images")
    for a, b in zip(read_views(tmp_path / "text"), read_views(tmp_path / "binary"), strict=True):
        same(a, b, atol=0)
    for a, b in zip(read_points(tmp_path / "text"), read_points(tmp_path / "binary"), strict=True):
        assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("model", "parameters", "focal", "distortion"),
    [
        ("SIMPLE_PINHOLE", (50.0, 31.0, 23.0), (50, 50), None),
        ("PINHOLE", (50.0, 51.0, 31.0, 23.0), (50, 51), None),
        ("SIMPLE_RADIAL", (50.0, 31.0, 23.0, 0.1), (50, 50), (0.1, 0, 0, 0)),
        ("RADIAL", (50.0, 31.0, 23.0, 0.1, 0.2), (50, 50), (0.1, 0.2, 0, 0)),
        ("OPENCV", (50.0, 51.0, 31.0, 23.0, 0.1, 0.2, 0.3, 0.4), (50, 51), (0.1, 0.2, 0.3, 0.4)),
        ("SIMPLE_RADIAL", (50.0, 31.0, 23.0, 0.0), (50, 50), None),
    ],
)
def test_camera_models(tmp_path, model, parameters, focal, distortion):
    for write in (write_colmap_text, write_colmap_binary):
        write(tmp_path / write.__name__, [(1, model, 64, 48, parameters)], IMAGES[:1])
        write_photos(tmp_path / write.__name__, IMAGES[:1])
        (view,) = read_views(tmp_path / write.__name__)
        assert_array_equal(view.K, [[focal[0], 0, 31], [0, focal[1], 23], [0, 0, 1]])
        assert view.distortion == distortion


@pytest.mark.parametrize(("model", "count"), [("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12)])
@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_other_lenses_are_refused_with_advice(tmp_path, write, model, count):
    write(tmp_path, [(1, model, 64, 48, (50.0,) * count)], IMAGES[:1])
    with malformed(f"{model}.*image_undistorter"):
        read_views(tmp_path)


@pytest.mark.parametrize("folder", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_model_folders(tmp_path, folder):
    write_colmap_binary(tmp_path / folder)
    (tmp_path / folder / "rigs.bin").write_bytes(b"of COLMAP 4")
    (tmp_path / folder / "frames.bin").write_bytes(b"of COLMAP 4")
    write_photos(tmp_path / "images")
    for path in (tmp_path, tmp_path / folder, tmp_path / folder / "images.bin"):
        views = read_views(path)
        assert [view.image_path for view in views] == [tmp_path / "images" / name for name in NAMES]


def test_points(capture):
    positions, colors = read_points(capture)
    assert_array_equal(positions, [x for _, x, _ in POINTS])
    assert_array_equal(colors, [c for *_, c in POINTS])


def test_no_points_is_an_empty_cloud(tmp_path):
    write_colmap_text(tmp_path, points=[])
    positions, colors = read_points(tmp_path)
    assert positions.shape == colors.shape == (0, 3)


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_a_point_that_is_not_finite(tmp_path, write):
    write(tmp_path, points=[*POINTS, (5, (0.0, float("nan"), 1.0), (1, 2, 3))])
    with malformed("not finite, the first at index 2"):
        read_points(tmp_path)


def test_points_are_asked_of_a_capture_without(tmp_path):
    with refused(r"points3D\.bin"):
        read_points(tmp_path)


def test_missing_line_of_2d_points_is_noticed(tmp_path):
    write_colmap_text(tmp_path)
    lines = (tmp_path / "images.txt").read_text().splitlines()
    (tmp_path / "images.txt").write_text("\n".join(line for line in lines if line.endswith(".png")))
    with malformed(r"images\.txt:2.*2D points"):
        read_views(tmp_path)


def test_unknown_camera(tmp_path):
    write_colmap_text(tmp_path, CAMERAS[:1])
    with malformed("camera 7"):
        read_views(tmp_path)


def test_names_that_occur_twice(tmp_path):
    write_colmap_binary(tmp_path, images=[*IMAGES, (9, *IMAGES[0][1:])])
    write_photos(tmp_path)
    with malformed(r"more than once: b\.png"):
        read_views(tmp_path)


# Photos and sizes


def test_missing_photos_of_colmap_are_one_warning(capture):
    (capture / "images/b.png").unlink()
    with pytest.warns(DrSplatWarning, match=r"1 of 3 views have no photo.*b\.png") as caught:
        views = read_views(capture)
    assert len(caught) == 1
    assert [view.image_path is None for view in views] == [False, True, False]


def test_photos_of_another_size_scale_the_camera(capture):
    write_photos(capture / "images_2", width=32, height=24)
    points = default_rng(0).normal(size=(50, 3))
    for full, half in zip(read_views(capture), read_views(capture, images="images_2"), strict=True):
        assert (half.width, half.height) == (32, 24)
        assert half.image_path == capture / "images_2" / half.name
        expected = project(full, points) * (0.5, 0.5, 1)
        assert_allclose(project(half, points), expected, rtol=1e-12)


@pytest.mark.parametrize("size", [(32, 23), (1000, 751), (64, 49)])
def test_rounding_of_sizes_is_no_mismatch(tmp_path, size):
    write_colmap_text(tmp_path, [(1, "PINHOLE", 64, 48, (70.0, 71.0, 32.0, 24.0))], IMAGES[:1])
    write_photo(tmp_path / "b.png", *size)
    (view,) = read_views(tmp_path)
    assert (view.width, view.height) == size
    assert_allclose(view.K[:2, 2], np.array(size) / 2)


@pytest.mark.parametrize("size", [(64, 50), (48, 64), (640, 500)])
def test_photos_of_another_shape(tmp_path, size):
    write_colmap_text(tmp_path, CAMERAS[:1], IMAGES[:1])
    write_photo(tmp_path / "b.png", *size)
    with pytest.raises(MismatchError, match=f"{size[0]}x{size[1]}.*64x48"):
        read_views(tmp_path)


def test_max_side(capture):
    points = default_rng(0).normal(size=(50, 3))
    for full, small in zip(read_views(capture), read_views(capture, max_side=16), strict=True):
        assert (small.width, small.height) == (16, 12)
        assert_allclose(project(small, points), project(full, points) * (0.25, 0.25, 1))
        assert small.distortion == full.distortion
    assert read_views(capture, max_side=64)[0].width == 64
    with refused("max_side"):
        read_views(capture, max_side=0)


def test_image_folder_that_is_none(capture):
    with refused("images_8"):
        read_views(capture, images="images_8")


def test_a_photo_that_is_none(capture):
    (capture / "images/b.png").write_bytes(b"not a photo")
    with malformed(r"b\.png"):
        read_views(capture)


# transforms.json


def test_transforms_equal_colmap(capture):
    path = write_json(capture / "transforms.json", transforms_document())
    for a, b in zip(read_views(capture / "sparse/0"), read_views(path), strict=True):
        same(a, b)
        assert a.image_path == b.image_path


def test_transforms_look_down_minus_z(tmp_path):
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
    write_json(tmp_path / "transforms.json", {"fl_x": 64, "w": 64, "h": 48, "frames": [frame]})
    write_photo(tmp_path / "a.png")
    (view,) = read_views(tmp_path)
    ahead, right_up = project(view, np.array([[0, 0, -2.0], [1, 0.5, -2.0]]))
    assert_allclose(ahead, [32, 24, 2])
    assert_allclose(right_up, [64, 8, 2])


def test_intrinsics_of_the_file_and_of_a_frame(tmp_path):
    document = transforms_document(CAMERAS[:1], IMAGES[:2], "")
    shared = {key: document["frames"][0].pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    document["frames"][1] |= {"fl_x": 90.0, "fl_y": 91.0}
    write_json(tmp_path / "transforms.json", shared | document)
    write_photos(tmp_path, IMAGES[:2])
    a, b = read_views(tmp_path)
    assert (a.K[0, 0], a.K[1, 1]) == (90, 91)
    assert (b.K[0, 0], b.K[1, 1]) == (70, 71)


def test_field_of_view_without_size_or_suffix(tmp_path):
    frame = {"file_path": "./train/r_0", "transform_matrix": np.eye(4).tolist()}
    write_json(tmp_path / "transforms.json", {"camera_angle_x": 1.2, "frames": [frame]})
    write_photo(tmp_path / "train/r_0.png", 80, 60)
    (view,) = read_views(tmp_path)
    assert view.name == "train/r_0.png"
    assert (view.width, view.height) == (80, 60)
    assert_allclose(view.K[:2, 2], [40, 30])
    assert_allclose(2 * np.arctan(40 / view.K[0, 0]), 1.2)
    assert view.K[0, 0] == view.K[1, 1]


def test_absolute_photo_paths_are_taken_as_they_are(tmp_path):
    elsewhere = tmp_path / "elsewhere/pictures"
    write_photos(elsewhere, IMAGES[:2])
    document = transforms_document(CAMERAS[:1], IMAGES[:2], f"{elsewhere}/")
    write_json(tmp_path / "capture/transforms.json", document)
    views = read_views(tmp_path / "capture")
    assert [view.name for view in views] == ["a photo.png", "b.png"]
    assert [view.image_path for view in views] == [elsewhere / view.name for view in views]
    # moved, with everything in it, to where the paths do not lead
    elsewhere.rename(tmp_path / "capture/images")
    moved = read_views(tmp_path / "capture")
    assert [view.image_path.parent.name for view in moved] == ["images", "images"]
    assert [view.name for view in moved] == ["a photo.png", "b.png"]


def test_absolute_paths_inside_the_capture_are_named_as_relative_ones(tmp_path):
    write_photos(tmp_path / "images", IMAGES[:2])
    document = transforms_document(CAMERAS[:1], IMAGES[:2], f"{tmp_path}/images/")
    write_json(tmp_path / "transforms.json", document)
    assert [view.name for view in read_views(tmp_path)] == ["a photo.png", "b.png"]


@pytest.mark.parametrize("path", ["/a/../../b.png", "/x" * 600, "/a\n.png", "//host/a.png/.."])
def test_absolute_paths_that_are_tricks(tmp_path, path):
    document = transforms_document(CAMERAS[:1], IMAGES[:1], "")
    document["frames"][0]["file_path"] = path
    write_json(tmp_path / "transforms.json", document)
    with malformed("relative to the image folder"):
        read_views(tmp_path)


def test_transforms_train_is_read_and_transforms_test_is_not(tmp_path):
    write_photos(tmp_path / "images")
    write_json(tmp_path / "transforms_train.json", transforms_document(CAMERAS[:1], IMAGES[:2]))
    write_json(tmp_path / "transforms_test.json", transforms_document(images=IMAGES[2:]))
    assert [view.name for view in read_views(tmp_path)] == NAMES[:2]
    assert [view.name for view in read_views(tmp_path / "transforms_test.json")] == NAMES[2:]


# points


def write_cloud(path: Path, **columns: list) -> None:
    write_vertices(path, {name: np.array(values) for name, values in columns.items()})


def test_points_that_transforms_json_names(tmp_path):
    write_photos(tmp_path / "images", IMAGES[:2])
    document = transforms_document(CAMERAS[:1], IMAGES[:2]) | {"ply_file_path": "sparse_pc.ply"}
    # the PLY is in the frame after it
    document["applied_transform"] = (np.diag([1.0, 1, -1, 1]) @ np.eye(4)[[1, 0, 2, 3]])[:3].tolist()
    write_json(tmp_path / "transforms.json", document)
    with pytest.warns(DrSplatWarning, match=r"ply_file_path, .*sparse_pc\.ply, is missing"):
        assert read_sparse_points(tmp_path) is None
    write_cloud(
        tmp_path / "sparse_pc.ply", x=[1.0, 2.0], y=[3.0, 4.0], z=[5.0, 1e7 + 0.25],
        red=np.uint8([255, 1]), green=np.uint8([0, 2]), blue=np.uint8([7, 3]),
    )  # fmt: skip
    found = read_sparse_points(tmp_path)
    assert_array_equal(found.positions, [[1, 3, 5], [2, 4, 1e7 + 0.25]])
    assert_array_equal(found.colors, [[255, 0, 7], [1, 2, 3]])
    scale = {"transform": np.eye(4)[:3].tolist(), "scale": 2.0}
    write_json(tmp_path / "dataparser_transforms.json", scale)
    back = np.linalg.inv(np.array([*document["applied_transform"], [0, 0, 0, 1]]))
    expected = 2 * np.array([[1, 3, 5], [2, 4, 1e7 + 0.25]]) @ back[:3, :3].T
    assert_allclose(read_sparse_points(tmp_path).positions, expected)


def test_points_of_any_ply(tmp_path, capture):
    write_cloud(tmp_path / "grey.ply", x=[1.0], y=[2.0], z=[3.0], intensity=[0.5])
    found = read_sparse_points(capture, points=tmp_path / "grey.ply")
    assert_array_equal(found.positions, [[1, 2, 3]])
    assert_array_equal(found.colors, [[128] * 3])
    write_cloud(tmp_path / "shares.ply", x=[1.0], y=[2.0], z=[3.0], red=[1.0], green=[0.5], blue=[0.0])  # fmt: skip
    found = read_sparse_points(capture, points=tmp_path / "shares.ply")
    assert_array_equal(found.colors, [[255, 128, 0]])


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"x": [1.0], "y": [1.0]}, "vertex has no z"),
        ({"x": [1.0, np.nan], "y": [1.0] * 2, "z": [1.0] * 2}, "1 of 2 points are not finite, the first at index 1"),
        ({name: [2.0] for name in ("x", "y", "z", "red", "green", "blue")}, "expected colours"),
    ],
)  # fmt: skip
def test_clouds_that_are_none(tmp_path, capture, columns, said):
    write_cloud(tmp_path / "cloud.ply", **columns)
    with malformed(rf"cloud\.ply: .*{said}"):
        read_sparse_points(capture, points=tmp_path / "cloud.ply")


def test_files_of_points_that_are_none(tmp_path, capture):
    (tmp_path / "empty.ply").touch()
    with malformed("empty"):
        read_sparse_points(capture, points=tmp_path / "empty.ply")
    for name in ("none.ply", "."):
        with refused(r"there is no such file|this is a folder"):
            read_sparse_points(capture, points=tmp_path / name)
    document = transforms_document() | {"ply_file_path": "../secret.ply"}
    write_json(tmp_path / "transforms.json", document)
    with malformed(r"without '\.\.'"):
        read_sparse_points(tmp_path / "transforms.json")


# photos of transforms.json


def test_photos_of_transforms_in_another_folder(tmp_path):
    path = write_json(tmp_path / "transforms.json", transforms_document(folder="./images/"))
    write_photos(tmp_path / "images_4", width=16, height=12)
    views = read_views(path, images="images_4")
    assert [view.name for view in views] == NAMES
    assert [view.width for view in views] == [16] * 3


def test_frames_without_photo_are_left_out_and_named(tmp_path):
    path = write_json(tmp_path / "transforms.json", transforms_document())
    write_photos(tmp_path / "images", IMAGES[:1])
    with pytest.warns(DrSplatWarning, match="2 of 3 frames.*a photo.*cam0/c") as caught:
        views = read_views(path)
    assert len(caught) == 1
    assert [view.name for view in views] == ["b.png"]
    (tmp_path / "images/b.png").unlink()
    with refused("none of its 3 photos"):
        read_views(path)


@pytest.mark.parametrize(
    "lens",
    [
        {"camera_model": "OPENCV_FISHEYE"},
        {"camera_model": "EQUIRECTANGULAR"},
        {"is_fisheye": True},
        {"k3": 0.1},
        {"k4": 0.1},
    ],
)
def test_transforms_of_other_lenses(tmp_path, lens):
    path = write_json(tmp_path / "transforms.json", lens | transforms_document(folder=""))
    for frame in (document := json.loads(path.read_text()))["frames"]:
        del frame["camera_model"]
    write_json(path, document)
    write_photos(tmp_path)
    with malformed("equirectangular" if "EQUI" in str(lens) else "image_undistorter"):
        read_views(path)


@pytest.mark.parametrize("linear", [2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.eye(3) + np.eye(3, k=1) * 0.1])
def test_poses_that_are_not_rigid(tmp_path, linear):
    document = transforms_document(folder="")
    matrix = np.array(document["frames"][1]["transform_matrix"])
    matrix[:3, :3] @= linear
    document["frames"][1]["transform_matrix"] = matrix.tolist()
    path = write_json(tmp_path / "transforms.json", document)
    write_photos(tmp_path)
    with malformed(r"frame 1 .*transform_matrix.*lengths"):
        read_views(path)


# cameras.json


def test_cameras_json_equals_colmap(tmp_path):
    write_colmap_binary(tmp_path / "a/sparse/0", CAMERAS[:1], IMAGES[:2])
    write_json(tmp_path / "b/cameras.json", cameras_json_document())
    for folder in ("a", "b"):
        write_photos(tmp_path / folder / "images", IMAGES[:2])
    for a, b in zip(read_views(tmp_path / "a"), read_views(tmp_path / "b"), strict=True):
        same(a, b)


def test_cameras_json_without_photos(tmp_path):
    path = write_json(tmp_path / "cameras.json", cameras_json_document())
    with pytest.warns(DrSplatWarning, match="2 of 2 views have no photo"):
        views = read_views(path)
    assert [view.name for view in views] == ["a photo", "b"]


def test_cameras_json_round_trip(tmp_path):
    path = write_json(tmp_path / "cameras.json", cameras_json_document())
    views = read_cameras_json(path)
    write_cameras_json(tmp_path / "again.json", views)
    for a, b in zip(views, read_cameras_json(tmp_path / "again.json"), strict=True):
        same(a, b, atol=1e-14)
    with refused("exists"):
        write_cameras_json(path, views)


def test_writing_cameras_json_says_what_is_lost(capture, tmp_path):
    with pytest.warns(DrSplatWarning, match=r"lost for 1 views: cam0/c\.png"):
        write_cameras_json(tmp_path / "cameras.json", read_views(capture))


# Which file, which frame


def test_colmap_comes_first_and_that_is_said(capture):
    write_json(capture / "transforms.json", transforms_document())
    with pytest.warns(DrSplatWarning, match=r"read from .*sparse.0, not from .*transforms\.json"):
        read_views(capture)


def test_nothing_to_read(tmp_path):
    with refused("COLMAP"):
        read_views(tmp_path)
    with refused("no such file or folder"):
        read_views(tmp_path / "absent")


def dataparser() -> tuple[dict, np.ndarray, float]:
    transform = np.linalg.inv(camera_to_world((0.3, 0.2, -0.8, 0.1), (1.0, -2.0, 0.5)))
    return {"transform": transform[:3].tolist(), "scale": 0.25}, transform, 0.25


def moved(points: np.ndarray, transform: np.ndarray, scale: float) -> np.ndarray:
    return scale * (points @ transform[:3, :3].T + transform[:3, 3])


@pytest.mark.parametrize("beside", [False, True])
def test_dataparser_transforms(capture, tmp_path_factory, beside):
    document, transform, scale = dataparser()
    points = default_rng(1).normal(size=(40, 3))
    before = read_views(capture)
    folder = capture if beside else tmp_path_factory.mktemp("output")
    path = write_json(folder / "dataparser_transforms.json", document)
    after = read_views(capture, dataparser_transforms=None if beside else path)
    for a, b in zip(before, after, strict=True):
        expected = project(a, points) * (1, 1, scale)
        assert_allclose(project(b, moved(points, transform, scale)), expected, atol=1e-9)


def test_dataparser_transforms_start_from_colmap_for_transforms_json_too(capture):
    """ns-process-data turns the world; the file's transform includes that turn already."""
    document, *_ = dataparser()
    applied = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    turned = transforms_document()
    for frame in turned["frames"]:
        frame["transform_matrix"] = (applied @ frame["transform_matrix"]).tolist()
    path = write_json(capture / "transforms.json", turned | {"applied_transform": applied[:3].tolist()})
    write_json(capture / "dataparser_transforms.json", document)
    for a, b in zip(
        read_views(capture / "sparse/0", dataparser_transforms=capture / "dataparser_transforms.json"),
        read_views(path),
        strict=True,
    ):
        same(a, b)


@pytest.mark.parametrize(
    "document",
    [
        {"scale": 1.0},
        {"transform": np.eye(4)[:3].tolist(), "scale": 0},
        {"transform": (2 * np.eye(4))[:3].tolist(), "scale": 1},
    ],
)
def test_dataparser_transforms_that_are_none(capture, document):
    path = write_json(capture / "other.json", document)
    with malformed(r"other\.json"):
        read_views(capture, dataparser_transforms=path)


# A real capture


@pytest.mark.data
@needs_plush
def test_the_plush_capture():
    views = read_views(PLUSH)
    assert len(views) == 97
    assert {(view.width, view.height) for view in views} == {(1008, 756)}
    assert {view.distortion for view in views} == {(0.032123238578, 0.0, 0.0, 0.0)}
    positions, colors = read_points(PLUSH)
    assert positions.shape == colors.shape == (25784, 3)
    in_front, inside = [], []
    for view in views:
        x, y, depth = project(view, positions).T
        seen = (depth > 0) & (x > 0) & (x < view.width) & (y > 0) & (y < view.height)
        in_front.append((depth > 0).mean())
        inside.append(seen.mean())
    assert np.mean(in_front) > 0.95
    assert np.mean(inside) > 0.6
