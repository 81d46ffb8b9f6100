"""scannet-points@1, scannet-volume@1 and voxel@1 on small written scenes, and their laws."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from test_evaluation_pseudo_labels import random_points
from test_metrics import weighted_iou

from drsplat.errors import MismatchError
from drsplat.evaluation import pseudo_labels, scannet_points, scannet_volume, voxel
from drsplat.evaluation.predictions import AUTOMATIC, FIXED, Manifest, best_sweep, sweep_weighted_ious
from drsplat.evaluation.scannet import LabelSet, ScannetScene, read_nyu40_scene, read_raw_category_scene, scores_path
from drsplat.evaluation.scorers import Scorer
from drsplat.formats.npy import write_npy
from drsplat.formats.ply import write_vertices
from drsplat.scene.gaussians import Gaussians
from refusing import malformed, refused
from scenes import random_gaussians
from twins import evaluation as reference

few = settings(derandomize=True, max_examples=25)
LABELS = LabelSet("mine", (1, 2, 7), ("wall", "floor", "table"), ("wall", "floor", "table"))
NYU40 = np.uint16([40, 1, 2, 7])  # class 0 to 3
COUNT = 400


def write_scene(folder: Path, seed: int = 0, size: float = 0.3) -> tuple[Path, Gaussians]:
    """A scene's folder and Gaussians, most of which have a point near."""
    place = folder / f"scene{seed:04d}_00"
    place.mkdir(parents=True)
    points = random_points(3000, 4, seed)
    columns = {axis: points.positions[:, k] for k, axis in enumerate("xyz")}
    labels = NYU40[points.labels]
    write_vertices(place / f"{place.name}_vh_clean_2.labels.ply", {**columns, "label": labels})
    segments = {"segIndices": points.labels.tolist()}
    names = ["lamp", "wall", "office chair", "table"]
    groups = [{"segments": [k], "label": name} for k, name in enumerate(names)]
    (place / f"{place.name}_vh_clean_2.0.010000.segs.json").write_text(json.dumps(segments))
    (place / f"{place.name}.aggregation.json").write_text(json.dumps({"segGroups": groups}))
    table = "id\traw_category\n1\twall\n5\toffice chair\n4\ttable\n"
    (folder / "scannetv2-labels.combined.tsv").write_text(table)
    return place, random_gaussians(COUNT, seed, size=size)


@pytest.fixture
def scene(tmp_path) -> ScannetScene:
    return read_nyu40_scene(*rearranged(write_scene(tmp_path / "data")))


def rearranged(written: tuple[Path, Gaussians]) -> tuple[Path, LabelSet, Gaussians]:
    return written[0], LABELS, written[1]


def knowing(scene: ScannetScene, truth: np.ndarray | None = None) -> Scorer:
    """Scores 0.9 for the right class and 0.1 for the others; the classes of the scene by default."""
    right = scene.pseudo_labels if truth is None else truth

    def scores(text: str) -> np.ndarray:
        return np.where(right == 1 + LABELS.prompts.index(text), 0.9, 0.1).astype(np.float32)

    return Scorer("knowing", len(right), scores, 0.5, (0.05, 0.4, 0.95), {"by": "hand"})


def ignorant(scene: ScannetScene) -> Scorer:
    nothing = np.full(len(scene.gaussians), np.nan, np.float32)
    return replace(knowing(scene), name="ignorant", scores=lambda _: nothing)


def test_scene_is_read(scene):
    assert scene.name == "scene0000_00"
    expected = random_points(3000, 4, 0).labels
    assert_array_equal(scene.points.labels, expected)
    assert set(np.unique(scene.pseudo_labels)) == {0, 1, 2, 3}
    assert_allclose(scene.significance, scene.gaussians.scales.prod(1) * scene.gaussians.opacities, rtol=1e-5)


def test_raw_categories_are_classes_too(tmp_path):
    place, gaussians = write_scene(tmp_path)
    of_200 = LabelSet("200", (1, 5), ("wall", "office chair"), ("wall", "office chair"))
    raw = read_raw_category_scene(place, of_200, gaussians)
    labels = random_points(3000, 4, 0).labels
    assert_array_equal(raw.points.labels, np.array([0, 1, 2, 0])[labels])  # a table is not asked for


PERFECT_LOCATION = {"miou": 1.0, "iou>0.15": 1.0, "iou>0.30": 1.0, "iou>0.45": 1.0}


def test_a_perfect_prediction_scores_one(scene, tmp_path):
    scannet_volume.predict(scene, knowing(scene), tmp_path)
    result = scannet_volume.score([scene], tmp_path)
    assert result["segmentation"]["scene_macro"] == {"miou": 1, "macc": 1}
    for column in ("fixed", "tuned on test"):
        assert result["localization"][column]["scene_macro"] == PERFECT_LOCATION
    assert result["thresholds"]["tuned on test"] == "0.4 for all queries"
    assert voxel.score([scene], tmp_path, side=0.2)["segmentation"]["scene_macro"]["miou"] == 1


def test_an_empty_prediction_scores_zero(scene, tmp_path):
    scannet_volume.predict(scene, ignorant(scene), tmp_path)
    result = scannet_volume.score([scene], tmp_path)
    assert result["segmentation"]["scene_macro"] == {"miou": 0, "macc": 0}
    for column in result["localization"].values():
        assert set(column["query_micro"].values()) == {0}
    assert voxel.score([scene], tmp_path, side=0.2)["segmentation"]["scene_macro"]["miou"] == 0


def test_missing_files_count_zero(scene, tmp_path):
    scannet_volume.predict(scene, knowing(scene), tmp_path)
    (tmp_path / scene.name / "labels.npy").unlink()
    scores_path(tmp_path, scene.name, "scores", 2).unlink()
    result = scannet_volume.score([scene], tmp_path)
    assert result["segmentation"]["scene_macro"]["miou"] == 0
    assert result["localization"]["fixed"]["scene_macro"]["miou"] == pytest.approx(2 / 3)
    with refused("predict before scoring"):
        scannet_volume.score([replace(scene, name="other")], tmp_path)


def test_segmentation_is_eq_3(scene, tmp_path):
    rng = default_rng(0)
    guess = np.where(rng.random(COUNT) < 0.3, rng.integers(1, 4, COUNT), scene.pseudo_labels)
    scannet_volume.predict(scene, knowing(scene, guess), tmp_path)
    record = scannet_volume.segmentation(scene, tmp_path)
    found = np.load(tmp_path / scene.name / "labels.npy")
    counted = scene.pseudo_labels > 0
    for number, name in enumerate(LABELS.names, 1):
        expected = weighted_iou((found == number) & counted, scene.pseudo_labels == number, scene.significance)
        assert record["classes"][name]["iou"] == pytest.approx(expected)
    plain = scannet_volume.segmentation(scene, tmp_path, weighted=False)
    assert plain["miou"] != pytest.approx(record["miou"], abs=1e-3)


def small_scene(seed: int) -> ScannetScene:
    return ScannetScene("small", random_points(3000, 4, seed), LABELS, random_gaussians(COUNT, seed, size=0.3))


def test_means_over_scenes_and_over_queries(tmp_path):
    """One scene has all three classes, the other only one of them."""
    full = small_scene(3)
    points = full.points._replace(labels=np.where(full.points.labels == 1, 1, 0).astype(np.int32))
    narrow = replace(full, name="narrow", points=points)
    scannet_volume.predict(full, knowing(full), tmp_path)
    scannet_volume.predict(narrow, replace(ignorant(narrow), name="knowing"), tmp_path)
    fixed = scannet_volume.score([full, narrow], tmp_path)["localization"]["fixed"]
    assert fixed["scene_macro"]["miou"] == pytest.approx(1 / 2)
    assert fixed["query_micro"]["miou"] == pytest.approx(3 / 4)


def test_choosers_have_a_threshold_per_query(scene, tmp_path):
    def never(scores):
        return float(np.nanmax(scores))

    scannet_volume.predict(scene, knowing(scene), tmp_path, choosers={"never": (never, "no one")})
    result = scannet_volume.score([scene], tmp_path)
    assert result["thresholds"]["never"] == "no one"
    assert result["localization"]["never"]["scene_macro"]["miou"] == 0


def test_the_automatic_column_is_what_is_answered(scene, tmp_path):
    """Not the scores, but what the engine compares: here they are turned around."""
    truth = scene.pseudo_labels
    number = {name: k for k, name in enumerate(LABELS.prompts, start=1)}

    def scores(text):
        return np.where(truth == number[text], 0, 1).astype(np.float32)

    scorer = Scorer("answers", len(truth), scores, 0.5, (), answer=lambda text: (1 - scores(text), 0.25))
    scannet_volume.predict(scene, scorer, tmp_path, choosers={AUTOMATIC: (lambda known: 0.5, "from the scores")})
    found = scannet_volume.score([scene], tmp_path)["localization"]
    assert found[FIXED]["scene_macro"]["miou"] == 0
    assert found[AUTOMATIC]["scene_macro"]["miou"] == 1


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros(3, np.int32), "expected 400 values"),
        (np.zeros(COUNT, np.float32), "expected 400 values"),
        (np.full(COUNT, 4, np.int32), "expected classes 0 to 3"),
        (np.full(COUNT, -1, np.int32), "expected classes 0 to 3"),
    ],
)
def test_damaged_predictions_are_named(array, message, scene, tmp_path):
    scannet_volume.predict(scene, knowing(scene), tmp_path)
    write_npy(tmp_path / scene.name / "labels.npy", array, overwrite=True)
    with malformed(f"labels.npy: {message}"):
        scannet_volume.score([scene], tmp_path)


def test_what_does_not_belong_together_is_refused(scene, tmp_path):
    few_gaussians = replace(scene, gaussians=scene.gaussians.subset(np.arange(9)))
    with pytest.raises(MismatchError, match="scores 400 Gaussians, the scene has 9"):
        scannet_volume.predict(few_gaussians, knowing(scene), tmp_path)
    with refused("at least one scene"):
        scannet_volume.score([], tmp_path)
    other = replace(scene, name="other")
    scannet_volume.predict(scene, knowing(scene), tmp_path)
    scannet_volume.predict(other, replace(knowing(scene), sweep=(0.3,)), tmp_path)
    with pytest.raises(MismatchError, match="same classes and thresholds"):
        scannet_volume.score([scene, other], tmp_path)
    Manifest(scannet_volume.PROTOCOL, "m", "other", {}).write(tmp_path)
    with pytest.raises(MismatchError, match="no fixed threshold"):
        scannet_volume.score([other], tmp_path)
    scannet_points.predict(scene, knowing(scene), tmp_path)
    with pytest.raises(MismatchError, match="expected predictions of scannet-volume@1"):
        scannet_volume.score([scene], tmp_path)


def frozen(seed: int = 0) -> ScannetScene:
    """Gaussians at the points; a fifth of them is faint."""
    points = random_points(COUNT, 4, seed)
    gaussians = random_gaussians(COUNT, seed)
    opacities = np.where(np.arange(COUNT) % 5 == 0, 0.09, 0.5).astype(np.float32)
    return ScannetScene("frozen", points, LABELS, replace(gaussians, means=points.positions, opacities=opacities))


def test_points_protocol_counts_gaussians_that_are_not_faint(tmp_path):
    scene = frozen()
    guess = np.where(np.arange(COUNT) % 5 == 0, 0, scene.points.labels)  # wrong where it is faint
    scannet_points.predict(scene, knowing(scene, guess), tmp_path)
    result = scannet_points.score([scene], tmp_path)
    assert result["segmentation"]["scene_macro"] == {"miou": 1, "macc": 1}
    guess = np.where(guess == 1, 2, guess)
    scannet_points.predict(scene, knowing(scene, guess), tmp_path)
    classes = scannet_points.score([scene], tmp_path)["segmentation"]["by_scene"]["frozen"]["classes"]
    counted = np.arange(COUNT) % 5 != 0
    ones, twos = (((scene.points.labels == k) & counted).sum() for k in (1, 2))
    assert classes["wall"] == {"iou": 0, "acc": 0}
    assert classes["floor"] == {"iou": pytest.approx(twos / (ones + twos)), "acc": 1}
    assert classes["table"] == {"iou": 1, "acc": 1}


def test_points_protocol_without_features_scores_zero(tmp_path):
    scene = frozen()
    scannet_points.predict(scene, ignorant(scene), tmp_path)
    result = scannet_points.score([scene], tmp_path)
    assert result["segmentation"]["scene_macro"] == {"miou": 0, "macc": 0}
    with refused("at least one scene"):
        scannet_points.score([], tmp_path)


def test_points_protocol_refuses_free_gaussians(tmp_path):
    scene = frozen()
    scannet_points.predict(scene, knowing(scene, scene.points.labels), tmp_path)
    moved = replace(scene, gaussians=replace(scene.gaussians, means=scene.gaussians.means + np.float32(0.1)))
    with pytest.raises(MismatchError, match="away from their points"):
        scannet_points.score([moved], tmp_path)
    fewer = replace(scene, gaussians=scene.gaussians.subset(np.arange(9)))
    with pytest.raises(MismatchError, match="9 Gaussians for 400 labelled points"):
        scannet_points.score([fewer], tmp_path)


@few
@given(st.integers(0, 1000))
def test_sweep_is_the_iou_of_each_threshold(seed):
    rng = default_rng(seed)
    scores = rng.choice(np.float32([0.1, 0.2, 0.3, 0.4, np.nan]), 60)
    truth, weights = rng.random(60) < 0.4, rng.random(60)
    thresholds = rng.permutation([0.05, 0.1, 0.25, 0.3, 0.3, 0.9]).tolist()
    expected = [weighted_iou(scores > np.float32(t), truth, weights) for t in thresholds]
    assert_allclose(sweep_weighted_ious(scores, truth, weights, thresholds), expected, atol=1e-12)


def test_the_tuned_threshold_is_the_best_and_the_lowest_of_equals():
    means = {"fixed": 0.9, "sweep 0.100": 0.2, "sweep 0.200": 0.5, "sweep 0.300": 0.5}
    assert best_sweep(means) == "sweep 0.200"
    assert best_sweep({"fixed": 0.9}) is None


@few
@given(st.integers(0, 1000), st.sampled_from([0.35, 0.6]))
def test_voxels_are_the_twins(seed, side):
    gaussians = random_gaussians(80, seed, size=0.2)
    labels = default_rng(seed).integers(0, 4, 80).astype(np.int32)
    grid = voxel.grid_over(gaussians.means, side)
    (got,) = voxel.voxel_labels(gaussians, [labels], 4, grid)
    scores = reference.voxel_scores(gaussians, labels, grid.centers(), 4, voxel.CUT_OFF_SIGMAS)
    expected = np.where(scores.sum(1) * side**3 > voxel.MIN_MASS, scores.argmax(1), -1)
    first, second = -np.sort(-scores, axis=1)[:, :2].T
    mass = scores.sum(1) * side**3
    border = np.abs(mass / voxel.MIN_MASS - 1) < 0.01
    clear = ((first > second * (1 + 1e-4)) | (mass < voxel.MIN_MASS / 2)) & ~border
    assert clear.mean() > 0.9
    assert_array_equal(got[clear], expected[clear])
    assert (expected[clear] >= 0).any()


def test_voxels_do_not_depend_on_threads_or_slabs(monkeypatch):
    gaussians = random_gaussians(500, 4)
    labels = default_rng(0).integers(0, 4, 500).astype(np.int32)
    grid = voxel.grid_over(gaussians.means, 0.1)
    expected = voxel.voxel_labels(gaussians, [labels, 3 - labels], 4, grid, threads=1)
    monkeypatch.setattr(voxel, "SLAB_SCORES", 20_000)
    monkeypatch.setattr(pseudo_labels, "MAX_PAIRS", 3000)
    for one, other in zip(
        expected, voxel.voxel_labels(gaussians, [labels, 3 - labels], 4, grid, threads=3), strict=True
    ):
        assert_array_equal(one, other)


def test_a_voxel_has_the_label_of_the_denser_gaussian():
    columns = (
        [[0.0, 0, 0], [0.3, 0, 0]], [[1.0, 0, 0, 0]] * 2, [[0.2] * 3] * 2, [1.0, 0.5], np.zeros((2, 1, 3)),
    )  # fmt: skip
    gaussians = Gaussians(*(np.array(c, np.float32) for c in columns))
    grid = voxel.VoxelGrid(np.array([-0.05, -0.05, -0.05]), 0.1, (5, 1, 1))
    (labels,) = voxel.voxel_labels(gaussians, [np.int32([1, 2])], 3, grid)
    # equal where x^2 / 0.08 = (0.3 - x)^2 / 0.08 + ln 2, at x = 0.24: centres are 0, 0.1, ... 0.4
    assert_array_equal(labels, [1, 1, 1, 2, 2])


@pytest.mark.parametrize("side", [0.0, -1.0, 1e-4])
def test_impossible_voxels_are_refused(side):
    with refused("voxel"):
        voxel.grid_over(random_gaussians(10).means, side)


def test_study_finds_the_metric_that_follows():
    rng = default_rng(0)
    compared = [
        {"scene": str(k), "voxel": v, "weighted": 0.9 * v + 0.01, "unweighted": float(rng.random())}
        for k, v in enumerate(np.linspace(0.1, 0.6, 8).tolist())
    ]
    result = voxel.study(compared)
    assert result["correlations"]["weighted"]["pearson"] == pytest.approx(1)
    assert result["correlations"]["unweighted"]["spearman"] < 0.9
    assert result["enough_scenes"]
    assert voxel.study(compared[:2]) == {
        "scenes": compared[:2], "correlations": {}, "enough_scenes": False,
    }  # fmt: skip
