"""Masks of photos in a capture: what they leave out takes no part in training, embedding and registering."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring
from command_line import answer_of
from drsplat.cli import main
from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.formats.langsplat import read_features
from drsplat.formats.poses import write_cameras_json
from drsplat.photos.embedding.embed import embed
from drsplat.scene.masks.masks import cut_masks, kept_masks
from drsplat.scene.photo_masks import load_mask
from drsplat.scene.photos import undistort_ids
from drsplat.training import training_photos
from drsplat.training.evaluation import evaluate
from drsplat.training.metrics import psnr, ssim
from drsplat.training.optimizer import Optimizer
from drsplat.training.run import Beginning, Run
from drsplat.training.start import first_gaussians, split_views
from drsplat.training.training_photos import TrainingPhotos
from refusing import malformed, refused
from scenes import look_at_view
from toy_capture import write_toy_capture

PERSON = (slice(10, 50), slice(30, 60))  # rows and columns of a photo of 96 x 72
SIZE = (72, 96)


def person_mask() -> np.ndarray:
    """White but for the person."""
    mask = np.full(SIZE, 255, np.uint8)
    mask[PERSON] = 0
    return mask


def save(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def capture_of(folder: Path, count: int = 12) -> tuple[ds.Gaussians, list[ds.View]]:
    """Write photos of a known scene into a capture without masks; return the scene and the views."""
    scene = known_scene()
    (folder / "images").mkdir(parents=True)
    views = photographed(folder / "images", scene, ring(count))
    write_cameras_json(folder / "cameras.json", views)
    return scene, views


def put_person(view: ds.View) -> None:
    assert view.image_path is not None
    pixels = np.asarray(Image.open(view.image_path)).copy()
    pixels[PERSON] = (255, 0, 255)
    Image.fromarray(pixels).save(view.image_path)


# --- finding and reading ---


@pytest.mark.parametrize("name", ["photo_01.png.png", "photo_01.png"])
def test_masks_lie_beside_images_under_either_name(name, tmp_path):
    capture_of(tmp_path, 3)
    save(tmp_path / "masks" / name, person_mask())
    views = ds.read_views(tmp_path)
    assert [view.mask_path for view in views] == [None, tmp_path / "masks" / name, None]
    assert np.array_equal(load_mask(views[1]), person_mask() == 255)
    assert load_mask(views[0]) is None
    inverted = ds.read_views(tmp_path, invert_masks=True)[1]
    assert np.array_equal(load_mask(inverted), person_mask() == 0)


def test_a_capture_without_masks_has_none(tmp_path):
    capture_of(tmp_path, 3)
    assert all(view.mask_path is None and not view.mask_inverted for view in ds.read_views(tmp_path))
    with refused("no masks: put them into masks/"):
        ds.read_views(tmp_path, invert_masks=True)


def test_masks_of_other_photos_are_told(tmp_path):
    capture_of(tmp_path, 3)
    save(tmp_path / "masks/another.png", person_mask())
    with pytest.warns(DrSplatWarning, match="no mask in it has a photo's name"):
        ds.read_views(tmp_path)


def test_a_mask_that_a_transforms_json_names(tmp_path):
    """nerfstudio's mask_path, of a frame."""
    save(tmp_path / "images/a.png", np.zeros((72, 96, 3), np.uint8))
    save(tmp_path / "kept/of_a.png", person_mask())
    pose = np.eye(4).tolist()
    frame = {"file_path": "images/a.png", "mask_path": "kept/of_a.png", "transform_matrix": pose}
    document = {"fl_x": 80.0, "w": 96, "h": 72, "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    assert ds.read_views(tmp_path)[0].mask_path == tmp_path / "kept/of_a.png"
    (tmp_path / "kept/of_a.png").unlink()
    with refused(r"mask_path, .*of_a\.png, is missing"):
        ds.read_views(tmp_path)
    frame["mask_path"] = "../of_a.png"
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    with malformed("mask_path"):
        ds.read_views(tmp_path)


def test_a_smaller_pixel_is_kept_where_all_that_it_shows_is(tmp_path):
    mask = np.full(SIZE, 255, np.uint8)
    mask[8, 12] = 0
    save(tmp_path / "images/a.png", np.zeros((*SIZE, 3), np.uint8))
    save(tmp_path / "masks/a.png", mask)
    view = replace(
        look_at_view((0.0, -4.0, 0.0), width=96, height=72), name="a.png", image_path=tmp_path / "images/a.png",
        mask_path=tmp_path / "masks/a.png",
    )  # fmt: skip
    kept = load_mask(view.resized(24, 18))
    assert kept is not None
    assert np.argwhere(~kept).tolist() == [[2, 3]]
    larger = load_mask(view.resized(192, 144))
    assert larger is not None
    assert (~larger).sum() == 4


def test_the_lens_is_undone_on_masks_as_on_photos(tmp_path):
    save(tmp_path / "images/a.png", np.repeat(person_mask()[..., None], 3, axis=2))
    save(tmp_path / "masks/a.png", person_mask())
    view = replace(
        look_at_view((0.0, -4.0, 0.0), width=96, height=72), name="a.png", image_path=tmp_path / "images/a.png",
        mask_path=tmp_path / "masks/a.png", distortion=(0.2, 0.05, 0.0, 0.0),
    )  # fmt: skip
    kept = load_mask(view)
    assert kept is not None
    assert np.array_equal(kept, undistort_ids(view, (person_mask() == 255).astype(np.int32)) == 1)
    assert (ds.load_image(view)[kept] > 120).all()  # the photo is white where the mask is; bilinear at its edges


def test_damaged_masks_and_masks_of_another_shape_are_errors(tmp_path):
    capture_of(tmp_path, 3)
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks/photo_01.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with malformed(r"photo_01\.png: cannot be read as a mask"):
        load_mask(ds.read_views(tmp_path)[1])
    save(tmp_path / "masks/photo_01.png", np.zeros((96, 72), np.uint8))
    with pytest.raises(MismatchError, match="the mask is 72x96, its photo 96x72"):
        load_mask(ds.read_views(tmp_path)[1])


# --- training ---


@pytest.fixture(scope="module")
def crowded(tmp_path_factory) -> tuple[Path, list[ds.View], ds.Gaussians]:
    """A capture whose photos to train on show a person, with masks; the views held out are clean."""
    folder = tmp_path_factory.mktemp("crowded")
    scene, views = capture_of(folder, 16)
    for view in split_views(views, 8).train:
        put_person(view)
        save(folder / "masks" / view.name, person_mask())
    return folder, views, scene


def run_of(views: list[ds.View], scene: ds.Gaussians) -> Run:
    settings = ds.TrainingSettings(iterations=30, test_every=0, sh_degree=0)
    points = perturbed_points(scene)
    return Run(Beginning(views, settings, Optimizer(first_gaussians(points, settings)), np.random.default_rng(0)))


def test_what_is_left_out_decides_nothing(crowded, tmp_path):
    """Whatever photos show where they are masked, the run is the same to the bit."""
    folder, _, scene = crowded
    masked = split_views(ds.read_views(folder), 8).train
    others = []
    for view in masked:
        assert view.image_path is not None
        pixels = np.asarray(Image.open(view.image_path)).copy()
        pixels[PERSON] = (0, 255, 40)
        save(tmp_path / view.name, pixels)
        others.append(replace(view, image_path=tmp_path / view.name))
    one, other = run_of(masked, scene), run_of(others, scene)
    for _ in range(30):
        assert one.step().loss == other.step().loss
    for first, second in zip(one.optimizer.parameters, other.optimizer.parameters, strict=True):
        assert np.array_equal(first, second)
    assert np.array_equal(one.density.pull, other.density.pull)
    assert np.array_equal(one.density.times_seen, other.density.times_seen)


def test_white_masks_give_the_bits_of_no_masks(crowded):
    _, views, scene = crowded
    white = views[0].image_path.parent.parent / "white.png"
    save(white, np.full(SIZE, 255, np.uint8))
    plain, masked = run_of(views, scene), run_of([replace(view, mask_path=white) for view in views], scene)
    for _ in range(20):
        plain.step()
        masked.step()
    for first, second in zip(plain.optimizer.parameters, masked.optimizer.parameters, strict=True):
        assert np.array_equal(first, second)


def test_gaussians_that_only_left_out_pixels_show_are_not_seen(crowded, tmp_path):
    """Else the mean of their pull, which density control goes by, would be of views that say nothing about them."""
    _, views, scene = crowded
    half = np.zeros(SIZE, np.uint8)
    half[:, 48:] = 255
    save(tmp_path / "half.png", half)
    run = run_of([replace(views[0], mask_path=tmp_path / "half.png"), views[1]], scene)
    whole = run_of([views[0], views[1]], scene)
    index = run.order.pending
    for _ in range(2):
        run.step()
        whole.step()
    assert index.size == 0
    assert 0 < (run.density.times_seen == 2).sum() < (whole.density.times_seen == 2).sum()


def test_measures_compare_what_is_kept_alone(crowded):
    folder, _, scene = crowded
    view = ds.read_views(folder)[1]
    settings = ds.TrainingSettings(sh_degree=1, background="black")
    parameters = first_gaussians(perturbed_points(scene), settings)
    scored = evaluate(parameters, [view], TrainingPhotos([view], 0), settings)
    from drsplat.training.evaluation import rendered

    image = rendered(parameters, view, settings)
    photo = ds.load_image(view) * np.float32(1 / 255)
    photo[PERSON] = image[PERSON]
    share = (person_mask() == 255).mean()
    assert scored.psnr == pytest.approx(psnr(image, photo) + 10 * np.log10(share), abs=1e-6)
    everything = ssim(image, photo)
    inside = np.zeros(SIZE, bool)
    inside[PERSON] = True
    alone = ssim(image, photo, ~inside)
    assert scored.ssim == pytest.approx((everything - (1 - share) * alone) / share, abs=1e-6)


def test_memory_of_photos_counts_their_masks(crowded):
    folder, _, _ = crowded
    views = split_views(ds.read_views(folder), 8).train
    photos = TrainingPhotos(views, 2 * 72 * 96 * 4 + 72 * 96 * 3)
    for index in range(4):
        assert photos[index].num_bytes == 72 * 96 * 4
    assert len(photos._kept) == 2


def test_other_masks_are_put_on_photos_that_are_kept(crowded, monkeypatch):
    folder, _, _ = crowded
    masked = split_views(ds.read_views(folder), 8).train
    bare = [replace(view, mask_path=None) for view in masked]
    photos = TrainingPhotos(bare, 3 * 72 * 96 * 3)
    before = [photos[index].pixels for index in range(3)]
    later = photos.with_masks_of(masked)
    expected = TrainingPhotos(masked, 0)
    monkeypatch.setattr(training_photos, "load_image", lambda view: pytest.fail(f"{view.name} was read again"))
    for index in range(3):
        assert later[index].pixels is before[index]
        assert_array_equal(later[index].left_out, ~load_mask(masked[index]))
    monkeypatch.undo()
    assert_array_equal(later[3].pixels, expected[3].pixels)
    assert len(later._kept) == 3


def test_a_run_does_not_go_on_with_other_masks(crowded, tmp_path):
    folder, _, scene = crowded
    masked, points = ds.read_views(folder), perturbed_points(scene)
    settings = ds.TrainingSettings(iterations=4, test_every=0, sh_degree=0)
    assert ds.train(masked, settings, tmp_path / "model", points=points, device="cpu").num_masked == 14
    longer = replace(settings, iterations=6)
    bare = [replace(view, mask_path=None) for view in masked]
    with pytest.raises(MismatchError, match="other masks"):
        ds.train(bare, longer, tmp_path / "model", points=points, device="cpu")
    inverted = [replace(view, mask_inverted=view.mask_path is not None) for view in masked]
    with pytest.raises(MismatchError, match="other masks"):
        ds.train(inverted, longer, tmp_path / "model", points=points, device="cpu")
    ds.train(masked, longer, tmp_path / "model", points=points, device="cpu")


# --- registering ---


@pytest.fixture
def toy(tmp_path) -> tuple[Path, ds.Gaussians, list[ds.View], object]:
    folder = write_toy_capture(tmp_path)
    scene = ds.read_gaussians(folder / "scene.ply")
    features = read_features(folder / "capture/language_features")
    return folder / "capture", scene, ds.read_views(folder / "capture"), features


def same_fields(one: ds.Registration, other: ds.Registration) -> bool:
    a, b = one.weights, other.weights
    parts = [(a.indptr, b.indptr), (a.indices, b.indices), (a.data, b.data), (one.embeddings, other.embeddings)]
    return all(np.array_equal(x, y) for x, y in parts)


def test_a_photo_that_is_left_out_gives_the_field_without_it(toy):
    capture, scene, views, features = toy
    save(capture / "masks/photo_2.png", np.zeros((72, 96), np.uint8))
    with pytest.warns(DrSplatWarning, match=r"1 of 4 photos are not used, .*photo_2\.png") as told:
        masked = ds.register(scene, ds.read_views(capture), features)
    assert not any("no features" in str(one.message) for one in told)
    without = ds.register(scene, [view for view in views if view.name != "photo_2.png"], features)
    assert masked.masks.view_names == without.masks.view_names
    assert same_fields(masked, without)
    left, right = masked.to_field(), without.to_field()
    assert np.array_equal(left.gaussian_ids, right.gaussian_ids)


def test_left_out_pixels_weigh_as_pixels_without_a_mask(toy):
    capture, scene, views, features = toy
    mask = np.full((72, 96), 255, np.uint8)
    mask[:, :50] = 0
    for view in views:
        save(capture / "masks" / view.name, mask)

    cut = {}
    for view in views:
        one = features[Path(view.name).stem]
        ids = one.mask_ids.copy()
        ids[:, :50] = -1
        cut[Path(view.name).stem] = ds.ViewFeatures(ids, one.embeddings)
    masked = ds.register(scene, ds.read_views(capture), features)
    expected = ds.register(scene, views, cut)
    assert masked.weights.nnz < ds.register(scene, views, features).weights.nnz
    assert same_fields(masked, expected)


def test_masks_of_all_photos_that_leave_all_out_are_an_error(toy):
    capture, scene, views, features = toy
    for view in views:
        save(capture / "masks" / view.name, np.zeros((72, 96), np.uint8))
    with pytest.warns(DrSplatWarning, match="4 of 4 photos"), refused("leave all of them out: white is kept"):
        ds.register(scene, ds.read_views(capture), features)


def test_verbs_read_masks_and_invert_them(toy, capsys):
    capture, _, views, _ = toy
    half = np.zeros((72, 96), np.uint8)
    half[:, 48:] = 255
    save(capture / "masks" / views[0].name, half)
    folder = capture.parent
    (folder / "out.txt").write_text(f"{views[0].name}\n")
    line = ["register", str(folder / "scene.ply"), str(capture), "--features", str(capture / "language_features")]
    counts = []
    for extra in ([], ["--invert-masks"], ["--without", str(folder / "out.txt")]):
        counts.append(answer_of(capsys, *line, "-o", folder / f"{len(counts)}.field", *extra)["num_weights"])
    capture.joinpath("masks", views[0].name).unlink()
    capture.joinpath("masks").rmdir()
    everything = answer_of(capsys, *line, "-o", folder / "all.field")["num_weights"]
    assert counts[2] < counts[0] < everything
    assert counts[2] < counts[1] < everything
    assert answer_of(capsys, "inspect", capture)["num_masked"] == 0
    add = ["add", str(folder / "2.field"), str(capture), "--features", str(capture / "language_features")]
    save(capture / "masks" / views[0].name, half)
    assert main([*add, "--scene", str(folder / "scene.ply"), "--views", views[0].name, "--json"]) == 0
    capsys.readouterr()
    assert ds.load_field(folder / "2.field").evidence.weights.nnz == counts[0]


# --- embedding ---


def test_masks_lose_what_is_left_out_and_go_where_little_is_left():
    full = np.zeros((3, 10, 10), bool)
    full[0, 2:8, 0:4] = True  # three quarters kept
    full[1, 0:2, 6:10] = True  # kept
    full[2, 3:9, 1:2] = True
    full[2, 3:9, 0] = True  # half of two columns is left out, and one pixel more
    kept = np.ones((10, 10), bool)
    kept[:, 0] = False
    kept[3, 1] = False
    levels = kept_masks({"large": cut_masks(full, np.float32([0.9, 0.8, 0.7]))}, kept)
    masks = levels["large"]
    assert masks.scores.tolist() == pytest.approx([0.9, 0.8])
    assert np.array_equal(masks.full(0), full[0] & kept)
    assert np.array_equal(masks.full(1), full[1])


class Halves:
    """Cut a photo into its left and its right half."""

    def __init__(self) -> None:
        self.identity = {"kind": "halves"}

    def segment(self, image: np.ndarray):
        full = np.zeros((2, *image.shape[:2]), bool)
        full[0, :, : image.shape[1] // 2] = True
        full[1, :, image.shape[1] // 2 :] = True
        return {"large": cut_masks(full, np.ones(2, np.float32))}


def test_embed_gives_no_masks_to_what_is_left_out(toy, tmp_path):
    capture, _, views, _ = toy
    half = np.zeros((72, 96), np.uint8)
    half[:, 40:] = 255
    save(capture / "masks" / views[0].name, half)
    save(capture / "masks" / views[1].name, np.zeros((72, 96), np.uint8))
    encoder = ds.MiniEncoder()
    output = tmp_path / "features"
    with pytest.warns(DrSplatWarning, match=r"1 of 4 photos are not used, .*photo_1\.png"):
        report = embed(ds.read_views(capture), output, Halves(), encoder)
    assert report.photos == 3
    features = read_features(output)
    assert "photo_1" not in features
    ids = features["photo_0"].mask_ids
    assert (ids[:, :40] == -1).all()
    assert len(np.unique(ids[ids >= 0])) == 1
    assert len(np.unique(features["photo_2"].mask_ids)) == 2
    save(capture / "masks" / views[0].name, np.full((72, 96), 255, np.uint8))
    with pytest.warns(DrSplatWarning, match="photos are not used"):
        again = embed(ds.read_views(capture), output, Halves(), encoder)
    assert (again.reused, again.redone) == (2, 1)
    assert len(np.unique(read_features(output)["photo_0"].mask_ids)) == 2
