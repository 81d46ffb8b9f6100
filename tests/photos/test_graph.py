"""The built-in segmenter `graph`: sums, features, merging, masks, and how its rule is learned."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from safetensors.numpy import load_file
from skimage.segmentation import find_boundaries
from test_views_hostile import unchecked_types
from world.segmenter.network import both, first_rule, learn_rule, padded
from world.segmenter.scenes import Photo
from world.segmenter.scores import score, shared_pixels
from world.segmenter.tuning import case, learned, save_rule

from command_line import error_of
from drsplat.kernels import available_isas
from drsplat.kernels.photo_regions import (
    BORDER_STEPS,
    TRAIT_STEPS,
    TRAITS,
    RegionGraph,
    lab_colors,
    merge_order,
    merged_regions,
    pair_likelihoods,
    region_graph,
)
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.graph.segmenter import (
    WORKING_PIXELS,
    GraphSettings,
    MergeRule,
    enlarged,
    label_masks,
    look,
    segment_labels,
    shipped_network,
    shipped_rule,
    small_regions,
    working_image,
)
from drsplat.photos.models.point_masks import PointMaskSettings
from drsplat.photos.models.sam import load_segmenter
from drsplat.scene.masks.masks import Masks, Segmenter
from drsplat.scene.masks.selection import paint
from refusing import refused
from twins.photo_features import pair_features
from twins.photo_merging import Merging, likelihood

NETWORK = shipped_network()[0]
Y, X = np.mgrid[:240, :320]
IMAGES = st.builds(
    lambda height, width, seed, cell: blocks(default_rng(seed), height, width, cell),
    st.integers(1, 30), st.integers(1, 30), st.integers(0, 10**6), st.integers(1, 9),
)  # fmt: skip


def blocks(rng: np.random.Generator, height: int, width: int, cell: int) -> np.ndarray:
    """Cells of a few random colours with a little noise."""
    colors = rng.integers(0, 256, (4, 3))
    cells = rng.integers(0, 4, (-(-height // cell), -(-width // cell)))
    picture = colors[cells.repeat(cell, 0).repeat(cell, 1)[:height, :width]]
    return np.clip(picture + rng.integers(-3, 4, picture.shape), 0, 255).astype(np.uint8)


def large(image: np.ndarray) -> Masks:
    return GraphSegmenter().segment(image)["large"]


# Masks


def test_it_is_a_segmenter_of_one_level():
    assert isinstance(GraphSegmenter(), Segmenter)
    assert set(GraphSegmenter().segment(np.zeros((4, 4, 3), np.uint8))) == {"large"}


@settings(max_examples=20)
@given(IMAGES)
def test_masks_are_a_partition_largest_first(image):
    masks = large(image)
    covered = sum(masks.full(i).astype(int) for i in range(len(masks)))
    assert_array_equal(covered, 1)
    assert (np.diff(masks.areas) <= 0).all()
    assert masks.areas.min() > 0


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 3), (37, 2), (240, 320)])
def test_a_flat_image_is_one_mask(size):
    masks = large(np.full((*size, 3), 90, np.uint8))
    assert len(masks) == 1
    assert masks.full(0).all()


def test_an_image_without_pixels_is_refused():
    with refused("0x5 pixels"):
        large(np.zeros((5, 0, 3), np.uint8))


def flat_squares() -> tuple[np.ndarray, np.ndarray]:
    truth = np.zeros((240, 320), int)
    truth[60:140, 40:120] = 1
    truth[90:190, 180:280] = 2
    colors = np.uint8([(120, 120, 120), (200, 30, 30), (30, 60, 200)])
    return colors[truth], truth


def test_two_flat_squares_are_three_masks():
    image, truth = flat_squares()
    found = paint(large(image))
    assert_array_equal(found, np.array([0, 2, 1])[truth])


def shaded_disc() -> tuple[np.ndarray, np.ndarray]:
    """A red ball in light from the upper left, with a highlight, on grey."""
    image = np.full((240, 320, 3), 150.0)
    disc = np.hypot(X - 160, Y - 120) < 60
    light = 1 - 0.5 * np.clip(((X - 130) + (Y - 90)) / 130, 0, 1)
    image[disc] = (np.array([190, 40, 35]) * light[..., None])[disc]
    glow = np.exp(-(np.hypot(X - 140, Y - 100) ** 2) / 60)[..., None]
    image = image * (1 - glow) + 255 * glow
    noise = default_rng(0).normal(0, 2, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8), disc


def test_a_shaded_disc_with_a_highlight_is_one_mask():
    image, disc = shaded_disc()
    found = paint(large(image))
    inside = found == found[150, 160]
    assert (inside & disc).sum() / (inside | disc).sum() > 0.97


@pytest.mark.parametrize("times", [2, 3, 6])
def test_larger_photos_have_the_same_masks(times):
    image, truth = flat_squares()
    found = paint(large(image.repeat(times, 0).repeat(times, 1)))
    expected = np.array([0, 2, 1])[truth].repeat(times, 0).repeat(times, 1)
    assert (found == expected).mean() > 0.995


def test_working_images_have_the_photos_shape_and_bounded_size():
    image = np.zeros((3000, 4000, 3), np.uint8)
    assert working_image(image).shape == (480, 640, 3)
    assert working_image(np.zeros((2, 10**6, 3), np.uint8)).shape[0] == 1
    small = np.zeros((480, 640, 3), np.uint8)
    assert working_image(small) is small
    assert WORKING_PIXELS == 480 * 640


@given(st.integers(1, 30), st.integers(1, 30), st.integers(1, 4), st.integers(1, 4))
def test_enlarged_labels_are_those_of_the_nearest_pixel(h, w, m, n):
    labels = np.arange(h * w, dtype=np.int32).reshape(h, w)
    assert_array_equal(enlarged(labels, h * m, w * n), labels.repeat(m, 0).repeat(n, 1))


# The network


@pytest.mark.parametrize("size", [(1, 1), (1, 70), (31, 33)])
def test_it_sees_photos_of_any_size(size):
    sight = look(np.full((*size, 3), 90, np.uint8), NETWORK)
    assert sight.borders.shape == size
    assert 0 <= sight.borders.min() <= sight.borders.max() <= BORDER_STEPS


def test_it_sees_where_a_thing_ends_and_what_it_is_made_of():
    image, truth = flat_squares()
    sight = look(image, NETWORK)
    across = truth[:, 1:] != truth[:, :-1]
    assert sight.borders[:, 1:][across].mean() > 5 * sight.borders.mean()
    traits = [sight.traits[truth == thing].mean(0) for thing in range(3)]
    spread = max(sight.traits[truth == thing].std(0).max() for thing in range(3))
    assert min(np.linalg.norm(traits[a] - traits[b]) for a, b in ((0, 1), (0, 2), (1, 2))) > spread


# Merging


def merged_by_twin(graph: RegionGraph, rule: MergeRule, threshold: float, area: float, width: float) -> np.ndarray:
    merging = Merging(graph, partial(likelihood, rule))
    merging.merge_above(threshold)
    merging.merge_small(area, width)
    return merging.labels()


def graph_of(image: np.ndarray) -> tuple[np.ndarray, RegionGraph]:
    lab = lab_colors(image)
    labels = small_regions(lab)
    return labels, region_graph(labels, lab, look(image, NETWORK))


@pytest.mark.parametrize("isa", available_isas())
@given(IMAGES, st.sampled_from([0.3, 0.6, 0.9]), st.floats(0, 90), st.floats(0, 4))
def test_native_merging_is_the_twins(isa, image, threshold, area, width):
    rule = shipped_rule()[0]
    _, graph = graph_of(image)
    found = merged_regions(graph, rule.parts, threshold, area, width, isa=isa)
    assert_array_equal(found, merged_by_twin(graph, rule, threshold, area, width))


@pytest.mark.parametrize("isa", available_isas())
@given(IMAGES)
def test_the_native_order_of_merging_is_the_twins(isa, image):
    rule = shipped_rule()[0]
    _, graph = graph_of(image)
    twin = Merging(graph, partial(likelihood, rule))
    twin.merge_above(-1.0)
    order = merge_order(graph, rule.parts, isa=isa)
    assert order.tolist() == [list(pair) for pair in twin.order]
    assert len(order) == len(graph.sums) - 1  # all of a photo hangs together


@pytest.mark.parametrize("isa", available_isas())
def test_native_likelihoods_are_the_twins(isa):
    rule = shipped_rule()[0]
    _, graph = graph_of(blocks(default_rng(2), 90, 120, 7))
    ends = graph.pairs.T
    features = pair_features(graph.sums[ends], graph.boxes[ends], graph.borders, graph.pixels)
    found = pair_likelihoods(graph, rule.parts, isa=isa)
    assert len(np.unique(found)) > 50
    assert_allclose(found, likelihood(rule, features), rtol=0, atol=1.01e-6)


def test_a_graph_or_rule_of_other_shapes_is_refused():
    rule = shipped_rule()[0]
    _, graph = graph_of(flat_squares()[0])
    for wrong in ({"pairs": graph.pairs[::-1]}, {"borders": graph.borders[1:]}, {"sums": graph.sums[:, :9]}):
        with unchecked_types(), refused("regions: expected"):
            merged_regions(replace(graph, **wrong), rule.parts, 0.5, 0.0, 0.0)
    with unchecked_types(), refused("rule of 42 features"):
        pair_likelihoods(graph, replace(rule, hidden=rule.hidden[1:]).parts)


@settings(max_examples=15)
@given(IMAGES, st.floats(2, 200))
def test_no_small_region_stays(image, least):
    labels, graph = graph_of(image)
    areas = np.bincount(merged_regions(graph, shipped_rule()[0].parts, 1.0, least, 0.0)[labels].ravel())
    assert areas.min() >= min(least, labels.size)


def test_everything_merges_at_threshold_zero_and_nothing_at_one():
    image = blocks(default_rng(0), 60, 60, 12)
    rule = shipped_rule()[0]
    labels = small_regions(lab_colors(image))
    none = segment_labels(image, rule, NETWORK, GraphSettings(0.0, 0.0, 1.0))
    assert_array_equal(np.unique(none), np.unique(labels))
    eager = replace(rule, output_bias=np.array([60.0]))
    assert segment_labels(image, eager, NETWORK, GraphSettings(0.0, 0.0, 0.5)).max() == 0


def test_masks_of_labels():
    labels = np.int32([[2, 2, 5], [0, 5, 5]])
    masks = label_masks(labels)
    assert_array_equal(masks.areas, [3, 2, 1])
    assert_array_equal(paint(masks), [[1, 1, 0], [2, 0, 0]])


# Identity and loading


def test_identity_changes_with_every_setting():
    usual = GraphSegmenter().identity
    assert usual == GraphSegmenter(GraphSettings()).identity
    assert usual != GraphSegmenter(GraphSettings(least_area=61.0)).identity
    assert usual != GraphSegmenter(GraphSettings(least_width=3.0)).identity
    assert usual != GraphSegmenter(GraphSettings(threshold=0.4)).identity
    assert (usual["weights"], usual["network"]) == (shipped_rule()[1], shipped_network()[1])


@pytest.mark.parametrize("wrong", [{"least_area": -1.0}, {"threshold": 1.5}, {"least_area": float("nan")}])  # fmt: skip
def test_settings_out_of_range_are_refused(wrong):
    with refused("expected 0"):
        GraphSettings(**wrong)


def test_it_is_loaded_by_its_name_and_has_no_points():
    assert load_segmenter("graph").identity == GraphSegmenter().identity
    with refused("without settings"):
        load_segmenter("graph", "cpu", PointMaskSettings())


@pytest.mark.parametrize("option", [["--points", "8"], ["--crop-layers", "0"], ["--levels", "four"]])
def test_the_command_refuses_options_of_sam(option, captured, capsys):
    command = ["embed", str(captured), "--segmenter", "graph", "--encoder", "drsplat-mini"]
    assert "--segmenter graph has masks of one level" in error_of(capsys, *command, *option)


def test_the_command_runs_without_torch(captured):
    levels = ["--levels", "large"]
    code = (
        "import sys; sys.modules['torch'] = None; from drsplat.cli import main; sys.exit(main("
        f"['embed', {str(captured)!r}, '--segmenter', 'graph', '--encoder', 'drsplat-mini', '--langsplat', *{levels}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    ids = np.load(captured / "language_features" / "a_s.npy")
    assert_array_equal(ids[3], np.array([0, 2, 1])[flat_squares()[1]])


@pytest.fixture
def captured(tmp_path) -> Path:
    """A capture of one photo, three flat colours."""
    (tmp_path / "images").mkdir()
    Image.fromarray(flat_squares()[0]).save(tmp_path / "images" / "a.png")
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 320 240 300 300 160 120\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 2 1 a.png\n\n")
    (model / "points3D.txt").write_text("")
    return tmp_path


# Learning


def made_photo(seed: int, times: int = 1) -> Photo:
    """Squares of random colours on a striped floor, so many times as large as 160x120."""
    rng = default_rng(seed)
    truth = np.ones((120, 160), np.int64)
    image = np.where((np.arange(160) // 6 % 2)[None, :, None] == 0, 110, 140) + np.zeros((120, 1, 3))
    for thing in (2, 3, 4):
        y, x = rng.integers(0, (80, 120))
        truth[y : y + 36, x : x + 36] = thing
    image[truth > 1] = rng.integers(0, 256, (5, 3))[truth][truth > 1]
    noisy = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    large, owners = (array.repeat(times, 0).repeat(times, 1) for array in (noisy, truth))
    return Photo(str(seed), large, owners, np.array([False, False, True, True, True]))


@pytest.mark.slow
def test_a_rule_is_learned_written_and_better_than_none(tmp_path):
    cases = [case(made_photo(seed), NETWORK) for seed in range(3)]
    rule = learned(cases, cases[:1], rounds=2, hidden=4, steps=60)
    save_rule(rule, tmp_path / "rule.safetensors")
    assert (tmp_path / "rule.safetensors").stat().st_size < 10_000
    photo = made_photo(99)
    labels = segment_labels(photo.image, rule, NETWORK, GraphSettings())
    found = score(shared_pixels(labels, photo.truth, 5), photo.is_object)
    plain = small_regions(lab_colors(photo.image))
    assert found.best.min() > 0.9
    assert found.masks < len(np.unique(plain))


def test_the_shipped_rule_is_of_the_learned_form(tmp_path):
    from importlib.resources import files

    rule = shipped_rule()[0]
    save_rule(rule, tmp_path / "again.safetensors")
    shipped = files("drsplat.photos.models.graph") / "rule.safetensors"
    assert (tmp_path / "again.safetensors").read_bytes() == shipped.read_bytes()
    assert {name: a.shape for name, a in load_file(tmp_path / "again.safetensors").items()} == {
        name: a.shape for name, a in vars(rule).items()
    }


@pytest.mark.slow
def test_the_network_is_written_as_it_is_read(tmp_path):
    torch = pytest.importorskip("torch")
    from world.segmenter.sight import learned as learned_network
    from world.segmenter.sight import save_network

    net = learned_network([made_photo(seed, times=2) for seed in range(2)], 2)
    save_network(net, tmp_path / "network.safetensors")
    weights = {name: a.astype(np.float32) for name, a in load_file(tmp_path / "network.safetensors").items()}
    assert {name: a.shape for name, a in weights.items()} == {name: a.shape for name, a in NETWORK.items()}
    image = made_photo(99).image[:96]
    with torch.no_grad():
        out = net(torch.from_numpy(image / np.float32(127.5) - 1).permute(2, 0, 1)[None])[0].numpy()
    sight = look(image, weights)
    assert_allclose(sight.traits, out[1:].transpose(1, 2, 0) * TRAIT_STEPS, atol=1)
    assert_allclose(sight.borders, BORDER_STEPS / (1 + np.exp(-out[0])), atol=1)


def test_what_the_network_is_to_learn_has_no_loss():
    torch = pytest.importorskip("torch")
    from world.segmenter.sight import batches, border_loss, touching, trait_loss

    batch = next(batches([made_photo(seed, times=2) for seed in range(4)], default_rng(0)))
    truth = touching(batch.things)
    labels = batch.things[0].numpy()
    assert_array_equal(truth[0].numpy() > 0, find_boundaries(labels, connectivity=1, mode="thick"))
    right, wrong = border_loss(20 * truth - 10, batch), border_loss(10 - 20 * truth, batch)
    assert right < 1e-3
    assert wrong > 9
    own = torch.nn.functional.one_hot(batch.things, TRAITS).permute(0, 3, 1, 2).float()
    torch.manual_seed(0)
    assert trait_loss(5 * own, batch, torch.tensor(9.0)) < 1e-3
    assert trait_loss(0 * own, batch, torch.tensor(9.0)) > 4


def test_the_rule_is_learned_by_its_true_slopes():
    rng = default_rng(0)
    features = rng.normal(size=(2000, 5))
    together = features[:, 0] * features[:, 1] > 0  # no line divides these
    rule = learn_rule(first_rule(features, 8), features, together, np.ones(2000), 200)
    assert ((likelihood(rule, features) > 0.5) == together).mean() > 0.97


def test_the_mean_of_two_rules():
    rng = default_rng(0)
    features = rng.normal(3, 2, (500, 7))
    blind, seeing = first_rule(features[:, :5] * 1.1, 4), first_rule(features, 6)
    blind = replace(blind, output_bias=np.array([0.7]))

    def logit(rule, given):
        likely = likelihood(rule, given)
        return np.log(likely / (1 - likely))

    assert_array_equal(likelihood(padded(blind, 7), features), likelihood(blind, features[:, :5]))
    mean = (logit(blind, features[:, :5]) + logit(seeing, features)) / 2
    assert_allclose(logit(both(blind, seeing), features), mean, atol=1e-4)


def test_scores_by_hand():
    truth = np.repeat([1, 2], [400, 600]).reshape(10, 100)
    labels = np.repeat([0, 1], [300, 700]).reshape(10, 100)
    found = score(shared_pixels(labels, truth, 3), np.array([False, True, False]))
    assert_allclose(found.best, [300 / 400, 600 / 700])
    assert found.purity == 0.9
    assert found.masks == 2
    assert found.is_object.tolist() == [True, False]


SEE = """
import hashlib, numpy as np
from drsplat import MiniEncoder
from drsplat.photos.models.graph.segmenter import look, shipped_network
image = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
sight = look(image, shipped_network()[0], threads={threads})
rows = MiniEncoder(threads={threads}).encode_images([image[:90, :90], image])
print([hashlib.sha256(part.tobytes()).hexdigest() for part in (sight.borders, sight.traits, rows)])
"""


def test_neither_threads_nor_the_blas_decide_a_bit():
    """In processes of their own: a BLAS reads its number of threads once."""
    seen = [
        subprocess.run(
            [sys.executable, "-c", SEE.format(threads=threads)],
            env={**os.environ, "OPENBLAS_NUM_THREADS": str(threads)}, capture_output=True, text=True, check=True,
        ).stdout
        for threads in (1, 2, 3)
    ]  # fmt: skip
    assert seen[1:] == seen[:1] * 2
