"""Annotations of LVIS and COCO, patches by them, and the codebook that is trained on these."""

import json
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import drsplat as ds
from drsplat import cli
from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.formats.lvis import decode_runs, fill_polygon, read_annotations, unpack_counts
from drsplat.photos.embedding.patches import MIN_AREA_PIXELS, PatchSource, embed_patches, find_patches, patches
from drsplat.scene.masks.crops import crop, crops
from fake_models import DIM, ThumbnailEncoder
from lvis_files import (
    BOXES,
    HEIGHT,
    PHOTOS,
    WIDTH,
    annotation,
    box_mask,
    document,
    packed,
    pixels_of,
    runs_of,
    write_set,
)
from refusing import malformed, refused

MASKS = arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9)))


# Run lengths


@settings(derandomize=True, max_examples=80)
@given(MASKS)
def test_runs_and_their_text_are_the_mask(mask):
    counts = runs_of(mask)
    unpacked = unpack_counts(packed(counts), "here")
    assert unpacked.tolist() == counts
    assert_array_equal(decode_runs(unpacked, *mask.shape, "here"), mask)


@settings(derandomize=True, max_examples=80)
@given(st.lists(st.integers(0, 1 << 32), max_size=30))
def test_any_counts_survive_packing(counts):
    assert unpack_counts(packed(counts), "here").tolist() == counts


def test_text_from_the_published_format():
    """By hand: 6, 1, 40, 4 is '6', '1', 40 = 8 + 32 * 1 as 'X' and '1', then 4 - 1 = 3 as '3'."""
    assert packed([6, 1, 40, 4]) == "61X13"
    assert unpack_counts("61X13", "").tolist() == [6, 1, 40, 4]
    assert unpack_counts("61X1O", "").tolist() == [6, 1, 40, 0]  # 'O' is 31: -1
    assert unpack_counts("", "").tolist() == []


@pytest.mark.parametrize("text", ["61X", "6 1", "6p", "6\x00", "6é", "o" * 30, "P" * 9 + "0"])
def test_text_that_is_none(text):
    with malformed("here: expected compressed run lengths"):
        unpack_counts(text, "here")


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        ([4, -1, 3], "a run of -1 pixels"),
        ([4, 9], "a run of 9 pixels in an image of 3x2, 6 pixels"),
        ([2, 2], "add up to 4 pixels"),
        ([], "add up to 0"),
        ([6, 6, 6], "add up to 18"),
    ],
)
def test_runs_that_do_not_fit(counts, said):
    with malformed(f"here: .*{said}"):
        decode_runs(np.array(counts, np.int64), 2, 3, "here")


def test_runs_may_be_empty_in_between():
    mask = decode_runs(np.int64([0, 2, 0, 1, 3]), 3, 2, "")
    assert mask.tolist() == [[True, False], [True, False], [True, False]]


# Polygons


def inside(points: np.ndarray, x: float, y: float) -> bool:
    """Even-odd by a plain loop over the edges, the ray to the left."""
    odd = False
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, 0), strict=True):
        if min(y0, y1) <= y < max(y0, y1) and x0 + (y - y0) / (y1 - y0) * (x1 - x0) <= x:
            odd = not odd
    return odd


@settings(derandomize=True)
@given(
    st.lists(st.tuples(st.integers(-12, 50), st.integers(-12, 50)), max_size=9), st.integers(1, 11), st.integers(1, 11)
)
def test_polygons_by_a_plain_loop(corners, height, width):
    """Corners on quarters of pixels, centres among them, some outside the image."""
    points = np.array(corners, float).reshape(-1, 2) / 4
    expected = [[inside(points, x + 0.5, y + 0.5) for x in range(width)] for y in range(height)]
    assert_array_equal(fill_polygon(points, height, width), np.array(expected))


def test_large_polygons_are_filled_in_pieces(monkeypatch):
    from drsplat.formats import lvis

    points = default_rng(0).uniform(0, 40, (30, 2))
    whole = fill_polygon(points, 37, 41)
    monkeypatch.setattr(lvis, "_BLOCK_CROSSINGS", 1)
    assert_array_equal(fill_polygon(points, 37, 41), whole)
    assert 0 < whole.sum() < whole.size


@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_masks_of_pycocotools():
    """Runs are equal; polygons differ by pixels whose neighbourhood crosses the outline."""
    oracle = pytest.importorskip("pycocotools.mask", reason="pycocotools is not installed")
    from scipy import ndimage

    rng = default_rng(0)
    for _ in range(50):
        mask = ndimage.gaussian_filter(rng.normal(size=rng.integers(1, 90, 2)), 3) > 0
        encoded = oracle.encode(np.asfortranarray(mask.astype(np.uint8)))
        counts = unpack_counts(encoded["counts"].decode(), "")
        assert_array_equal(decode_runs(counts, *mask.shape, ""), mask)
        assert packed(counts.tolist()) == encoded["counts"].decode()
        angles = np.sort(rng.uniform(0, 2 * np.pi, 20))
        points = 50 + np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(9, 40)
        ours = fill_polygon(points, 100, 100)
        theirs = oracle.decode(oracle.frPyObjects([points.ravel().tolist()], 100, 100))[..., 0] > 0
        near = ndimage.maximum_filter(ours, 3) & ~ndimage.minimum_filter(ours, 3)
        assert not ((ours != theirs) & ~near).any()


# The file


def test_what_a_file_holds(tmp_path):
    annotations = read_annotations(write_set(tmp_path))
    names = {number: photo.name for number, photo in annotations.photos.items()}
    assert names == {11: "train2017/000011.png", 12: "val2017/000012.png", 13: "000013.png"}
    assert annotations.categories == {1: "cup", 2: "sofa"}
    assert [instance.id for instance in annotations.instances] == list(BOXES)
    for instance in annotations.instances:
        assert_array_equal(annotations.mask(instance), box_mask(*BOXES[instance.id]))
        assert (instance.photo, instance.crowd) == (PHOTOS[instance.id], False)
        assert instance.area == box_mask(*BOXES[instance.id]).sum()


def test_polygons_of_one_instance_are_united(tmp_path):
    content = document()
    two = [*content["annotations"][0]["segmentation"], *content["annotations"][3]["segmentation"]]
    content["annotations"][0]["segmentation"] = [*two, two[0], [1, 2], []]
    annotations = read_annotations(write_set(tmp_path, content))
    expected = box_mask(*BOXES[1]) | box_mask(*BOXES[4])
    assert_array_equal(annotations.mask(annotations.instances[0]), expected)


def test_outlines_are_not_kept_as_lists(tmp_path):
    """LVIS's training set has 10^8 coordinates: as Python numbers they would take ten times the room."""
    annotations = read_annotations(write_set(tmp_path))
    assert annotations.instances[0].segmentation[0].dtype == np.float64
    assert annotations.instances[1].segmentation.counts.dtype == np.int64


def with_value(path: tuple[object, ...], value: object) -> dict:
    """The document with one value replaced, or removed where it is ...."""
    content = document()
    place = content
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("images",), ..., "lists images, annotations and categories"),
        (("annotations",), {}, "lists images, annotations and categories"),
        (("images", 0), 3, "image at place 0: expected an object"),
        (("images", 0, "id"), "11", "image at place 0: id: expected a number"),
        (("images", 1, "id"), 11, "image 11: the id occurs twice"),
        (("images", 0, "height"), 0, "image 11: height, width"),
        (("images", 0, "width"), 1 << 20, "image 11: height, width"),
        (("images", 0, "width"), None, "image 11: width: expected a number"),
        (("images", 0, "coco_url"), ..., "image 11: expected a text file_name, or coco_url"),
        (("images", 0, "coco_url"), "http://[a/b.png", "image 11: coco_url"),
        (("images", 0, "coco_url"), "http://host/../b.png", "image 11: coco_url"),
        (("images", 2, "file_name"), "/etc/passwd", "image 13: file_name"),
        (("categories", 1, "name"), 5, "category 2: name"),
        (("annotations", 0, "id"), ..., "annotation at place 0: id"),
        (("annotations", 0, "image_id"), 14, "annotation 1: image_id: there is no image 14"),
        (("annotations", 0, "category_id"), 9, "annotation 1: category_id: there is no category 9"),
        (("annotations", 0, "area"), "9", "annotation 1: area: expected a number"),
        (("annotations", 0, "iscrowd"), [], "annotation 1: iscrowd"),
        (("annotations", 0, "segmentation"), ..., "annotation 1: segmentation: expected polygons"),
        (("annotations", 0, "segmentation"), [3.0], "annotation 1: segmentation: expected polygons"),
        (("annotations", 0, "segmentation", 0), [1, 2, 3], "annotation 1: segmentation: expected"),
        (("annotations", 0, "segmentation", 0), [1, "2"], "annotation 1: segmentation: expected"),
        (("annotations", 0, "segmentation", 0), [1, True], "annotation 1: segmentation: expected"),
        (("annotations", 0, "segmentation", 0), [1, 10**400], "annotation 1: segmentation"),
        (("annotations", 0, "segmentation", 0), [1, 1e30], "annotation 1: segmentation: a polygon"),
        (("annotations", 0, "segmentation", 0), [1, float("nan")], "annotation 1: segmentation"),
        (("annotations", 1, "segmentation", "size"), [30], "annotation 2: segmentation: size"),
        (("annotations", 1, "segmentation", "size"), [40, 30], "annotation 2: segmentation: size"),
        (("annotations", 1, "segmentation", "counts"), [1.5], "annotation 2: segmentation: counts"),
        (("annotations", 1, "segmentation", "counts"), [1 << 70], "2: segmentation: counts"),
        (("annotations", 1, "segmentation", "counts"), ..., "annotation 2: segmentation: counts"),
    ],
)  # fmt: skip
def test_errors_name_file_entry_and_field(tmp_path, path, value, said):
    with malformed(rf"annotations\.json.*{said}"):
        read_annotations(write_set(tmp_path, with_value(path, value)))


def test_errors_of_runs_name_the_annotation(tmp_path):
    content = with_value(("annotations", 2, "segmentation", "counts"), "61X13")
    annotations = read_annotations(write_set(tmp_path, content))
    with malformed(r"annotations\.json, annotation 3: segmentation: the runs"):
        annotations.mask(annotations.instances[2])


def test_files_that_are_none(tmp_path):
    with refused("no such file"):
        read_annotations(tmp_path / "absent.json")
    for text in ("", "[]", "{", "[" * 100_000):
        (tmp_path / "a.json").write_text(text)
        with malformed(r"a\.json"):
            read_annotations(tmp_path / "a.json")


# Patches


def source_of(folder: Path, content: dict | None = None, **options: object) -> PatchSource:
    path = write_set(folder, content)
    return find_patches(read_annotations(path), folder / "images", **options)


def test_patches_are_the_things_on_black(tmp_path):
    source = source_of(tmp_path)
    assert (source.num_wanted, source.left_out, source.missing) == (4, 1, ())  # 5 has 16 pixels
    made = [list(crops(*photo)) for photo in patches(source, source.photos)]
    assert [len(squares) for squares in made] == [2, 1, 1]
    for number, patch in zip((1, 2, 3, 4), (patch for squares in made for patch in squares), strict=True):
        x0, y0, x1, y1 = BOXES[number]
        whole = np.ones((y1 - y0, x1 - x0), bool)
        assert_array_equal(patch, crop(pixels_of(PHOTOS[number]), whole, BOXES[number]))
        assert patch.shape == (max(whole.shape), max(whole.shape), 3)


def test_photos_are_opened_once(tmp_path, monkeypatch):
    from drsplat.photos.embedding import patches as module

    opened = []
    load = module.load_image
    monkeypatch.setattr(module, "load_image", lambda view: opened.append(view.name) or load(view))
    content = document()
    content["annotations"].reverse()  # so that those of one photo are apart: 11, 13, 11
    content["annotations"][1], content["annotations"][3] = content["annotations"][3::-2]
    source = source_of(tmp_path, content)
    list(patches(source, source.photos))
    assert sorted(opened) == ["000013.png", "train2017/000011.png", "val2017/000012.png"]


def test_areas_in_the_file_are_not_believed(tmp_path):
    content = document()
    for entry in content["annotations"]:
        entry["area"] = 1e6
    source = source_of(tmp_path, content)
    assert (source.num_wanted, source.left_out) == (5, 0)
    embedded = embed_patches(source, ThumbnailEncoder(), tmp_path / "parts")
    assert (embedded.embeddings.shape, embedded.too_small) == ((4, DIM), 1)


def test_the_smallest_patch(tmp_path):
    content = document()
    content["annotations"] = [
        annotation(1, 11, box_mask(0, 0, 10, 10), "runs"),
        annotation(2, 11, box_mask(0, 0, 11, 9), "runs"),
        annotation(3, 11, box_mask(0, 0, 20, 20), "runs", iscrowd=1),
    ]
    source = source_of(tmp_path, content)
    assert [wanted.id for photo in source.photos for wanted in photo.instances] == [1]
    assert MIN_AREA_PIXELS == 100
    content["annotations"] = content["annotations"][1:]
    with refused("none of 2 instances in these photos has 100 pixels"):
        source_of(tmp_path, content)


def test_a_limit_draws_by_seed(tmp_path):
    def drawn(seed):
        source = source_of(tmp_path, limit=2, seed=seed)
        return [wanted.id for photo in source.photos for wanted in photo.instances]

    draws = [drawn(seed) for seed in range(12)]
    assert draws == [drawn(seed) for seed in range(12)]
    assert all(len(set(ids)) == 2 and ids == sorted(ids) for ids in draws)
    assert {number for ids in draws for number in ids} == {1, 2, 3, 4}


def test_missing_photos_are_named(tmp_path):
    path = write_set(tmp_path)
    (tmp_path / "images/val2017/000012.png").unlink()
    with pytest.warns(DrSplatWarning, match=r"1 of 3 annotated photos are missing: val2017/000012"):
        source = find_patches(read_annotations(path), tmp_path / "images")
    assert source.missing == ("val2017/000012.png",)
    assert (source.num_wanted, source.left_out) == (3, 2)
    (tmp_path / "empty").mkdir()
    with refused(r"none of the 3 annotated photos is there.*train2017/"):
        find_patches(read_annotations(path), tmp_path / "empty")
    with refused("there is no folder"):
        find_patches(read_annotations(path), tmp_path / "absent")


def test_photos_in_one_folder_are_found_by_their_last_name(tmp_path):
    path = write_set(tmp_path)
    for name in ("train2017/000011.png", "val2017/000012.png"):
        (tmp_path / "images" / name).rename(tmp_path / "images" / Path(name).name)
    assert find_patches(read_annotations(path), tmp_path / "images").num_wanted == 4


def test_photos_of_another_size_are_refused(tmp_path):
    source = source_of(tmp_path)
    Image.new("RGB", (WIDTH // 2, HEIGHT // 2)).save(tmp_path / "images/000013.png")
    with pytest.raises(MismatchError, match=r"000013\.png: the photo is 20x15, annotated at 40x30"):
        list(patches(source, source.photos))


def test_embedding_goes_on_with_the_next_photo(tmp_path):
    source = source_of(tmp_path)

    class Stops(ThumbnailEncoder):
        def encode_images(self, images):
            if self.asked >= 3:
                raise KeyboardInterrupt
            return super().encode_images(images)

    with pytest.raises(KeyboardInterrupt):
        embed_patches(source, Stops(), tmp_path / "parts")
    second, whole = ThumbnailEncoder(), ThumbnailEncoder()
    resumed = embed_patches(source, second, tmp_path / "parts")
    expected = embed_patches(source, whole, tmp_path / "other")
    assert (second.asked, whole.asked) == (1, 4)
    assert_array_equal(resumed.embeddings, expected.embeddings)
    assert resumed.too_small == expected.too_small == 0
    assert_allclose(np.linalg.norm(resumed.embeddings, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("changed", ["encoder", "photo", "annotations", "limit", "record"])
def test_what_an_earlier_run_did_of_other_patches_is_not_used(tmp_path, changed):
    encoder = ThumbnailEncoder()
    embed_patches(source_of(tmp_path), encoder, tmp_path / "parts")
    path = tmp_path / "images/000013.png"
    match changed:
        case "encoder":
            encoder = ThumbnailEncoder("other")
        case "photo":
            os.utime(path, ns=(0, 0))
        case "annotations":
            os.utime(tmp_path / "annotations.json", ns=(0, 0))
        case "record":
            (tmp_path / "parts/progress.json").write_text("[]")
    options = {"limit": 3} if changed == "limit" else {}
    annotations = read_annotations(tmp_path / "annotations.json")
    source = find_patches(annotations, tmp_path / "images", **options)
    encoder.asked = 0
    embed_patches(source, encoder, tmp_path / "parts")
    assert encoder.asked == source.num_wanted


# The command


@pytest.fixture
def fake_encoder(monkeypatch) -> None:
    from drsplat.photos.models import loading

    monkeypatch.setattr(loading, "load_encoder", lambda name, device, threads: ThumbnailEncoder(name))


def run(capsys, *arguments: object, code: int = 0) -> str:
    capsys.readouterr()
    with warnings.catch_warnings():
        assert cli.main(["codebook", "train", *map(str, arguments)]) == code
    out, err = capsys.readouterr()
    return err if code else out


def test_a_codebook_from_annotations(tmp_path, fake_encoder, capsys):
    path, output = write_set(tmp_path), tmp_path / "book.safetensors"
    command = ["--lvis", path, "--images", tmp_path / "images", "--encoder", "e", "--output", output,
               "--subvectors", 4, "--device", "cpu"]  # fmt: skip
    answer = json.loads(run(capsys, *command, "--json"))
    book = ds.load_codebook(output)
    assert book.encoder == ThumbnailEncoder("e").identity
    assert (book.num_subvectors, book.hash) == (4, answer["hash"])
    assert (answer["num_embeddings"], answer["num_photos"], answer["num_left_out"]) == (4, 3, 1)
    assert answer["num_held_out"] == 1
    assert not Path(f"{output}.parts").exists()
    assert "exists already" in run(capsys, *command, code=1)
    parts = Path(f"{output}.parts")  # as a run leaves them that is killed before they are removed
    parts.mkdir()
    assert "exists already" in run(capsys, *command, "--seed", 1, code=1)
    parts.mkdir(exist_ok=True)
    assert json.loads(run(capsys, *command, "--json"))["was_complete"]
    assert not parts.exists()
    said = run(capsys, *command, "--overwrite", "--limit", "all")
    assert "1 held out" in said
    assert "0 missing" in said


def test_a_codebook_from_embeddings(tmp_path, capsys):
    """Rows near twelve directions, so that held-out ones can be told well; of any length."""
    rng = default_rng(0)
    rows = rng.normal(size=(12, 32))[rng.integers(0, 12, 2000)] + 0.01 * rng.normal(size=(2000, 32))
    np.save(tmp_path / "rows.npy", (rows * rng.uniform(0.1, 9, (2000, 1))).astype(np.float16))
    output = tmp_path / "book.safetensors"
    command = [tmp_path / "rows.npy", "--encoder-name", "toy", "--output", output, "--subvectors", 8]
    answer = json.loads(run(capsys, *command, "--json"))
    book = ds.load_codebook(output)
    assert (book.encoder, answer["num_held_out"]) == (ds.EncoderIdentity("toy", 32), 100)
    unit = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
    decoded = book.decode(book.encode(unit))
    cosines = (unit * decoded).sum(1) / np.linalg.norm(decoded, axis=1)
    assert cosines.mean() > 0.99
    assert answer["held_out_cosine"] == pytest.approx(cosines.mean(), abs=2e-3)
    assert answer["held_out_cosine_worst"] <= answer["held_out_cosine"]
    again = tmp_path / "again.safetensors"
    run(capsys, *command[:4], again, *command[5:])
    assert again.read_bytes() == output.read_bytes()


def test_held_out_rows_are_not_trained_on(tmp_path, capsys):
    """256 distinct rows are kept without loss; with one held out among 2, what is trained has one."""
    np.save(tmp_path / "rows.npy", np.eye(8, dtype=np.float32)[:2])
    options = ["--encoder-name", "toy", "--subvectors", 1, "--output"]
    answer = json.loads(run(capsys, tmp_path / "rows.npy", *options, tmp_path / "a.safetensors", "--json"))  # fmt: skip
    assert (answer["num_held_out"], answer["held_out_cosine"]) == (1, 0)
    np.save(tmp_path / "one.npy", np.eye(8, dtype=np.float32)[:1])
    said = run(capsys, tmp_path / "one.npy", *options, tmp_path / "b.safetensors")
    assert "not measured" in said


def test_what_the_command_refuses(tmp_path, fake_encoder, capsys):
    path, output = write_set(tmp_path), ["--output", tmp_path / "book.safetensors"]
    rows = tmp_path / "rows.npy"
    np.save(rows, np.ones((4, 16), np.float32))
    assert "either FEATURES.npy or --lvis" in run(capsys, *output, code=1)
    assert "either FEATURES.npy or --lvis" in run(capsys, rows, "--lvis", path, *output, code=1)
    assert "--images" in run(capsys, "--lvis", path, *output, code=1)
    assert "--encoder-name" in run(capsys, rows, *output, code=1)
    assert "ends in .safetensors" in run(capsys, rows, "--output", tmp_path / "book.bin", code=1)
    named = ["--encoder-name", "toy", *output]
    assert "divides 16" in run(capsys, rows, *named, "--subvectors", 5, code=1)
    np.save(rows, np.ones((4, 16), np.int32))
    assert "expected floats (N, D)" in run(capsys, rows, *named, code=1)
    for value in (0.0, np.nan, 1e300):
        bad = np.ones((4, 16), np.float64)
        bad[2] = value
        np.save(rows, bad)
        assert "row 2 has no direction" in run(capsys, rows, *named, code=1)
    assert not (tmp_path / "book.safetensors").exists()
