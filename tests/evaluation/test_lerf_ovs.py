"""lerf-ovs@1 on a small written scene: perfect, empty, missing, damaged; by hand where it can be."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import drsplat as ds
from drsplat.errors import FormatError, MismatchError
from drsplat.evaluation import lerf_ovs, scorers
from drsplat.evaluation.lerf_ovs import LerfScene, predict, read_lerf_scene, score
from drsplat.evaluation.predictions import mask_path, write_mask
from drsplat.evaluation.report import cell_text
from drsplat.evaluation.scorers import Scorer
from drsplat.evaluation.tables import tables_of
from drsplat.formats.poses import write_cameras_json
from mutations import quota, seeded, survivors
from refusing import malformed, refused
from scenes import look_at_view

WIDTH, HEIGHT, PER_THING = 96, 72, 150
MUTANTS = quota(150)
EYES = ((0.0, -4.0, 1.0), (3.0, -3.0, 1.5), (-3.0, -3.0, 0.5))
THINGS = {"red mug": (-0.7, 0.0, 0.0), "blue plate": (0.7, 0.0, 0.0)}


def balls() -> ds.Gaussians:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(len(THINGS) * PER_THING, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = 0.3 * directions + np.repeat(list(THINGS.values()), PER_THING, axis=0)
    count = len(means)
    columns = (means, np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), 0.05), np.full(count, 0.9))
    return ds.Gaussians(*(c.astype(np.float32) for c in (*columns, np.zeros((count, 1, 3)))))


def scores_of(text: str) -> np.ndarray:
    """1 for the thing of that name, 0.3 for the other; five Gaussians have no feature."""
    scores = np.full(2 * PER_THING, 0.3, np.float32)
    start = list(THINGS).index(text) * PER_THING
    scores[start : start + PER_THING] = 1
    scores[::60] = np.nan
    return scores


PERFECT = Scorer("perfect", 2 * PER_THING, scores_of, 0.5, (0.2, 0.4, 0.6), {"by": "hand"})


def record(view: ds.View, gaussians: ds.Gaussians) -> dict[str, object]:
    """Each ball as the box round it, cut to the frame."""
    objects = []
    for k, name in enumerate(THINGS):
        members = np.arange(k * PER_THING, (k + 1) * PER_THING)
        y, x = np.nonzero(ds.render(gaussians, view, select=members).alpha > 0.7)
        x1, y1, x2, y2 = (int(v) for v in (x.min(), y.min(), x.max(), y.max()))
        corners = [[x1, y1], [x2, y1], [x2, y2], [x1, y2]]
        objects.append({"category": name, "bbox": [x1, y1, x2, y2], "segmentation": corners})
    info = {"name": view.name, "width": view.width, "height": view.height}
    return {"info": info, "objects": objects}


@pytest.fixture
def data(tmp_path) -> Path:
    """One scene "room" of three photos, the first and last of them labelled."""
    return write_room(tmp_path / "lerf_ovs", EYES)


def write_room(root: Path, eyes: tuple[tuple[float, float, float], ...]) -> Path:
    """Every other photo is labelled."""
    images, labels = root / "room" / "images", root / "label" / "room"
    images.mkdir(parents=True)
    labels.mkdir(parents=True)
    gaussians, views = balls(), []
    for k, eye in enumerate(eyes, 1):
        at = look_at_view(eye, width=WIDTH, height=HEIGHT)
        views.append(ds.View(f"frame_{k:05d}.png", at.K, at.cam_from_world, WIDTH, HEIGHT))
        Image.new("RGB", (WIDTH, HEIGHT)).save(images / views[-1].name)
    write_cameras_json(root / "room" / "cameras.json", views)
    for view in views[::2]:
        text = json.dumps(record(view, gaussians))
        (labels / view.name).with_suffix(".json").write_text(text)
    return root


@pytest.fixture
def room(data) -> LerfScene:
    return read_lerf_scene(data, "room")


def write_truth(room: LerfScene, folder: Path) -> None:
    """Predictions that are the labels themselves."""
    predict(room, balls(), PERFECT, folder)
    for frame, category in room.pairs:
        mask = frame.mask(category)
        for column in ("fixed", "sweep 0.400", "seen fixed", "seen sweep 0.400"):
            write_mask(mask_path(folder, "room", column, frame.name, category), mask)


def test_truth_scores_one(room, tmp_path):
    write_truth(room, tmp_path)
    result = score([room], tmp_path)
    for column in ("fixed", "tuned on test"):
        for mean in ("scene_macro", "query_micro"):
            assert result["columns"][column][mean] == {
                "miou": 1, "seen": 1, "acc@0.25": 1, "acc@0.5": 1, "localization": 1,
            }  # fmt: skip
    assert result["thresholds"]["tuned on test"] == "0.4 for all queries"


def test_predictions_are_silhouettes_of_what_is_selected(room, tmp_path):
    predict(room, balls(), PERFECT, tmp_path)
    frame, view = room.frames[1], room.views["frame_00003"]
    selected = np.flatnonzero(scores_of("red mug") > 0.5)
    expected = ds.render(balls(), view, select=selected).alpha > 0.7
    path = mask_path(tmp_path, "room", "fixed", frame.name, "red mug")
    assert path == tmp_path / "room" / "fixed" / "frame_00003_red mug.png"
    assert_array_equal(np.asarray(Image.open(path)) > 10, expected)
    everything = np.asarray(Image.open(mask_path(tmp_path, "room", "sweep 0.200", frame.name, "red mug")))
    assert (everything > 10).sum() > 1.5 * expected.sum()


def read(folder: Path, column: str, frame: str, category: str) -> np.ndarray:
    return np.asarray(Image.open(mask_path(folder, "room", column, frame, category))) > 10


def test_what_stands_behind_something_else_is_not_seen(tmp_path):
    """The mug hides the whole plate, and is larger from here."""
    room = read_lerf_scene(write_room(tmp_path / "lerf_ovs", ((-4.5, 0.0, 0.0),)), "room")
    predict(room, balls(), PERFECT, tmp_path)
    (frame,) = room.frames
    view = room.views[frame.name]
    mug, plate = (read(tmp_path, "seen fixed", frame.name, name) for name in THINGS)
    assert read(tmp_path, "fixed", frame.name, "blue plate").sum() > 50
    assert not plate.any()
    selected = np.flatnonzero(scores_of("red mug") > 0.5)
    weight = ds.render(balls(), view, values=(scores_of("red mug") > 0.5)[:, None].astype("f"))
    assert_array_equal(mug, weight.channels[..., 0] > 0.5)
    alone = ds.render(balls(), view, select=selected).alpha
    assert (mug != (alone > 0.5)).mean() < 0.001  # before it are a few Gaussians without feature
    columns = score([room], tmp_path)["columns"]["fixed"]["by_scene"]["room"]
    assert 2 * columns["seen"] == pytest.approx(scorers.mask_iou(mug, frame.mask("red mug")))


def test_predictions_without_what_is_seen_have_no_such_number(room, tmp_path):
    predict(room, balls(), PERFECT, tmp_path)
    shutil.rmtree(tmp_path / "room" / "seen fixed")
    result = score([room], tmp_path)
    assert np.isnan(result["columns"]["fixed"]["scene_macro"]["seen"])
    assert result["columns"]["tuned on test"]["scene_macro"]["seen"] > 0.5
    selection = tables_of([result])[0]
    place = selection.columns.index("seen")
    assert [cell_text(row[place]) == "" for row in selection.rows[:4]] == [True, True, False, False]


def test_a_good_scorer_scores_well(room, tmp_path):
    predict(room, balls(), PERFECT, tmp_path)
    result = score([room], tmp_path)
    fixed = result["columns"]["fixed"]["scene_macro"]
    assert 0.6 < fixed["miou"] < 0.9  # a ball fills pi / 4 of its box
    assert fixed["localization"] == 1
    assert result["sweep"]["sweep 0.200"] < 0.6 * result["sweep"]["sweep 0.600"]
    assert len(result["queries"]) == 4


def test_missing_predictions_count_zero(room, tmp_path):
    write_truth(room, tmp_path)
    frame, category = room.pairs[0]
    mask_path(tmp_path, "room", "fixed", frame.name, category).unlink()
    (tmp_path / "room" / "peaks.json").unlink()
    fixed = score([room], tmp_path)["columns"]["fixed"]["query_micro"]
    assert_allclose([fixed["miou"], fixed["acc@0.25"], fixed["localization"]], [0.75, 0.75, 0])


def test_empty_predictions_score_zero(room, tmp_path):
    nothing = Scorer("nothing", 2 * PER_THING, lambda _: np.full(300, np.nan, np.float32), 0.5, (0.5,))
    predict(room, balls(), nothing, tmp_path)
    for column in score([room], tmp_path)["columns"].values():
        assert set(column["scene_macro"].values()) == {0.0}


def test_macro_and_micro_differ_where_scenes_have_other_sizes(room, tmp_path):
    small = LerfScene("small", room.frames[:1], room.views)
    for scene in (room, small):
        predict(scene, balls(), PERFECT, tmp_path)
    write_truth(room, tmp_path)
    for frame, category in small.pairs:
        write_mask(mask_path(tmp_path, "small", "fixed", frame.name, category), np.zeros((HEIGHT, WIDTH), bool))
    fixed = score([room, small], tmp_path)["columns"]["fixed"]
    assert fixed["scene_macro"]["miou"] == pytest.approx(1 / 2)
    assert fixed["query_micro"]["miou"] == pytest.approx(4 / 6)


def test_choosers_are_columns_of_their_own(room, tmp_path):
    def halfway(scores):
        return float(np.nanmin(scores) + np.nanmax(scores)) / 2

    predict(room, balls(), PERFECT, tmp_path, choosers={"halfway": (halfway, "between least and most")})
    result = score([room], tmp_path)
    assert result["thresholds"]["halfway"] == "between least and most"
    assert result["columns"]["halfway"]["scene_macro"] == result["columns"]["fixed"]["scene_macro"]
    assert result["scenes"][0]["inputs"]["chosen"]["halfway"]["red mug"] == pytest.approx(0.65)


@pytest.mark.parametrize(
    ("views", "leaked"), [(None, None), ((), []), (("frame_00001.png", "frame_00002.png"), ["frame_00001"])]
)
def test_leakage_is_told(views, leaked, room, tmp_path):
    scorer = Scorer("s", 300, scores_of, 0.5, (), views=views)
    predict(room, balls(), scorer, tmp_path)
    assert score([room], tmp_path)["scenes"][0]["leaked"] == leaked


def test_labelled_photos_can_be_left_out(room, data):
    left = lerf_ovs.without_labelled(ds.read_views(data / "room"), room)
    assert [view.name for view in left] == ["frame_00002.png"]


def test_scoring_the_same_again_is_the_same_to_the_byte(room, tmp_path):
    for name in ("a", "b"):
        predict(room, balls(), PERFECT, tmp_path / name)
    one, other = (sorted(p for p in (tmp_path / name).rglob("*") if p.is_file()) for name in ("a", "b"))
    assert len(one) == 2 + 2 * 4 * 4  # alone and seen, four columns, four pairs
    assert [p.read_bytes() for p in one] == [p.read_bytes() for p in other]
    assert score([room], tmp_path / "a") == score([room], tmp_path / "b")


def test_predictions_of_another_size_are_refused(room, tmp_path):
    write_truth(room, tmp_path)
    path = mask_path(tmp_path, "room", "fixed", *[room.pairs[0][0].name, room.pairs[0][1]])
    write_mask(path, np.zeros((5, 5), bool))
    with malformed("expected 96x72 pixels"):
        score([room], tmp_path)
    path.write_bytes(b"no picture")
    with malformed("cannot be read as a PNG"):
        score([room], tmp_path)


WRITTEN = {"protocol": "lerf-ovs@1", "method": "m", "scene": "room", "columns": {}}


@pytest.mark.parametrize(
    ("content", "error", "message"),
    [
        ([], FormatError, "expected an object with protocol, method"),
        (WRITTEN | {"protocol": "lerf-ovs@2"}, MismatchError, "expected predictions of lerf-ovs@1"),
        (WRITTEN | {"scene": "other"}, MismatchError, "for 'room'"),
        (WRITTEN | {"columns": []}, FormatError, "columns"),
        (WRITTEN | {"leaked": 3}, FormatError, "leaked"),
        (WRITTEN | {"columns": {"../a": ""}}, FormatError, "name a folder"),
    ],
)
def test_damaged_manifests_are_named(content, error, message, room, tmp_path):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "predictions.json").write_text(json.dumps(content))
    with pytest.raises(error, match=message):
        score([room], tmp_path)


@pytest.mark.slow
def test_damaged_predictions(room, tmp_path):
    """Whatever was written: numbers or one of our own errors."""
    predict(room, balls(), replace(PERFECT, sweep=()), tmp_path)

    def read(_):
        for column in score([room], tmp_path)["columns"].values():
            assert 0 <= column["scene_macro"]["miou"] <= 1

    for name in ("predictions.json", "peaks.json", "fixed/frame_00001_red mug.png"):
        assert 0 < survivors(tmp_path / "room" / name, read, seeded(0), MUTANTS) < MUTANTS


def test_damaged_peaks_are_named(room, tmp_path):
    write_truth(room, tmp_path)
    (tmp_path / "room" / "peaks.json").write_text('{"frame_00001": {"blue plate": [1]}}')
    with malformed(r"peaks.json: frame_00001: 'blue plate'"):
        score([room], tmp_path)


def test_what_does_not_belong_together_is_refused(room, data, tmp_path):
    with pytest.raises(MismatchError, match="scores 300 Gaussians, the scene has 150"):
        predict(room, balls().subset(np.arange(150)), PERFECT, tmp_path)
    with refused("predict before scoring"):
        score([room], tmp_path)
    with refused("at least one scene"):
        score([], tmp_path)
    label = next((data / "label" / "room").glob("*.json"))
    label.write_text(label.read_text().replace('"height": 72', '"height": 50'))
    with pytest.raises(MismatchError, match="its labels are 96x50"):
        read_lerf_scene(data, "room")
    label.rename(label.with_name("frame_00009.json"))
    label.with_name("frame_00009.json").write_text('{"info": {"width": 9, "height": 9}, "objects": []}')
    with refused("no pose, first 'frame_00009'"):
        read_lerf_scene(data, "room")


def test_scenes_predicted_in_two_ways_are_not_mixed(room, tmp_path):
    other = LerfScene("other", room.frames, room.views)
    predict(room, balls(), PERFECT, tmp_path)
    predict(other, balls(), Scorer("else", 300, scores_of, 0.5, (0.2, 0.4, 0.6)), tmp_path)
    with pytest.raises(MismatchError, match="in one way"):
        score([room, other], tmp_path)
