"""Damaged and hostile captures, features and vocabularies: sound results or a precise error."""

import json
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import jaxtyping
import numpy as np
import pytest

from drsplat.errors import DrSplatError, DrSplatWarning
from drsplat.formats.captures import read_views
from drsplat.formats.colmap import read_points
from drsplat.formats.json_files import read_json
from drsplat.formats.langsplat import LEVELS, FeatureFolder, write_features
from drsplat.formats.npy import map_npy
from drsplat.formats.photo_files import safe_name
from drsplat.formats.vocabulary import VocabularyEncoder, read_vocabulary, write_vocabulary
from drsplat.scene.encoders import EncoderIdentity
from drsplat.scene.masks.features import ViewFeatures
from drsplat.scene.photos import load_image, photo_size
from drsplat.scene.views import View
from mutations import bounded_allocations, mutants, quota, seeded
from refusing import malformed
from written_captures import (
    IMAGES,
    cameras_json_document,
    transforms_document,
    write_colmap_binary,
    write_colmap_text,
    write_json,
    write_photo,
    write_photos,
)

MUTANTS = quota(5_200)  # of each family
ALLOWANCE = 64 << 20  # bytes of address space that files of some kilobytes may take


@pytest.fixture
def bounded_memory() -> Iterator[None]:
    with bounded_allocations(ALLOWANCE):
        yield


@pytest.fixture
def memory_path(tmp_path) -> Iterator[Path]:
    """A folder in memory where there is one: writing thousands of files to a disk takes minutes."""
    if not Path("/dev/shm").is_dir():
        yield tmp_path
    else:
        with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
            yield Path(folder)


@contextmanager
def unchecked_types() -> Iterator[None]:
    """Without the checks of annotations, which take longer than reading a small file."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


def survive(paths: list[Path], read: Callable[[], None], count: int = MUTANTS) -> None:
    """Damage one file at a time; what is read is sound, or refused by a DrSplatError.

    Both must happen: a fuzzer whose files are all refused tests one line of the reader.
    """
    rng, sound, refused = seeded(len(paths)), 0, 0
    with warnings.catch_warnings(), unchecked_types():
        warnings.simplefilter("ignore", DrSplatWarning)
        read()
        for path in paths:
            original = path.read_bytes()
            for mutant in mutants(original, rng, -(-count // len(paths))):
                path.write_bytes(mutant)
                try:
                    read()
                    sound += 1
                except DrSplatError:
                    refused += 1
            path.write_bytes(original)
    assert sound > count / 50
    assert refused > count / 5


def check_views(views: list[View]) -> None:
    assert views
    for view in views:
        assert np.isfinite(view.center).all()
        assert np.isfinite(np.linalg.inv(view.K)).all()
        assert 1 <= view.width <= 1 << 17
        assert 1 <= view.height <= 1 << 17
        assert ".." not in view.name.split("/")
        assert not view.name.startswith("/")
    assert len({view.name for view in views}) == len(views)


def check_points(capture: Path) -> None:
    positions, colors = read_points(capture)
    assert np.isfinite(positions).all()
    assert positions.shape == colors.shape


# Every family


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_colmap_models(memory_path, bounded_memory, write):
    write(memory_path, images=IMAGES[:2])
    write_photos(memory_path, IMAGES[:2])
    cameras, images, points = (next(memory_path.glob(f"{stem}.*")) for stem in ("cameras", "images", "points3D"))
    survive([cameras, images], lambda: check_views(read_views(memory_path)), quota(MUTANTS - 1500))
    survive([points], lambda: check_points(memory_path), quota(1500))


@pytest.mark.slow
def test_transforms_json(memory_path, bounded_memory):
    document = transforms_document(images=IMAGES[:2])
    document |= {"applied_transform": np.eye(4)[:3].tolist(), "camera_angle_x": 1.0, "k1": 0.01}
    del document["frames"][1]["fl_x"], document["frames"][1]["fl_y"], document["frames"][1]["w"]
    path = write_json(memory_path / "transforms.json", document)
    write_json(memory_path / "dataparser_transforms.json", {"transform": np.eye(4)[:3].tolist(), "scale": 0.5})
    write_photos(memory_path / "images", IMAGES[:2])
    survive([path], lambda: check_views(read_views(path)))


def test_dataparser_transforms(memory_path, bounded_memory):
    write_colmap_text(memory_path, images=IMAGES[:1])
    write_photos(memory_path, IMAGES[:1])
    document = {"transform": np.eye(4)[:3].tolist(), "scale": 0.5}
    path = write_json(memory_path / "dataparser_transforms.json", document)
    survive([path], lambda: check_views(read_views(memory_path)), quota(1000))


@pytest.mark.slow
def test_cameras_json(memory_path, bounded_memory):
    path = write_json(memory_path / "cameras.json", cameras_json_document())
    write_photos(memory_path, IMAGES[:2])
    survive([path], lambda: check_views(read_views(path)))


@pytest.mark.slow
def test_feature_files(memory_path, bounded_memory):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(6, 5)).astype(np.float32)
    write_features(memory_path, "a", rng.integers(-1, 6, (4, 7, 9)).astype(np.int32), rows)

    def read():
        features = FeatureFolder(memory_path, LEVELS.index("small"))["a"]
        ViewFeatures(features.mask_ids, features.embeddings)  # says so if they are not sound
        assert len(features.file_rows) == len(features.embeddings)

    survive([memory_path / "a_s.npy", memory_path / "a_f.npy"], read)


def check_vocabulary(path: Path) -> None:
    vocabulary = read_vocabulary(path)
    vectors = vocabulary.encode_texts(vocabulary.texts)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)


def test_vocabulary_json(memory_path, bounded_memory):
    path = write_json(memory_path / "words.json", {"sofa": [1.5, -0.25, 1e-3], "red cup": [0.5, 2.0, 3.0]})
    survive([path], lambda: check_vocabulary(path))


def test_vocabulary_safetensors(memory_path, bounded_memory):
    path = memory_path / "words.safetensors"
    vectors = np.eye(3, dtype=np.float32)
    write_vocabulary(path, VocabularyEncoder(EncoderIdentity("toy", 3), ["a", "b", "c"], vectors))
    survive([path], lambda: check_vocabulary(path), 2000)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_photos(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_photos(tmp_path, [(0, 0, 0, 0, path.name)], 24, 16)
    view = View("a", np.array([[20.0, 0, 12], [0, 20, 8], [0, 0, 1]]), np.eye(4), 24, 16, path)

    def read():
        assert load_image(view).shape == (16, 24, 3)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of Pillow, on damaged metadata
        survive([path], read, quota(1000))


# Aimed


@pytest.mark.parametrize(
    "name",
    ["../a.png", "a/../../b.png", "/etc/passwd", "\\a.png", "..\\a.png", "C:\\a.png", "c:a", "",
     ".", "a\0b", "a\nb", "\ud800", "x" * 300, "a/" * 800 + "b"],
)  # fmt: skip
def test_names_that_leave_the_folder(name):
    with malformed("entry 5"):
        safe_name(name, "entry 5")


def test_names_that_stay():
    names = ("a.png", "./a/./b.png", "a\\b.png", "..a/b..png", "ü é.png", "a//b")
    found = [safe_name(name, "") for name in names]
    assert found == ["a.png", "a/b.png", "a/b.png", "..a/b..png", "ü é.png", "a/b"]


def test_path_tricks_in_every_kind_of_capture(tmp_path):
    images = [(*IMAGES[0][:4], "../secret.png")]
    write_colmap_text(tmp_path / "text", images=images)
    write_colmap_binary(tmp_path / "binary", images=images)
    transforms = transforms_document(images=[(*IMAGES[0][:4], "x.png")], folder="../")
    write_json(tmp_path / "transforms/transforms.json", transforms)
    cameras = cameras_json_document()
    cameras[0]["img_name"] = "/etc/../passwd"
    write_json(tmp_path / "cameras/cameras.json", cameras)
    for kind in ("text", "binary", "transforms", "cameras"):
        with malformed(r"(secret|x|passwd).*relative to the image folder"):
            read_views(tmp_path / kind)


@pytest.mark.slow
@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("count", [2**63, 2**64 - 1, 10**12, 3])
def test_counts_are_checked_before_anything_is_read(tmp_path, bounded_memory, stem, count):
    write_colmap_binary(tmp_path)
    path = tmp_path / f"{stem}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:64])
    with malformed(f"{stem}.bin"):
        read_points(tmp_path) if stem == "points3D" else read_views(tmp_path)


@pytest.mark.parametrize("kind", [".txt", ".bin"])
def test_empty_models(tmp_path, kind):
    for stem in ("cameras", "images"):
        (tmp_path / f"{stem}{kind}").touch()
    with malformed("no image" if kind == ".txt" else "truncated"):
        read_views(tmp_path)


def test_bytes_after_the_last_record(tmp_path):
    write_colmap_binary(tmp_path)
    with (tmp_path / "images.bin").open("ab") as file:
        file.write(b"more")
    with malformed("4 bytes follow"):
        read_views(tmp_path)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": ' * 50_000, '"\ud800', "1" * 10_000, "", "\xff"])
def test_json_that_breaks_parsers(tmp_path, text):
    path = tmp_path / "transforms.json"
    path.write_bytes(text.encode("latin1" if text == "\xff" else "utf-8", "surrogatepass"))
    with malformed(r"transforms\.json"):
        read_json(path)


@pytest.mark.parametrize("number", ["1e999", "-1e999", "NaN", "Infinity", "1" * 400, "true", "null", '"1"', "[]"])
@pytest.mark.parametrize("key", ["w", "fl_x", "cx", "k1"])
def test_numbers_that_are_none(tmp_path, key, number):
    frame = transforms_document(images=IMAGES[:1])["frames"][0] | {key: "here"}
    document = json.dumps({"frames": [frame]}).replace('"here"', number)
    (tmp_path / "transforms.json").write_text(document)
    write_photos(tmp_path / "images", IMAGES[:1])
    with malformed(f"frame 0.*{key}: expected a"):
        read_views(tmp_path)


@pytest.mark.parametrize("focal", ["0", "-5.0", "1e13"])
def test_impossible_focal_lengths(tmp_path, focal):
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE 64 48 {focal} 50 32 24\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    with malformed(r"a\.png"):
        read_views(tmp_path)


@pytest.mark.parametrize(
    "lens",
    [
        {"fl_x": 0, "fl_y": 50},
        {"fl_x": 50, "fl_y": 0},
        {"camera_angle_x": 5e-324},  # half of it is 0
        {"camera_angle_x": 1e-310},
        {"camera_angle_x": 1.0, "camera_angle_y": 0},
    ],
)
def test_impossible_lenses_of_transforms(tmp_path, lens):
    """None of them is replaced by that of the other axis."""
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist(), "w": 64, "h": 48}
    write_json(tmp_path / "transforms.json", {"frames": [frame | lens]})
    write_photo(tmp_path / "a.png")
    with malformed(r"frame 0 .*(focal|angle|not finite)"):
        read_views(tmp_path)


def test_rasters_larger_than_any_photo(tmp_path):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 9999999999 48 50 50 32 24\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    with malformed("9999999999x48"):
        read_views(tmp_path)


@pytest.mark.parametrize("quaternion", ["0 0 0 0", "nan 0 0 0", "inf 0 0 0", "1e-200 0 0 0"])
def test_quaternions_without_direction(tmp_path, quaternion):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (tmp_path / "images.txt").write_text(f"1 {quaternion} 0 0 0 1 a.png\n\n")
    with malformed("quaternion"):
        read_views(tmp_path)


def npy(header: str, content: bytes = b"\0" * 64, version: bytes = b"\x01\x00") -> bytes:
    return b"\x93NUMPY" + version + struct.pack("<H", len(header)) + header.encode() + content


@pytest.mark.slow
@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000,), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (0, 9223372036854775807, 2147483648), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (17,), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }",
        "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<f1', 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<U4', 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (__import__('os').getpid(),), }",
        "",
    ],
)
def test_headers_of_npy(tmp_path, bounded_memory, header):
    path = tmp_path / "a.npy"
    path.write_bytes(npy(header))
    with malformed(r"a\.npy"):
        map_npy(path)


def test_pickles_are_not_opened(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with malformed("integers or floats"):
        map_npy(tmp_path / "a.npy")


def test_versions_of_npy(tmp_path):
    path = tmp_path / "a.npy"
    good = "{'descr': '<f4', 'fortran_order': False, 'shape': (16,), }"
    path.write_bytes(npy(good))
    assert map_npy(path).shape == (16,)
    for content in (npy(good, version=b"\x09\x00"), b"", b"\x93NUMPY", b"PK\x03\x04" + bytes(50)):
        path.write_bytes(content)
        with malformed(r"\.npy"):
            map_npy(path)


def test_rows_that_no_file_holds(tmp_path, bounded_memory):
    """(10^12, 0) takes no bytes on disk, and must take none in memory."""
    np.save(tmp_path / "a_s.npy", np.zeros((4, 2, 2), np.int32))
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 0), }"
    (tmp_path / "a_f.npy").write_bytes(npy(header))
    with malformed(r"a_f\.npy"):
        FeatureFolder(tmp_path, 3)


def test_photo_bombs(tmp_path, bounded_memory):
    """A header of 60,000 x 60,000 pixels is refused before a row is decoded."""
    path = tmp_path / "a.ppm"
    path.write_bytes(b"P6 60000 60000 255\n")
    for read in (photo_size, lambda p: load_image(View("a", np.eye(3), np.eye(4), 8, 8, p))):
        with malformed(r"a\.ppm"):
            read(path)
