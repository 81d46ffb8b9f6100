"""Our evaluation against slow oracles of the programs whose numbers papers print, pair by pair.

The oracles are written from what these programs do, not from their code: OpenGaussian's selection on LERF-OVS and
classes on ScanNet, LangSplat's truth masks and localization. Where ours differs on purpose, a test shows that the
difference is that and nothing else.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.random import default_rng
from numpy.testing import assert_allclose
from PIL import Image

from drsplat.evaluation import scannet_points
from drsplat.evaluation.lerf_ovs import PEAKS, PROTOCOL, LerfScene, peak, score
from drsplat.evaluation.predictions import Manifest, mask_path, write_mask
from drsplat.evaluation.pseudo_labels import LabelledPoints
from drsplat.evaluation.scannet import LabelSet, ScannetScene
from drsplat.evaluation.scorers import Scorer
from drsplat.formats.lerf_ovs import LabelledFrame, fill_polygon, read_lerf_labels
from scenes import random_gaussians

pytestmark = pytest.mark.oracle
few = settings(derandomize=True, max_examples=40)
CATEGORIES = ("mug", "plate (blue)", "toy cat")
OPENCV_QUALITY = 95  # of a JPEG: what LangSplat's truth is written with
OCCUPIED = 10  # of 255, above which OpenGaussian takes a pixel of a mask for the object
LANGSPLAT_WINDOW = 30

Pixels = set[tuple[int, int]]
Pair = tuple[str, str]


# --- selection on LERF-OVS


def polygon_pixels(corners: list[tuple[int, int]]) -> Pixels:
    """Return the pixels inside of a polygon by the even-odd rule, and those of its edges, as OpenCV fills it."""
    edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
    pixels = set()
    for y in range(min(y for _, y in corners), max(y for _, y in corners) + 1):
        crossings = sorted(
            x1 + Fraction((y - y1) * (x2 - x1), y2 - y1) for (x1, y1), (x2, y2) in edges if (y1 <= y) != (y2 <= y)
        )
        for left, right in zip(crossings[::2], crossings[1::2], strict=True):
            pixels |= {(x, y) for x in range(math.ceil(left), math.floor(right) + 1)}
    for edge in edges:
        pixels |= set(edge_pixels(*sorted(edge)))
    return pixels


def edge_pixels(left: tuple[int, int], right: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield a pixel for each step along the longer axis; the other coordinate is rounded, halves towards `left`."""
    dx, dy = right[0] - left[0], right[1] - left[1]
    steps = max(dx, abs(dy), 1)
    toward = 1 if dy >= 0 else -1
    for step in range(steps + 1):
        x, y = (math.ceil(Fraction(step * span, steps) - Fraction(1, 2)) for span in (dx, abs(dy)))
        yield left[0] + x, left[1] + toward * y


def occupied(path: Path) -> Pixels:
    """Return the pixels that OpenGaussian takes for the object: those above 10 in grey."""
    picture = Image.open(path).convert("L")
    return {(x, y) for x in range(picture.width) for y in range(picture.height) if picture.getpixel((x, y)) > OCCUPIED}


def opengaussian_iou(truth: Path, prediction: Path) -> float:
    """Return the IoU of two pictures; 0 without a prediction, and where both are empty."""
    if not prediction.exists():
        return 0.0
    expected, predicted = occupied(truth), occupied(prediction)
    union = expected | predicted
    return float(Fraction(len(expected & predicted), len(union))) if union else 0.0


def langsplat_truth(labels: Path, folder: Path) -> dict[Pair, Path]:
    """Write a JPEG of each labelled pair: all polygons of the category in white on black."""
    paths = {}
    for path in sorted(labels.glob("*.json")):
        document = json.loads(path.read_text())
        for category in {entry["category"] for entry in document["objects"]}:
            pixels = np.zeros((document["info"]["height"], document["info"]["width"]), np.uint8)
            for entry in document["objects"]:
                if entry["category"] == category:
                    for x, y in polygon_pixels([(x, y) for x, y in entry["segmentation"]]):
                        pixels[y, x] = 255
            paths[path.stem, category] = folder / f"{path.stem} {category}.jpg"
            Image.fromarray(pixels).save(paths[path.stem, category], quality=OPENCV_QUALITY)
    return paths


def write_labels(folder: Path, frames: list[dict[str, Any]]) -> Path:
    folder.mkdir()
    for number, frame in enumerate(frames):
        (folder / f"frame_{number:05d}.json").write_text(json.dumps(frame))
    return folder


def write_predictions(
    folder: Path, pairs: list[tuple[LabelledFrame, str]], masks: list[np.ndarray | None]
) -> dict[Pair, Path]:
    """Write the masks of one choice of thresholds, but for those that are None."""
    Manifest(PROTOCOL, "made", "room", {"fixed": "made"}).write(folder)
    paths = {}
    for (frame, category), mask in zip(pairs, masks, strict=True):
        paths[frame.name, category] = mask_path(folder, "room", "fixed", frame.name, category)
        if mask is not None:
            write_mask(paths[frame.name, category], mask)
    return paths


@st.composite
def labelled_frames(draw: st.DrawFn) -> dict[str, Any]:
    """A frame with one to four objects, some of the same category."""
    width, height = draw(st.integers(6, 30)), draw(st.integers(6, 24))
    corner = st.tuples(st.integers(0, width - 1), st.integers(0, height - 1))
    objects = draw(
        st.lists(
            st.fixed_dictionaries(
                {
                    "category": st.sampled_from(CATEGORIES),
                    "segmentation": st.lists(corner, min_size=3, max_size=6),
                    "bbox": st.tuples(corner, corner).map(lambda two: [*two[0], *two[1]]),
                }
            ),
            min_size=1,
            max_size=4,
        )
    )
    return {"info": {"width": width, "height": height}, "objects": objects}


def masks_of(frame: LabelledFrame, category: str) -> st.SearchStrategy[np.ndarray | None]:
    """None, nothing, the truth, the truth with changes, or anything."""
    truth = frame.mask(category)
    anything = arrays(bool, truth.shape)
    return st.one_of(
        st.just(None), st.just(np.zeros_like(truth)), st.just(truth), anything.map(truth.__xor__), anything
    )


@few
@given(st.lists(labelled_frames(), min_size=1, max_size=3), st.data())
def test_selection_is_scored_as_by_opengaussian(tmp_path_factory, frames, data):
    """Exactly the same IoU of each pair, with truth as LangSplat writes it, and so the same means."""
    folder = tmp_path_factory.mktemp("selection")
    labels = write_labels(folder / "labels", frames)
    scene = LerfScene("room", read_lerf_labels(labels), {})
    masks = [data.draw(masks_of(frame, category)) for frame, category in scene.pairs]
    predictions = write_predictions(folder, scene.pairs, masks)
    truth = langsplat_truth(labels, folder)
    expected = {pair: opengaussian_iou(truth[pair], predictions[pair]) for pair in truth}

    result = score([scene], folder)
    assert {(row["frame"], row["category"]): row["iou"]["fixed"] for row in result["queries"]} == expected
    numbers, ious = result["columns"]["fixed"]["query_micro"], list(expected.values())
    assert numbers["miou"] == pytest.approx(sum(ious) / len(ious), abs=1e-12)
    for least in (0.25, 0.5):
        share = sum(iou > least for iou in ious) / len(ious)
        assert numbers[f"acc@{least:g}"] == pytest.approx(share, abs=1e-12)


def test_an_iou_of_exactly_a_threshold_is_not_above_it(tmp_path):
    """OpenGaussian's Acc counts strictly greater IoUs: here of 1/4, of 1/2, and of one pixel more than either."""
    square = {"category": "mug", "segmentation": [[0, 0], [15, 0], [15, 15], [0, 15]]}
    labels = write_labels(tmp_path / "labels", [{"info": {"width": 16, "height": 16}, "objects": [square]}] * 4)
    scene = LerfScene("room", read_lerf_labels(labels), {})
    masks = [np.arange(256).reshape(16, 16) < count for count in (64, 65, 128, 129)]
    predictions = write_predictions(tmp_path, scene.pairs, masks)
    ious = [opengaussian_iou(path, predictions[pair]) for pair, path in langsplat_truth(labels, tmp_path).items()]
    assert ious == [1 / 4, 65 / 256, 1 / 2, 129 / 256]
    numbers = score([scene], tmp_path)["columns"]["fixed"]["query_micro"]
    assert (numbers["acc@0.25"], numbers["acc@0.5"]) == (3 / 4, 1 / 4)


corners_within = st.lists(st.tuples(st.integers(0, 39), st.integers(0, 29)), min_size=3, max_size=8)


@few
@given(corners_within)
def test_polygons_are_filled_as_by_the_oracle(corners):
    filled = fill_polygon(np.array(corners), 40, 30)
    assert {(x, y) for y, x in np.argwhere(filled).tolist()} == polygon_pixels(corners)


@few
@given(corners_within)
def test_polygons_are_filled_as_by_opencv(corners):
    """All pixels from OpenCV 5 on; before, edges were drawn a little otherwise."""
    cv2 = pytest.importorskip("cv2")
    theirs = np.zeros((30, 40), np.uint8)
    cv2.fillPoly(theirs, [np.array(corners, np.int32)], 1)
    differs = fill_polygon(np.array(corners), 40, 30) != theirs.astype(bool)
    if int(cv2.__version__.split(".")[0]) >= 5:
        assert not differs.any()
    else:
        assert differs.mean() < 0.02


# --- localization on LERF-OVS


def langsplat_peaks(relevancy: np.ndarray, window: int, border: str) -> list[tuple[int, int]]:
    """Return each (x, y) where the mean over a window is highest.

    border: what lies beyond the picture, a mode of `numpy.pad`. OpenCV's `reflect` does not repeat the outermost
    pixels; a window of an even side reaches one pixel further to the left and to the top.
    """
    before, after = window // 2, window - 1 - window // 2
    padded = np.pad(relevancy.astype(np.float64), (before, after), border)
    height, width = relevancy.shape
    means = {(x, y): padded[y : y + window, x : x + window].mean() for y in range(height) for x in range(width)}
    highest = max(means.values())
    return [place for place, mean in means.items() if mean >= highest - 1e-12]


def langsplat_hit(peaks: list[tuple[int, int]], boxes: list[list[float]]) -> bool:
    """Return whether any of the peaks lies in any of the boxes, whichever corners these were drawn from."""
    return any(
        min(x1, x2) <= x <= max(x1, x2) and min(y1, y2) <= y <= max(y1, y2)
        for x1, y1, x2, y2 in boxes
        for x, y in peaks
    )


def localized(tmp_path: Path, relevancy: np.ndarray, boxes: list[list[float]]) -> bool:
    """Return whether our protocol counts a map of scores as localized, by the files that it writes and reads."""
    height, width = relevancy.shape
    outline = [[0, 0], [width - 1, 0], [width - 1, height - 1]]
    objects = [{"category": "mug", "segmentation": outline, "bbox": box} for box in boxes]
    labels = write_labels(tmp_path / "labels", [{"info": {"width": width, "height": height}, "objects": objects}])
    scene = LerfScene("room", read_lerf_labels(labels), {})
    write_predictions(tmp_path, scene.pairs, [None])
    (tmp_path / "room" / PEAKS).write_text(json.dumps({"frame_00000": {"mug": peak(relevancy)}}))
    return bool(score([scene], tmp_path)["columns"]["fixed"]["query_micro"]["localization"])


sixteenths = st.integers(0, 16).map(lambda k: k / 16)
maps = st.tuples(st.integers(8, 24), st.integers(34, 70)).flatmap(lambda s: arrays(np.float32, s, elements=sixteenths))


@pytest.mark.slow
@few
@given(maps, st.data())
def test_localization_is_that_of_langsplat_but_for_window_and_border(tmp_path_factory, relevancy, data):
    """With our window and nothing beyond the picture their rule hits where ours does; ours takes one of equal peaks."""
    height, width = relevancy.shape
    corner = st.tuples(st.integers(0, width - 1), st.integers(0, height - 1))
    boxes = data.draw(st.lists(st.tuples(corner, corner).map(lambda two: [*two[0], *two[1]]), min_size=1, max_size=3))
    hit = localized(tmp_path_factory.mktemp("peak"), relevancy, boxes)
    if not relevancy.any():
        assert not hit
        return
    peaks = langsplat_peaks(relevancy, round(width / 33) | 1, "constant")
    (x, y) = peak(relevancy) or (-1, -1)
    assert (x, y) in peaks
    assert hit == langsplat_hit([(int(x), int(y))], boxes)
    assert hit == langsplat_hit(peaks, boxes) or len(peaks) > 1


def test_the_oracle_smooths_as_opencv_does():
    cv2 = pytest.importorskip("cv2")
    relevancy = default_rng(0).random((50, 70)).astype(np.float32)
    for window in (3, LANGSPLAT_WINDOW):
        theirs = cv2.filter2D(relevancy, -1, np.full((window, window), 1 / window**2))
        y, x = np.unravel_index(theirs.argmax(), theirs.shape)
        assert (x, y) in langsplat_peaks(relevancy, window, "reflect")


@pytest.mark.parametrize("seed", range(6))
def test_things_are_localized_alike_at_the_size_of_lerf(seed):
    """Photos of 990 x 731, the window as published, 30 pixels and mirrored borders: one hit is the other."""
    cv2 = pytest.importorskip("cv2")
    rng = default_rng(seed)
    things = [(x, y, 25 + 20 * rng.random()) for x, y in rng.uniform((60, 60), (930, 670), (6, 2))]
    ys, xs = np.mgrid[:731, :990]
    heights = rng.uniform(0.3, 0.9, len(things))
    relevancy = sum(
        height * np.exp(-((xs - x) ** 2 + (ys - y) ** 2) / (2 * size**2))
        for height, (x, y, size) in zip(heights, things, strict=True)
    )
    relevancy = (relevancy + 0.05 * rng.standard_normal(relevancy.shape)).astype(np.float32)
    smooth = cv2.filter2D(relevancy, -1, np.full((LANGSPLAT_WINDOW,) * 2, 1 / LANGSPLAT_WINDOW**2))
    theirs = [(int(x), int(y)) for y, x in np.argwhere(smooth == smooth.max())]
    ours = peak(relevancy)
    hits = [[langsplat_hit([place], [[x - 30, y - 30, x + 30, y + 30]]) for x, y, _ in things]
            for place in ((int(ours[0]), int(ours[1])), theirs[0])]  # fmt: skip
    assert hits[0] == hits[1]
    assert any(hits[0])


# --- classes on ScanNet


def opengaussian_classes(truth: list[int], predicted: list[int], count: int) -> tuple[dict[int, Fraction], ...]:
    """Return IoU and accuracy of each class that the truth has; rows without truth count for nothing."""
    rows = [(t, p) for t, p in zip(truth, predicted, strict=True) if t]
    ious, accuracies = {}, {}
    for label in range(1, count + 1):
        both = sum(t == p == label for t, p in rows)
        either = sum(label in row for row in rows)
        of_truth = sum(t == label for t, _ in rows)
        if of_truth:
            ious[label], accuracies[label] = Fraction(both, either), Fraction(both, of_truth)
    return ious, accuracies


def mean_of(values: dict[int, Fraction]) -> float:
    return float(sum(values.values()) / len(values)) if values else math.nan


def frozen_scene(truth: list[int], opacities: list[float], count: int) -> ScannetScene:
    names = tuple(f"class {label}" for label in range(1, count + 1))
    gaussians = random_gaussians(len(truth))
    gaussians = replace(gaussians, opacities=np.array(opacities, np.float32))
    labels = LabelSet("made", tuple(range(1, count + 1)), names, names)
    return ScannetScene("scene0000_00", LabelledPoints(gaussians.means, np.array(truth, np.int32)), labels, gaussians)


@few
@given(st.integers(2, 19), st.data())
def test_classes_are_scored_as_by_opengaussian(tmp_path_factory, count, data):
    """Of Gaussians at the points, without faint ones: mIoU and mAcc over the classes that are there."""
    label = st.integers(0, count)
    rows = data.draw(st.lists(st.tuples(label, label, st.sampled_from([0.05, 0.1, 0.9])), min_size=2, max_size=60))
    truth, predicted, opacities = (list(column) for column in zip(*rows, strict=True))
    scene, folder = frozen_scene(truth, opacities, count), tmp_path_factory.mktemp("classes")

    def scores(text):
        """0.5 for the predicted class; no score at all for rows that have none."""
        chosen = np.array(predicted)
        right = chosen == 1 + scene.labels.prompts.index(text)
        return np.where(chosen == 0, np.nan, np.where(right, 0.5, 0.1)).astype(np.float32)

    scannet_points.predict(scene, Scorer("made", len(rows), scores, 0.5, ()), folder)
    record = scannet_points.score([scene], folder)["segmentation"]["by_scene"][scene.name]

    visible = [0 if opacity < 0.1 else t for t, opacity in zip(truth, opacities, strict=True)]
    ious, accuracies = opengaussian_classes(visible, predicted, count)
    assert record["classes"] == {f"class {k}": {"iou": float(ious[k]), "acc": float(accuracies[k])} for k in ious}
    assert_allclose([record["miou"], record["macc"]], [mean_of(ious), mean_of(accuracies)], rtol=1e-12)
