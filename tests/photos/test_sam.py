"""The automatic mask generator: its geometry, a predictor that is known, and tiny SAM and SAM 2."""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import linear_sum_assignment
from skimage.measure import label

from drsplat.errors import DrSplatError, MissingExtraError
from drsplat.photos.models import sam
from drsplat.photos.models.point_masks import (
    PointMasks,
    PointMaskSettings,
    PointSegmenter,
    box_nms,
    crop_boxes,
    cut_by_crop,
    open_points,
    point_grid,
    without_small_regions,
)
from drsplat.scene.masks.masks import LEVELS, Segmenter, cut_masks
from drsplat.scene.masks.selection import mask_maps
from places import SUPPORT
from refusing import malformed, refused

# --- where points are asked, which boxes and regions stay -----------------------------------------


def test_points_are_the_middles_of_cells_row_by_row():
    assert_allclose(point_grid(2), [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])


def test_crops_of_a_known_image():
    """Shared 512 of the shorter side's 1500; halves of 1500 and 2000 and half of that more."""
    layers = crop_boxes(1500, 2000, 1, 512 / 1500)
    assert layers == [
        (0, (0, 0, 2000, 1500)),
        (1, (0, 0, 1256, 1006)), (1, (0, 494, 1256, 1500)),
        (1, (744, 0, 2000, 1006)), (1, (744, 494, 2000, 1500)),
    ]  # fmt: skip


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 3), st.floats(0, 0.99))
def test_the_crops_of_a_layer_cover_the_image(height, width, layers, overlap):
    boxes = crop_boxes(height, width, layers, overlap)
    for layer in range(layers + 1):
        covered = np.zeros((height, width), bool)
        for x0, y0, x1, y1 in (box for at, box in boxes if at == layer):
            assert 0 <= x0 < x1 <= width
            assert 0 <= y0 < y1 <= height
            covered[y0:y1, x0:x1] = True
        assert covered.all()


def test_masks_at_the_edge_of_a_crop_but_not_of_the_image_are_cut():
    crop, size = (100, 0, 300, 200), (400, 500)
    assert not cut_by_crop((121, 0, 279, 179), crop, size)
    assert cut_by_crop((120, 0, 250, 150), crop, size)  # 20 px from the left
    assert cut_by_crop((150, 0, 281, 150), crop, size)  # the last pixel is 20 px from the right
    assert cut_by_crop((150, 0, 250, 181), crop, size)
    assert not cut_by_crop((0, 0, 500, 400), (0, 0, 500, 400), size)


@given(st.lists(st.tuples(*[st.integers(0, 9)] * 4), max_size=12), st.data(), st.sampled_from([0.3, 0.5, 0.7, 1.0]))
def test_box_nms_is_that_of_a_plain_loop(drawn, data, max_iou):
    boxes = [(x, y, x + w + 1, y + h + 1) for x, y, w, h in drawn]
    scores = data.draw(st.lists(st.sampled_from([0.1, 0.5, 0.9]), min_size=len(boxes), max_size=len(boxes)))

    def iou(a, b):
        across = max(0, min(a[2], b[2]) - max(a[0], b[0]) - 1)
        down = max(0, min(a[3], b[3]) - max(a[1], b[1]) - 1)
        areas = sum((box[2] - box[0] - 1) * (box[3] - box[1] - 1) for box in (a, b))
        shared = across * down
        return shared / (areas - shared) if areas > shared else 0.0

    kept = []
    for i in sorted(range(len(boxes)), key=lambda i: -scores[i]):
        if not any(iou(boxes[i], boxes[j]) > max_iou for j in kept):
            kept.append(i)
    assert box_nms(boxes, scores, max_iou).tolist() == kept


def regions(mask: np.ndarray) -> list[np.ndarray]:
    """Connected regions, sides and corners, by scikit-image."""
    labels = label(mask, connectivity=2)
    return [labels == number for number in range(1, labels.max() + 1)]


@settings(max_examples=150)
@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))), st.integers(0, 12))
def test_small_holes_are_filled_and_small_islands_removed(mask, limit):
    if not mask.any():
        return
    holes = [hole for hole in regions(~mask) if hole.sum() < limit]
    filled = mask | np.any([np.zeros_like(mask), *holes], axis=0)
    islands = regions(filled)
    largest = max(islands, key=np.sum)
    small = [island for island in islands if island.sum() < limit]
    gone = [island for island in small if island is not largest]
    expected = filled & ~np.any([np.zeros_like(mask), *gone], axis=0)
    cut = cut_masks(mask[None], np.ones(1, np.float32))
    box, part, changed = without_small_regions(tuple(int(x) for x in cut.boxes[0]), cut.parts[0], mask.shape, limit)
    result = np.zeros_like(mask)
    result[box[1] : box[3], box[0] : box[2]] = part
    assert_array_equal(result, expected)
    assert changed == bool(holes or small)


# --- a predictor whose answers are known ----------------------------------------------------------


class Drawn:
    """Has for a point the rectangles that contain it, from small to large; else nothing sure."""

    def __init__(self, *shapes, scores=(0.9, 0.9, 0.9)):
        self.shapes, self.scores, self.asked = shapes, scores, []
        self.identity = {"name": "drawn"}

    def find(self, crop, points, settings):
        self.asked.append((crop.shape[:2], len(points)))
        y, x = np.mgrid[: crop.shape[0], : crop.shape[1]]
        origin = crop[0, 0, :2].astype(int)  # images of these tests say where each pixel is
        for number, (px, py) in enumerate(points + origin):
            inside = [s for s in self.shapes if s[0] <= px < s[2] and s[1] <= py < s[3]]
            inside = (inside + [inside[-1]] * 3)[:3] if inside else []
            masks = np.array(
                [
                    (x + origin[0] >= s[0]) & (x + origin[0] < s[2])
                    & (y + origin[1] >= s[1]) & (y + origin[1] < s[3]) for s in inside
                ], bool,
            ).reshape(-1, *crop.shape[:2])  # fmt: skip
            scores = np.array(self.scores[: len(inside)], np.float32)
            outputs, number_of = np.arange(len(inside)), np.full(len(inside), number)
            yield PointMasks(masks, scores, np.full(len(inside), 0.95, np.float32), outputs, number_of)


def placed(height: int, width: int) -> np.ndarray:
    """An image whose red and green are x and y."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0], image[..., 1] = np.arange(width), np.arange(height)[:, None]
    return image


PLACED = placed(120, 200)
NO_CROPS = PointMaskSettings(points_per_side=8, crop_layers=0)
PART, THING, GROUP = (40, 40, 60, 60), (32, 32, 90, 90), (20, 10, 180, 100)


def boxes_of(levels) -> dict[str, list[tuple[int, ...]]]:
    return {name: sorted(map(tuple, masks.boxes.tolist())) for name, masks in levels.items()}


def test_levels_are_the_three_answers_of_a_point():
    segmenter = PointSegmenter(Drawn(PART, THING, GROUP), NO_CROPS)
    levels = segmenter.segment(PLACED)
    assert isinstance(segmenter, Segmenter)
    assert tuple(levels) == LEVELS
    found = boxes_of(levels)
    # where a point lies in the group alone, all three answers are the group; where it has more, a
    # contained mask goes by the rule of mask NMS
    assert found == {"default": [GROUP], "small": [GROUP], "medium": [GROUP], "large": [GROUP]}
    assert_allclose(levels["large"].scores, 0.9 * 0.95, rtol=1e-6)


def test_what_no_level_needs_is_not_used():
    one = replace(NO_CROPS, levels=("large",))
    assert one.outputs == (2,)
    levels = PointSegmenter(Drawn(PART, THING, GROUP), one).segment(PLACED)
    assert boxes_of(levels) == {"large": [GROUP]}
    assert NO_CROPS.outputs == (0, 1, 2)


def test_answers_below_the_thresholds_are_dropped():
    unsure = Drawn(THING, scores=(0.7, 0.71, 0.9))  # of 0.7 not above, of 0.71 x 0.95 mask NMS
    levels = PointSegmenter(unsure, NO_CROPS).segment(PLACED)
    assert boxes_of(levels) == {"default": [THING], "small": [], "medium": [], "large": [THING]}
    strict = replace(NO_CROPS, min_stability=0.96)
    assert not any(map(len, PointSegmenter(unsure, strict).segment(PLACED).values()))


def test_crops_are_asked_and_their_masks_put_in_place():
    """A thing between the points of the whole image, which those of a crop hit."""
    small = (52, 32, 61, 44)
    assert not any(small[0] <= x < small[2] and small[1] <= y < small[3] for x, y in point_grid(8) * (200, 120))
    predictor = Drawn(small)
    settings = replace(NO_CROPS, crop_layers=1, min_region=0)
    levels = PointSegmenter(predictor, settings).segment(PLACED)
    assert boxes_of(levels)["large"] == [small]
    assert predictor.asked == [((120, 200), 64)] + [((80, 120), 64)] * 4
    halved = replace(settings, crop_points_divisor=2)
    predictor.asked.clear()
    PointSegmenter(predictor, halved).segment(PLACED)
    assert predictor.asked[1] == ((80, 120), 16)


def test_coarse_to_fine_finds_what_a_fine_grid_finds_and_asks_less():
    shapes = [(5, 5, 45, 45), (60, 5, 110, 100), (130, 40, 190, 110), (150, 8, 156, 13)]
    settings = replace(NO_CROPS, points_per_side=32, min_region=0)
    grid, rounds = Drawn(*shapes), Drawn(*shapes)
    expected = PointSegmenter(grid, settings).segment(PLACED)
    levels = PointSegmenter(rounds, replace(settings, first_points_per_side=4)).segment(PLACED)
    assert boxes_of(levels) == boxes_of(expected) == dict.fromkeys(LEVELS, sorted(shapes))
    assert rounds.asked[0] == ((120, 200), 16)
    assert len(rounds.asked) == 4  # 4, 8, 16 and 32 a side
    assert sum(count for _, count in rounds.asked) < 0.8 * sum(count for _, count in grid.asked)


def test_what_a_part_explains_is_not_asked_again_and_what_only_a_group_does_is():
    inner, outer = (0, 0, 100, 120), (0, 0, 200, 120)
    parts, groups = Drawn(inner, outer), Drawn(inner, outer, scores=(0.1, 0.9, 0.9))
    settings = replace(NO_CROPS, points_per_side=4, first_points_per_side=2)
    PointSegmenter(parts, settings).segment(PLACED)
    assert parts.asked == [((120, 200), 4)]
    PointSegmenter(groups, settings).segment(PLACED)
    assert groups.asked == [((120, 200), 4), ((120, 200), 16)]


def test_what_stands_on_a_thing_is_asked_for_and_painted_over_the_mask_of_both():
    """Of a table the large mask has a cup on it, too; at the cup all three are the cup alone."""
    cup, table = (120, 20, 150, 50), (0, 0, 200, 120)
    on_table = np.zeros((120, 200), bool)
    on_table[20:50, 120:150] = True

    class Table(Drawn):
        def find(self, crop, points, settings):
            for found in super().find(crop, points, settings):
                if found.masks[0].all():
                    found.masks[:2] &= ~on_table
                else:
                    found.masks[:] = on_table
                yield found

    settings = replace(NO_CROPS, points_per_side=16, first_points_per_side=2, levels=("large",), min_region=0)
    for inner, expected in ((0.5, [table]), (0.0, [table, cup])):
        predictor = Table(cup, table)
        large = PointSegmenter(predictor, replace(settings, mask_inner=inner)).segment(PLACED)["large"]
        assert [count for _, count in predictor.asked] == [4, 2]  # first the table, then in the cup alone
        assert [tuple(box) for box in large.boxes.tolist()] == expected
    assert_array_equal(mask_maps({"large": large}).mask_ids[LEVELS.index("large")], on_table)


def test_no_more_points_are_asked_than_allowed_and_they_are_spread():
    nothing = Drawn()
    settings = replace(NO_CROPS, points_per_side=16, first_points_per_side=4, most_points=50)
    PointSegmenter(nothing, settings).segment(PLACED)
    assert [count for _, count in nothing.asked] == [16, 34]


@given(arrays(np.bool_, st.tuples(st.integers(1, 24), st.integers(1, 24))), st.integers(1, 9))
def test_open_points_are_those_of_the_grid_whose_cells_are_mostly_not_explained(explained, side):
    height, width = explained.shape
    expected = []
    for x, y in point_grid(side) * (width, height):
        x0, x1 = max(int(np.floor(x - width / 2 / side)), 0), min(int(np.ceil(x + width / 2 / side)), width)
        y0, y1 = max(int(np.floor(y - height / 2 / side)), 0), min(int(np.ceil(y + height / 2 / side)), height)
        if not explained[min(int(y), height - 1), min(int(x), width - 1)] and explained[y0:y1, x0:x1].mean() <= 0.5:
            expected.append((x, y))
    assert_array_equal(open_points(side, explained), np.array(expected).reshape(-1, 2))


def test_masks_are_painted_from_sure_to_unsure():
    """The order of the source: an unsure mask paints over a sure one that it overlaps."""

    class Two(Drawn):
        def find(self, crop, points, settings):
            masks = np.zeros((2, 120, 200), bool)
            masks[0, 20:80, 20:80], masks[1, 20:80, 60:120] = True, True
            yield PointMasks(masks, np.float32([0.8, 0.95]), np.float32([1, 1]), np.array([2, 2]), np.array([0, 1]))

    levels = PointSegmenter(Two(), NO_CROPS).segment(PLACED)
    assert_allclose(levels["large"].scores, [0.95, 0.8])
    ids = mask_maps({"large": levels["large"]}).mask_ids[0]
    assert (ids[50, 70], ids[50, 100], ids[50, 30]) == (1, 0, 1)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (50, 1), (2, 3)])
def test_images_of_few_pixels(size):
    levels = PointSegmenter(Drawn((0, 0, 99, 99)), PointMaskSettings(points_per_side=2)).segment(placed(*size))
    assert boxes_of(levels)["large"] == [(0, 0, size[1], size[0])]


def test_an_image_without_pixels_is_refused():
    with refused("an image of 3x0 pixels"):
        PointSegmenter(Drawn()).segment(np.zeros((0, 3, 3), np.uint8))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"points_per_side": 0}, "points_per_side: expected at least 1"),
        ({"first_points_per_side": 0}, "first_points_per_side: expected at least 1"),
        ({"most_points": 0}, "most_points: expected at least 1"),
        ({"crop_layers": 5}, "crop_layers"), ({"min_region": -1}, "min_region"),
        ({"crop_overlap": 1.0}, "crop_overlap"), ({"levels": ("huge",)}, "levels: expected some"),
        ({"levels": ()}, "levels"),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(changed, said):
    with refused(said):
        PointMaskSettings(**changed)


# --- images into the model and masks back ---------------------------------------------------------

FRAMES = [sam.ModelFrame(64, False), sam.ModelFrame(64, True)]


def test_sizes_in_the_square():
    shape = sam.ModelFrame(1024, False).scaled_size
    assert shape(1080, 1920) == (576, 1024)
    assert shape(3, 1000) == (3, 1024)
    assert shape(1, 4000) == (1, 1024)
    assert sam.ModelFrame(1024, True).scaled_size(1080, 1920) == (1024, 1024)


@given(st.integers(1, 64), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_pixels_are_normalised_and_the_rest_is_zero(height, seed):
    """Images that need no scaling, value by value; drawing each of 12,288 numbers by itself would take seconds."""
    image = np.random.default_rng(seed).integers(0, 256, (height, 64, 3), np.uint8)
    values = FRAMES[0].pixel_values(image)
    for c, (mean, std) in enumerate(zip((123.675, 116.28, 103.53), (58.395, 57.12, 57.375), strict=True)):
        expected = (image[..., c].astype(np.float64) - mean) / std
        assert_allclose(values[c, :height], expected, rtol=1e-5, atol=1e-6)
        assert (values[c, height:] == 0).all()


@pytest.mark.parametrize("frame", FRAMES, ids=["padded", "stretched"])
@pytest.mark.parametrize("size", [(48, 64), (96, 200), (1, 90), (37, 1), (64, 64)])
def test_points_and_masks_go_there_and_back_to_the_same_place(frame, size):
    """Logits that are the place in the model's square come back as the place of each pixel."""
    torch = pytest.importorskip("torch")
    height, width = size
    places = (torch.arange(16) + 0.5) * 4
    logits = torch.stack([places[None, :].expand(16, 16), places[:, None].expand(16, 16)])
    x, y = frame.enlarged(logits, height, width).numpy()
    assert x.shape == size
    rows, columns = np.mgrid[:height, :width]
    middles = np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], -1)
    expected = frame.scaled_points(middles, height, width)
    inner = ((expected > 3) & (expected < 61)).all(1)  # interpolation ends there
    if not frame.stretched:
        used = frame.scaled_size(height, width)
        inner &= (expected[:, 0] < used[1] - 1) & (expected[:, 1] < used[0] - 1)
    assert_allclose(x.ravel()[inner], expected[inner, 0], atol=0.01)
    assert_allclose(y.ravel()[inner], expected[inner, 1], atol=0.01)
    assert inner.any() or min(size) == 1


# --- tiny models ----------------------------------------------------------------------------------

SIZES = {"hidden_size": 16, "num_attention_heads": 2, "mlp_dim": 32}
DECODER = {**SIZES, "num_hidden_layers": 2, "iou_head_hidden_dim": 16, "iou_head_depth": 2}
PROMPTS = {"hidden_size": 16, "image_size": 64, "mask_input_channels": 4}
HIERA = {
    "model_type": "sam2_hiera_det_model", "hidden_size": 8, "num_attention_heads": 1,
    "image_size": [64, 64], "embed_dim_per_stage": [8, 16, 32, 64], "blocks_per_stage": [1, 1, 2, 1],
    "num_attention_heads_per_stage": [1, 2, 4, 8], "window_size_per_stage": [4, 4, 4, 2],
    "global_attention_blocks": [3], "window_positional_embedding_background_size": [4, 4],
}  # fmt: skip
SAM = {
    "vision_config": {
        **SIZES, "num_hidden_layers": 2, "image_size": 64, "patch_size": 8, "output_channels": 16,
        "num_pos_feats": 8, "global_attn_indexes": [1], "window_size": 4,
    },
    "prompt_encoder_config": {**PROMPTS, "patch_size": 8, "image_embedding_size": 8},
    "mask_decoder_config": DECODER,
}  # fmt: skip
SAM2 = {
    "vision_config": {
        "backbone_config": HIERA, "backbone_channel_list": [64, 32, 16, 8],
        "backbone_feature_sizes": [[16, 16], [8, 8], [4, 4]], "fpn_hidden_size": 16,
    },
    "prompt_encoder_config": {**PROMPTS, "patch_size": 16},
    "mask_decoder_config": DECODER,
}  # fmt: skip
VIDEO = {
    "image_size": 64, "memory_attention_hidden_size": 16, "memory_attention_num_layers": 1,
    "memory_attention_feed_forward_hidden_size": 16, "memory_encoder_hidden_size": 16,
    "memory_encoder_output_channels": 8, "memory_fuser_embed_dim": 16, "memory_fuser_num_layers": 1,
    "memory_fuser_intermediate_dim": 16, "mask_downsampler_embed_dim": 16,
    "memory_attention_rope_feat_sizes": [4, 4], "max_object_pointers_in_encoder": 2,
}  # fmt: skip
SAM3_VIT = {
    "model_type": "sam3_vit_model", "hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2,
    "num_attention_heads": 2, "image_size": 64, "pretrain_image_size": 32, "patch_size": 8, "window_size": 4,
    "global_attn_indexes": [1],
}  # fmt: skip
SAM3 = {
    "vision_config": {
        "model_type": "sam3_vision_model", "backbone_config": SAM3_VIT, "fpn_hidden_size": 16,
        "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]],
    },
    "prompt_encoder_config": {**PROMPTS, "patch_size": 8},
    "mask_decoder_config": DECODER,
}  # fmt: skip
# so that tens of masks of a model that knows nothing survive: nothing is sure or distinct
IMAGENET = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
LOOSE = PointMaskSettings(
    points_per_side=8, min_predicted_iou=-99.0, min_stability=0.3, stability_offset=0.012,
    max_box_iou=1.0, max_crop_box_iou=1.0, min_region=0, mask_iou=1.0, mask_score=-99.0,
    mask_inner=0.0, crop_layers=0,
)  # fmt: skip
IMAGE = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8).repeat(25, 0).repeat(25, 1)


@pytest.fixture(scope="module")
def library():
    torch = pytest.importorskip("torch", reason="needs torch")
    transformers = pytest.importorskip("transformers", reason="needs transformers")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    transformers.utils.logging.disable_progress_bar()
    yield transformers
    torch.set_num_threads(before)


def fill(model, seed: int) -> None:
    """Fixed random weights, larger than those of a fresh model; a tenth of each mask is inside."""
    import torch

    random = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, tensor in [*model.named_parameters(), *model.named_buffers()]:
            if "norm" in name or "timm" in name or not tensor.is_floating_point():
                continue
            spread = 1.0 if "positional" in name else (2.5 / tensor[0].numel()) ** 0.5
            spread = spread if tensor.ndim > 1 else 0.3
            tensor.copy_(torch.randn(tensor.shape, generator=random) * spread)
        decoder = model.mask_decoder
        decoder.upscale_conv2.weight[:, 0], decoder.upscale_conv2.bias[0] = 0, 1
        if hasattr(decoder, "conv_s0"):
            decoder.conv_s0.weight[0], decoder.conv_s0.bias[0] = 0, 0
        heads = [network.proj_out for network in decoder.output_hypernetworks_mlps]
        for head in heads:
            head.weight[0], head.bias[0] = 0, 0
        points = torch.tensor(point_grid(8) * 64, dtype=torch.float32)[None, :, None]
        noise = torch.randn((1, 3, 8, 8), generator=random)
        pixels = noise.repeat_interleave(8, 2).repeat_interleave(8, 3)
        masks = model(pixel_values=pixels, input_points=points).pred_masks[0]
        for i, head in enumerate(heads):  # channel 0 is gelu(1) everywhere
            head.bias[0] = -masks[:, max(i - 1, 0)].flatten().quantile(0.9) / 0.8413


def tiny_model(library, kind: str):
    config, model, sizes = {
        "sam": ("SamConfig", "SamModel", SAM), "sam2": ("Sam2Config", "Sam2Model", SAM2),
        "sam2_video": ("Sam2VideoConfig", "Sam2VideoModel", SAM2 | VIDEO),
        "sam3_tracker": ("Sam3TrackerConfig", "Sam3TrackerModel", SAM3),
    }[kind]  # fmt: skip
    return getattr(library, model)(getattr(library, config)(**sizes)).eval()


def saved(folder: Path, library, kind: str = "sam", seed: int = 0) -> Path:
    model = tiny_model(library, kind)
    if kind != "sam2_video":
        fill(model, seed)
    model.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module", params=["sam", "sam2", "sam3_tracker"])
def folder(request, library, tmp_path_factory) -> Path:
    return saved(tmp_path_factory.mktemp(request.param), library, request.param)


def loaded(folder: Path, how: PointMaskSettings = LOOSE) -> PointSegmenter:
    return sam.load_segmenter(str(folder), "cpu", how)


def test_tiny_models_make_masks(folder):
    segmenter = loaded(folder)
    levels = segmenter.segment(IMAGE)
    assert tuple(levels) == LEVELS
    assert len(levels["default"]) >= 20
    assert sum(len(levels[name]) for name in LEVELS[1:]) == len(levels["default"])
    for masks in levels.values():
        assert (masks.height, masks.width) == (150, 200)
        assert (masks.areas > 0).all()


@pytest.mark.slow
def test_equal_identity_means_equal_masks(folder, library, tmp_path):
    segmenter = loaded(folder)
    again = loaded(folder)
    assert segmenter.identity == again.identity
    json.dumps(segmenter.identity)
    for one, two in zip(segmenter.segment(IMAGE).values(), again.segment(IMAGE).values(), strict=True):
        assert_array_equal(one.boxes, two.boxes)
        assert_array_equal(one.scores, two.scores)
    kind = json.loads((folder / "config.json").read_text())["model_type"]
    other = sam.load_segmenter(str(saved(tmp_path / folder.name, library, kind, 1)), "cpu", LOOSE)
    assert other.identity["weights"] != segmenter.identity["weights"]
    assert {**other.identity, "weights": ""} == {**segmenter.identity, "weights": ""}
    stricter = loaded(folder, replace(LOOSE, min_stability=0.5))
    assert stricter.identity != segmenter.identity


def test_the_callers_torch_is_left_as_it_was(folder):
    import torch

    segmenter = loaded(folder)
    for _ in segmenter.predictor.find(IMAGE, point_grid(2) * 64, LOOSE):
        assert not torch.is_inference_mode_enabled()


def test_masks_do_not_depend_on_how_many_are_enlarged_at_a_time(folder, monkeypatch):
    segmenter = loaded(folder)
    whole = segmenter.segment(IMAGE)["default"]
    monkeypatch.setattr(sam, "_CHUNK_FLOATS", 2 * 150 * 200)
    sizes = [len(f.masks) for f in segmenter.predictor.find(IMAGE, point_grid(4) * 64, LOOSE)]
    assert max(sizes) <= 2
    few = segmenter.segment(IMAGE)["default"]
    assert_array_equal(few.boxes, whole.boxes)
    assert_array_equal(few.scores, whole.scores)


def test_points_that_do_not_fit_into_memory_are_asked_in_parts(folder, monkeypatch):
    import torch

    segmenter = loaded(folder)
    whole, expected = segmenter.predictor._answers, segmenter.segment(IMAGE)

    def narrow(features, points):
        if len(points) > 16:
            raise torch.cuda.OutOfMemoryError("tried to allocate 3 GiB")
        return whole(features, points)

    monkeypatch.setattr(segmenter.predictor, "_answers", narrow)
    for level, masks in segmenter.segment(IMAGE).items():
        assert_array_equal(masks.boxes, expected[level].boxes)


@pytest.mark.slow
def test_an_image_is_encoded_once_for_all_rounds_of_points(folder, monkeypatch):
    segmenter = loaded(folder, replace(LOOSE, first_points_per_side=1, crop_layers=1))
    encode, encoded = segmenter.predictor._features, []

    def counted(crops):
        encoded.append(crops[0].shape)
        return encode(crops)

    monkeypatch.setattr(segmenter.predictor, "_features", counted)
    first = segmenter.segment(IMAGE)
    assert len(encoded) == 5  # the image and four crops
    again = segmenter.segment(IMAGE)
    for level, masks in first.items():
        assert_array_equal(masks.boxes, again[level].boxes)


def test_answers_are_those_of_the_bare_model(folder, library):
    """One point at a time through the model's own call, on an image that fills the square."""
    import torch

    image = IMAGE[:64, :64].copy()
    points = point_grid(3) * 64
    segmenter = loaded(folder)
    settings = replace(LOOSE, min_stability=0.0)
    found = list(segmenter.predictor.find(image, points, settings))
    masks = np.concatenate([f.masks for f in found])
    scores = np.concatenate([f.predicted_iou for f in found])
    model = getattr(library, segmenter.identity["architecture"]).from_pretrained(folder).eval()
    colors = ([0.5] * 3, [0.5] * 3) if "3" in segmenter.identity["architecture"] else IMAGENET
    mean, std = (np.array(values)[:, None, None] for values in colors)
    pixels = torch.tensor((image.transpose(2, 0, 1) / 255.0 - mean) / std).float()[None]
    for i, point in enumerate(points):
        with torch.no_grad():
            answer = model(pixel_values=pixels, input_points=torch.tensor(point).float()[None, None, None])
        logits = torch.nn.functional.interpolate(answer.pred_masks[0], (64, 64), mode="bilinear")
        assert_allclose(scores[3 * i : 3 * i + 3], answer.iou_scores[0, 0], atol=1e-4)
        differ = masks[3 * i : 3 * i + 3] != (logits[0] > 0).numpy()
        assert differ.mean() < 1e-3


def test_the_models_of_video_checkpoints_are_loaded(library, tmp_path):
    """What Meta's SAM 2 folders on the hub say they are."""
    folder = saved(tmp_path, library, "sam2_video")
    assert json.loads((folder / "config.json").read_text())["model_type"] == "sam2_video"
    segmenter = loaded(folder)
    assert segmenter.identity["architecture"] == "Sam2Model"
    segmenter.segment(IMAGE)


def test_the_tracker_of_a_sam_3_that_holds_a_detector_too(library, tmp_path):
    """As facebook/sam3 is laid out: both share the image encoder, each with a neck of its own."""
    import torch
    from safetensors.torch import save_file

    sizes = {"hidden_size": 16, "num_attention_heads": 2}
    layers = {**sizes, "num_layers": 1, "intermediate_size": 32}
    words = {
        "vocab_size": 64,
        "bos_token_id": 0,
        "eos_token_id": 1,
        "max_position_embeddings": 12,
        "projection_dim": 16,
    }
    detector = {
        "vision_config": SAM3["vision_config"], "geometry_encoder_config": layers, "detr_encoder_config": layers,
        "detr_decoder_config": {**layers, "num_queries": 4}, "mask_decoder_config": sizes,
        "text_config": {**sizes, **words, "intermediate_size": 32, "num_hidden_layers": 1},
    }  # fmt: skip
    config = library.Sam3VideoConfig(detector_config=detector, tracker_config={**SAM3, **VIDEO})
    torch.manual_seed(0)
    both = library.Sam3VideoModel(config).eval()
    config.save_pretrained(tmp_path)
    weights = both.state_dict()
    save_file({name: tensor.contiguous() for name, tensor in weights.items()}, tmp_path / "model.safetensors")
    segmenter = loaded(tmp_path)
    assert segmenter.identity["architecture"] == "Sam3TrackerModel"
    assert (segmenter.identity["side"], segmenter.identity["mean"]) == (64, [0.5] * 3)
    segmenter.segment(IMAGE)
    alone = segmenter.predictor.model.state_dict()
    neck = "neck.fpn_layers.0.proj1.weight"
    for ours, theirs in (
        ("mask_decoder.iou_token.weight", "tracker_model.mask_decoder.iou_token.weight"),
        (f"vision_encoder.{neck}", f"tracker_{neck}"),
        ("vision_encoder.backbone.layer_norm.weight", "detector_model.vision_encoder.backbone.layer_norm.weight"),
    ):
        assert torch.equal(alone[ours], weights[theirs])
    assert not torch.equal(alone[f"vision_encoder.{neck}"], weights[f"detector_model.vision_encoder.{neck}"])


def test_edgetam_says_what_it_needs(library, monkeypatch, tmp_path):
    (tmp_path / "config.json").write_text('{"model_type": "edgetam_video"}')
    monkeypatch.setattr(sam, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match="needs timm and torchvision, not installed: pip install timm torchv"):
        sam.load_segmenter(str(tmp_path), "cpu")


@pytest.mark.oracle
def test_edgetam_makes_masks(library):
    if find_spec("timm") is None:
        pytest.skip("needs timm")
    run_alone("timm_models.py", "edgetam")


def test_pixels_are_normalised_as_the_folder_says(library, tmp_path):
    folder = saved(tmp_path, library)
    config = folder / "preprocessor_config.json"
    config.write_text('{"image_mean": [0.5, 0.25, 0], "image_std": [1, 2, 4]}')
    segmenter = loaded(folder)
    values = segmenter.predictor.frame.pixel_values(np.full((64, 64, 3), 255, np.uint8))
    assert_allclose(values[:, 0, 0], [0.5, 0.375, 0.25])
    assert segmenter.identity["std"] == [1, 2, 4]
    config.rename(folder / "processor_config.json").write_text(
        '{"image_processor": {"image_mean": [0.1, 0.2, 0.3]}}'  # as transformers 5 saves it
    )
    segmenter = loaded(folder)
    assert segmenter.identity["mean"] == [0.1, 0.2, 0.3]
    for wrong in ('{"image_std": [1, 0, 1]}', '{"image_mean": [1, 2]}', "[]"):
        config.write_text(wrong)
        with malformed(r"preprocessor_config\.json"):
            sam.load_segmenter(str(folder), "cpu")


# --- beside transformers' own ---------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.oracle
def test_masks_are_those_of_the_pipeline_of_transformers(library, tmp_path):
    """Same masks. With crops its box NMS is another, one over all crops by predicted IoU; that of
    segment-anything, which is ours, goes crop by crop and then prefers small crops. So there the
    masks before NMS are compared, and after its NMS done on ours."""
    folder = saved(tmp_path, library)
    np.save(folder / "image.npy", IMAGE)
    common = {
        "points_per_crop": 8, "pred_iou_thresh": -99, "stability_score_thresh": 0.3,
        "stability_score_offset": 0.012,
    }  # fmt: skip
    calls = {
        "all": {"crops_nms_thresh": 1.0}, "distinct": {"crops_nms_thresh": 0.98},
        "crops": {"crops_nms_thresh": 1.0, "crops_n_layers": 1},
        "crops_distinct": {"crops_nms_thresh": 0.98, "crops_n_layers": 1},
    }  # fmt: skip
    run_pipeline(folder, {name: {**common, **call} for name, call in calls.items()})
    theirs = {name: np.load(folder / f"{name}.npz")["masks"] for name in calls}

    def ours(**changed):
        s = replace(LOOSE, levels=("default",), **changed)
        masks = loaded(folder, s).segment(IMAGE)["default"]
        return [masks.full(i) for i in range(len(masks))]

    assert len(theirs["all"]) >= 50
    assert pixels_off(theirs["all"], ours()) <= 1
    assert 5 < len(theirs["distinct"]) < len(theirs["all"])
    assert pixels_off(theirs["distinct"], ours(max_box_iou=0.98)) <= 1
    assert len(theirs["crops"]) > len(theirs["all"])
    assert pixels_off(theirs["crops"], ours(crop_layers=1)) <= 1
    assert pixels_off(theirs["crops_distinct"], once_over_all_crops(folder, 0.98)) <= 1


def pixels_off(theirs: Sequence[np.ndarray], ours: Sequence[np.ndarray]) -> int:
    """By how many pixels masks differ at most, each from the one that it is: of 30,000, one may lie next to zero, where
    the last bit of a product decides, which is another one on another processor."""
    assert len(theirs) == len(ours)
    off = np.array([[np.count_nonzero(one != other) for other in ours] for one in theirs])
    return int(off[linear_sum_assignment(off)].max())


def run_pipeline(folder: Path, calls) -> None:
    run_alone("sam_pipeline.py", str(folder), json.dumps(calls))


def run_alone(script: str, *arguments: str) -> None:
    """In a process of its own, where modules are stand-ins that no other test should see."""
    command = [sys.executable, str(SUPPORT / script), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def once_over_all_crops(folder: Path, max_iou: float) -> list[np.ndarray]:
    segmenter = loaded(folder)
    crops = crop_boxes(*IMAGE.shape[:2], 1, LOOSE.crop_overlap)
    found = [c for layer, crop in crops for c in segmenter._in_crop(IMAGE, crop, layer)]
    masks = []
    for i in box_nms([c.box for c in found], [c.predicted_iou for c in found], max_iou):
        mask = np.zeros(IMAGE.shape[:2], bool)
        x0, y0, x1, y1 = found[i].box
        mask[y0:y1, x0:x1] = found[i].part
        masks.append(mask)
    return masks


# --- what cannot be loaded ------------------------------------------------------------------------


def test_a_folder_that_is_no_model(library, tmp_path):
    with refused(r"no config\.json"):
        sam.load_segmenter(str(tmp_path), "cpu")


def test_other_architectures(library, tmp_path):
    (tmp_path / "config.json").write_text('{"model_type": "clip"}')
    with refused(r"is a 'clip', expected SAM, SAM 2, SAM 3 or EdgeTAM.*sam2\.1-hiera-tiny"):
        sam.load_segmenter(str(tmp_path), "cpu")


def test_missing_weights(folder, library, tmp_path):
    from safetensors.numpy import load_file, save_file

    (tmp_path / "config.json").write_bytes((folder / "config.json").read_bytes())
    with refused(r"no model\.safetensors"):
        sam.load_segmenter(str(tmp_path), "cpu")
    tensors = load_file(folder / "model.safetensors")
    gone = next(name for name in tensors if "iou_prediction_head" in name)
    del tensors[gone]
    save_file(tensors, tmp_path / "model.safetensors", {"format": "pt"})
    with malformed(f"lack 1 tensors.*{gone.removeprefix('tracker_model.')}"):
        sam.load_segmenter(str(tmp_path), "cpu")
    (tmp_path / "model.safetensors").write_bytes(b"\0" * 40)
    with malformed("damaged or incomplete"):
        sam.load_segmenter(str(tmp_path), "cpu")


def test_a_model_that_is_not_here_and_no_network(library, monkeypatch, tmp_path):
    constants = pytest.importorskip("huggingface_hub.constants")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(DrSplatError, match=r"sam2\.1-hiera-tiny: not in the local cache.*network"):
        sam.load_segmenter("facebook/sam2.1-hiera-tiny", "cpu")


def test_devices_that_are_not_here(folder, library, monkeypatch):
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(MissingExtraError, match="device 'cuda'"):
        sam.load_segmenter(str(folder), "cuda")
    with refused("device: expected one of auto, cpu, cuda, mps"):
        sam.load_segmenter(str(folder), "tpu")


def test_without_transformers_the_message_has_the_line(monkeypatch):
    from drsplat.photos.models import libraries

    monkeypatch.setattr(libraries, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r'pip install .*\[models\]"'):
        sam.load_segmenter("facebook/sam-vit-huge")
