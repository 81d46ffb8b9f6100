"""The benchmark that ships (benchmarks/suite): its page, its rival, and a run on shipped scenes."""

import ast
import doctest
import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from benchmarks.suite import (
    answers,
    chart,
    headline,
    masks,
    numbers,
    page,
    reading,
    rendered,
    running,
    scenes,
    stamps,
    tables,
)
from benchmarks.suite import results as documents
from benchmarks.suite.rivals import FITTED
from benchmarks.suite.targets import SAID
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from world import packing

from drsplat.evaluation.lerf_ovs import read_lerf_scene
from drsplat.evaluation.scorers import mean_interval
from drsplat.formats.lerf_ovs import read_lerf_labels
from drsplat.formats.scannet import LabelledCloud, read_scannet_labels
from written_captures import write_json

ROOT = Path(__file__).resolve().parents[2]
RESULTS, PAGE = ROOT / "docs" / "evaluation.json", ROOT / "docs" / "evaluation.md"
ANSWERS, PICTURE = ROOT / "docs" / "answers.json", ROOT / "docs" / "evaluation.svg"
TARGETS = ROOT / "docs" / "targets.json"
SHIPPED = sorted(path.parent for path in (ROOT / "world/scenes").glob("*/truth.json"))
shipped = pytest.mark.skipif(not SHIPPED, reason="world/scenes has no packed scene")


def test_the_page_is_what_the_results_make():
    if not RESULTS.is_file():
        pytest.skip("docs/evaluation.json is not there: nothing was run yet")
    said = json.loads(ANSWERS.read_text("utf-8"))
    results, targets = (json.loads(path.read_text("utf-8")) for path in (RESULTS, TARGETS))
    assert PAGE.read_text(encoding="utf-8") == page.page(results, said, targets)
    assert PICTURE.read_text(encoding="utf-8") == headline.picture(said)


def test_questions_without_a_target_come_first():
    counted = {"rooms": ["a"], "answers": {kind: dict.fromkeys(SAID, 0) for kind in ("0", "1", "N")}}
    counted["answers"]["0"] |= {"nothing": 3, "wrong": 1}
    counted["answers"]["N"]["fewer"] = 2
    text = page.page(results(), words(), counted)
    assert "| 0 | 4 | 75 % | 0 % | 0 % | 0 % | 0 % | 25 % |" in text
    assert "| 1 | 0 |  |" in text
    assert "| 2 or more | 2 | 0 % | 0 % | 0 % | 100 % | 0 % | 0 % |" in text
    assert text.index("no such object") < text.index("IoU")
    assert "no such object" not in page.page(results())


def record(scene: str, method: str, level: float) -> dict[str, Any]:
    """All numbers of one scene at one level."""
    columns = dict.fromkeys(
        ("fixed", "automatic"), dict.fromkeys(("miou", "seen", "acc@0.25", "acc@0.5", "localization"), level)
    )
    found = {"columns": columns, "sweep": [level, level + 0.2, 0.1], "leaked": []}
    whole = {"segmentation": {"miou": level, "macc": level}}
    study = {"study": {"scene": scene, "voxel": level, "weighted": level**2, "unweighted": 1 - level}}
    protocols = {"lerf-ovs": found, "scannet-volume": whole | found, "scannet-points": whole, "voxel": whole | study}
    return {"scene": scene, "masks": "true", "method": method, **protocols}


def results() -> dict[str, Any]:
    """Five scenes; robust is better by 10 in each of them."""
    counts = dict.fromkeys(("seed", "labelled_photos"), 1) | dict.fromkeys(("things", "pairs"), 2)
    counts |= {"photos": 3, "gaussians": 1234, "points": 5}
    files = {"scene.compressed.ply": "ab12", "a.ply": "cd", "frame.json": "12"}
    about = {**counts, "cameras": "orbit", "photos_and_truth": "ef", "files": files}
    return {
        "drsplat": "0",
        "label_set": "household",
        "sweep": [0.2, 0.4, 0.6],
        "voxel_side": 0.05,
        "encoder": {"name": "e", "weights": "w", "threshold": 0.5},
        "segmenter": {"name": "graph", "version": 1, "weights": "w"},
        "scenes": dict.fromkeys("abcde", about),
        "records": [
            record(scene, method, level + gain)
            for scene, level in zip("abcde", (0.3, 0.35, 0.4, 0.45, 0.5), strict=True)
            for method, gain in (("mean", 0.0), ("robust", 0.1))
        ],
    }


def test_a_page_by_hand():
    text = " ".join(page.page(results()).split())
    low, high = mean_interval([30.0, 35.0, 40.0, 45.0, 50.0])
    assert "| method | selection | volume | points | voxel |" in text
    assert f"| `mean` | 40.0 [{low:.1f}, {high:.1f}] | 40.0 [" in text
    assert "| `robust` | +10.0 [+10.0, +10.0] | +10.0 [+10.0, +10.0] |" in text
    assert "all that was learned: 10 things, 15 photos, 5 of them labelled, 10 pairs of photo and category." in text
    assert "| true, Spearman | 1.000 | -1.000 |" in text


def asked_for(place: str, kind: str, masks: str, level: float) -> dict[str, Any]:
    """Two words, 0.2 apart; objects are 0.1 better than plain, the best threshold is 0.3 better."""
    gains = zip(answers.COLUMNS, (0, 0.1, 0.3), strict=True)
    ious = {name: [level - 0.1 + more, level + 0.1 + more] for name, more in gains}
    shares = {"missed": {"plain": 0.0, "objects": 0.25}, "found": {"plain": 0.5, "objects": 0.05}}
    about = {"place": place, "kind": kind, "masks": masks, "texts": ["a", "b"]}
    return {**about, **ious, **shares, "words": 40, "absent": 20, "seconds": 900}


def words() -> dict[str, Any]:
    records = [
        asked_for("plush", "capture", "graph", 0.4), asked_for("desk", "capture", "graph", 0.5),
        asked_for("table_1", "room", "graph", 0.6), asked_for("plush", "capture", "sam", 0.6),
        asked_for("table_1", "room", "true", 0.6),
    ]  # fmt: skip
    return {"segmenter": {"version": 7}, "wrong": [0, 20], "seeds": 1, "records": records}


def test_the_page_begins_with_answers_to_words():
    text = page.page(results(), words())
    first = " ".join(text.split("##")[0].split())
    assert "(evaluation.svg)" in first
    assert "overlaps the thing that is meant by 55 % in 2 real captures and 70 % in 1 made-up rooms" in first
    assert "are better (+10.0 [+10.0, +10.0]) in 2 real captures" in first
    assert "is worth +20 in 2 real captures" in first
    assert "something all the same: 5 % in 2 real captures" in first
    assert "find nothing: 25 % in 2 real captures" in first
    assert "are worth +15 in 1 real captures and +0 in 1 made-up rooms" in first
    low, high = 45 - 9.8, 45 + 9.8  # of two places of two words, each 10 from its mean: 1.96 * sqrt(2 * 100 / 2) / 2
    assert f"| 2 real captures, CLIP's vectors, 40 words | `graph`, version 7 | 45.0 [{low:.1f}, {high:.1f}] |" in text
    assert text.count("<details") == text.count("</details>") == text.count("<summary>") >= 3


def test_answers_to_one_word_are_one_draw():
    once = numbers.over_places([[10.0, 30.0]], [["a", "b"]])
    assert once == pytest.approx((20, 20 - 1.96 * 200**0.5 / 2, 20 + 1.96 * 200**0.5 / 2))
    assert numbers.over_places([[10.0, 30.0] * 6], [["a", "b"] * 6]) == pytest.approx(once)
    assert numbers.over_places([[10.0, 30.0]] * 4, [["a", "b"]] * 4)[1] > once[1]


def test_the_picture_is_to_scale():
    root = ElementTree.fromstring(headline.picture(words()))
    svg = "{http://www.w3.org/2000/svg}"
    bars = [part for part in root.iter(f"{svg}rect") if part.find(f"{svg}title") is not None]
    assert len(bars) == 3 * (1 + 2 + 1 + 1)  # mean, plush, desk; mean, table_1
    heights = [float(bar.get("height")) for bar in bars]
    assert heights[2] / heights[0] == pytest.approx(75 / 45, abs=0.01)
    assert "prefers-color-scheme:dark" in chart.STYLE
    names = [text.text for text in root.iter(f"{svg}text")]
    assert {"mean", "plush", "desk", "table 1", "2 real captures"} <= set(names)


def test_what_was_run_before_is_kept_where_nothing_changed(tmp_path):
    now = results() | {"version": 2}
    path, first = tmp_path / "results.json", now["records"][0]
    others = [first | {"method": "opengaussian"}, first | {"masks": "graph"}]
    documents.write_results(path, now | {"records": now["records"] + others})

    def kept(**changes: Any) -> list[dict[str, Any]]:
        return documents.with_earlier(now | {"records": [first]} | changes, path)["records"]

    assert [(r["scene"], r["method"]) for r in kept()][:3] == [("a", "mean"), ("a", "robust"), ("a", "opengaussian")]
    assert len(kept()) == 12
    assert {r["masks"] for r in kept(segmenter={"name": "graph", "version": 2})} == {"true"}
    changed = now["scenes"] | {"a": now["scenes"]["a"] | {"photos_and_truth": "another"}}
    assert {r["scene"] for r in kept(scenes=changed, records=[])} == set("bcde")
    assert kept(sweep=[]) == [first]


def test_stamps_are_of_files_that_are_there():
    for listed in (stamps.METHODS, stamps.RENDERED, stamps.FITTED, stamps.ANSWERS):
        assert all(path.exists() for path in listed)


@pytest.mark.parametrize(
    ("module", "listed"), [("answers.py", stamps.ANSWERS), ("scoring.py", stamps.METHODS)], ids=["answers", "scoring"]
)
def test_what_a_part_imports_of_the_benchmark_is_in_its_stamp(module, listed):
    """A module that is added to the trials, and not to the stamp, would leave old parts in place."""
    left, seen = [stamps.SUITE / module], set()
    while left:
        file = left.pop()
        seen.add(file)
        left += {path for path in imported_files(file) if path.is_file()} - seen
    assert {path for path in seen if not any(path == one or one in path.parents for one in listed)} <= {
        stamps.SUITE / "stamps.py", stamps.SUITE / "__init__.py",
    }  # fmt: skip


def imported_files(file: Path) -> Iterator[Path]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            beside = file.parents[node.level - 1] if node.level else ROOT
            if node.level or (node.module or "").startswith("benchmarks"):
                folder = beside.joinpath(*(node.module or "").split("."))
                yield folder.with_suffix(".py")
                yield from (folder / f"{name.name}.py" for name in node.names)


@pytest.mark.slow
def test_finished_parts_of_other_code_are_made_again(tmp_path, monkeypatch):
    task = running.Task(tmp_path, "true", ("mean",), tmp_path, 1, 0)
    key = running._for("mean", {}, task)
    path = tmp_path / "mean.json"
    path.write_text(json.dumps({"key": key, "record": {"scene": "a"}}), encoding="utf-8")
    assert running._finished(path, running._for("mean", {}, task)) == {"scene": "a"}
    monkeypatch.setattr(stamps, "stamp", lambda paths: "another")
    assert running._finished(path, running._for("mean", {}, task)) is None


@given(st.lists(st.floats(-50, 50), min_size=2, max_size=12))
def test_a_verdict_turns_with_the_sign(values):
    opposite = {"more": "less", "less": "more"}
    found = reading.verdict(values)
    assert reading.verdict([-value for value in values]) == opposite.get(found, found)


def test_least_squares_are_numpys():
    rng = default_rng(0)
    weights = rng.random((60, 8), np.float32) * (rng.random((60, 8)) < 0.6)
    weights[:, 3] = 0  # no photo sees it
    targets = rng.standard_normal((60, 4)).astype(np.float32)
    found = rendered.least_squares(csr_array(weights.astype(np.float32)), targets, 40)
    expected, *_ = np.linalg.lstsq(weights.astype(np.float64), targets, rcond=None)
    assert_allclose(found, expected, atol=1e-4)
    assert not found[3].any()


def test_gaussians_at_points_are_as_large_as_the_gaps():
    line = np.zeros((4, 3), np.float32)
    line[:, 0] = [0, 1, 2, 3]
    made = scenes.at_points(line)
    assert_array_equal(made.means, line)
    expected = np.array([2, 4 / 3, 4 / 3, 2], np.float32)  # mean of three distances
    assert_allclose(made.scales, np.repeat(expected[:, None], 3, axis=1), rtol=1e-6)
    assert (made.opacities == np.float32(scenes.OPACITY)).all()


@pytest.mark.parametrize("points", [7, 2 * packing.LABELLED_POINTS + 1])
def test_packed_labels_are_what_the_readers_read(points, tmp_path):
    output, rng = tmp_path / "scenes" / "small", default_rng(0)
    cloud = LabelledCloud(rng.random((points, 3), np.float32), rng.integers(0, 40, points).astype(np.int32))
    piece = {"category": "red mug", "bbox": [1, 1, 4, 4], "segmentation": [[1, 1], [4, 1], [4, 4]]}
    info = {"name": "frame_00001.jpg", "width": 8, "height": 6}
    files = {
        "truth.json": {"scene": "room", "objects": [], "structures": [], "views": [{"name": "frame_00001.jpg"}]},
        "lerf_ovs/label/room/frame_00001.json": {"info": info, "objects": [piece]},
    }
    for name, document in files.items():
        write_json(tmp_path / name, document)
    (tmp_path / "scannet/room").mkdir(parents=True)
    columns = {**dict(zip("xyz", cloud.positions.T, strict=True)), "label": cloud.labels.astype(np.uint16)}
    (tmp_path / "scannet/room/room_vh_clean_2.labels.ply").write_bytes(packing.ply(columns))
    output.mkdir(parents=True)
    for _ in range(2):  # again, over its own files
        packing.pack_labels(tmp_path, output)
    found = read_scannet_labels(output / "small_vh_clean_2.labels.ply")
    step = max(1, (points - 1) // (packing.LABELLED_POINTS - 1))
    assert len(found.labels) == min(points, packing.LABELLED_POINTS)
    assert_array_equal(found.positions[[0, -1]], cloud.positions[[0, -1]])
    assert_array_equal(found.labels[1], cloud.labels[step])
    (frame,) = read_lerf_labels(tmp_path / "scenes/label/small")
    assert frame.categories == ("red mug",)


@pytest.mark.slow
@shipped
@pytest.mark.parametrize("folder", SHIPPED[:2], ids=lambda path: path.name)
def test_shipped_scenes_are_whole(folder):
    scene = scenes.read_scene(folder)
    known = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert sorted(f"{frame.name}.jpg" for frame in scene.lerf.frames) == sorted(known["held_out"])
    assert not {view.name for view in scene.views} & set(known["held_out"])
    assert read_lerf_scene(folder.parent, folder.name).categories == scene.lerf.categories
    assert len(np.unique(scene.points.points.labels)) > 3
    view = scene.views[0]
    ids = scene.ids(view)
    image = np.zeros((*ids.shape, 3), np.uint8)
    cut = masks.true_masks(scene, view, image)["large"]
    assert sum(cut.areas) == (ids >= 0).sum()
    for index, number in enumerate(np.unique(ids[ids >= 0])):
        assert_array_equal(cut.full(index), ids == number)


@pytest.mark.slow
@shipped
def test_registration_beats_lookup_of_rendered_features(tmp_path, monkeypatch):
    task = running.Task(SHIPPED[0], "true", ("mean", rendered.RENDERED), tmp_path, 5, 0)
    first = running.run([task], 1)
    mean, rival = (numbers.MEASURES["selection"](found) for found in first)
    assert mean > rival + 0.1
    assert first[0]["lerf-ovs"]["leaked"] == []
    monkeypatch.setattr(running, "Workshop", None)  # nothing is made again
    assert running.run([task], 1) == first
    path = tmp_path / "results.json"
    documents.write_results(path, documents.results_of([SHIPPED[0]], 5, first))
    assert "| `mean` |" in page.page(json.loads(path.read_text(encoding="utf-8")))


@pytest.mark.slow
@shipped
def test_rivals_are_scored_like_all_others(tmp_path):
    pytest.importorskip("torch")
    task = running.Task(SHIPPED[0], "true", FITTED, tmp_path, 14, 0, dict.fromkeys(FITTED, 0.0003))
    found = running.run([task], 1)
    assert [record["effort"] for record in found] == [0.0003] * len(FITTED)
    written = page.page(documents.results_of([SHIPPED[0]], 14, found))
    assert f"`{FITTED[0]}` 0.03 %" in written
    assert "<summary>What the papers report</summary>" in written


@pytest.mark.parametrize("study", sorted(path.stem for path in (ROOT / "benchmarks").glob("study_*.py")))
def test_studies_find_what_they_take_from_each_other(study, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))  # as where a script is run
    try:
        importlib.import_module(f"benchmarks.{study}")
    except ModuleNotFoundError as error:
        if str(error.name).split(".")[0] in ("benchmarks", "drsplat"):
            raise
        pytest.skip(f"{error.name} is not installed")


@pytest.mark.parametrize("module", [numbers, reading, stamps, tables])
def test_examples_in_docstrings(module):
    found = doctest.testmod(module)
    assert found.attempted
    assert not found.failed


def test_the_best_threshold_is_the_best_of_all():
    rng = default_rng(1)
    values, meant, mass = rng.random(30), rng.random(30) < 0.4, rng.random(30)
    every = [(mass * ((values >= cut) & meant)).sum() / (mass * ((values >= cut) | meant)).sum() for cut in values]
    cut, best = answers.best_cut(values, meant, mass)
    assert (cut, best) == (values[int(np.argmax(every))], pytest.approx(max(every)))


def test_no_threshold_parts_equal_values():
    meant = np.array([True, True, False, False])
    assert answers.best_iou(np.ones(4), meant, np.ones(4)) == 0.5
