"""Scorers, tables, charts, the report and the command, on a small written scene."""

import doctest
import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from test_lerf_ovs import PER_THING, THINGS, balls, data  # noqa: F401
from test_scannet_protocols import write_scene

import drsplat as ds
from drsplat import WordEncoder, cli
from drsplat.errors import FormatError, MismatchError
from drsplat.evaluation import predictions, report, tables
from drsplat.evaluation.report import Figure, write_report
from drsplat.evaluation.running import automatic_choosers
from drsplat.evaluation.scorers import cosine_scorer, feature_scorer, hashed, relevant
from drsplat.formats.peer_features import read_peer_features
from drsplat.query import Query, Scene
from fields import TOY, ToyEncoder, toy_field, unit_rows
from refusing import refused


@pytest.mark.parametrize("module", [predictions, tables, report])
def test_examples(module):
    result = doctest.testmod(module, extraglobs={"np": np})
    assert result.attempted
    assert not result.failed


def test_scorers_of_a_field_are_the_query_path():
    field, encoder = toy_field(), ToyEncoder()
    scene = Scene(field, encoder=encoder)
    answer, measured = scene.ask("red mug"), scene.ask(Query("red mug", relevancy=True))
    cosines = cosine_scorer(field, encoder)
    assert_array_equal(cosines.scores("red mug"), field.dense(answer.scores, fill=np.nan))
    assert np.isnan(cosines.scores("red mug")).sum() == field.num_gaussians - len(field) > 0
    relevancies = relevant(cosines).scores("red mug")
    assert_allclose(relevancies, field.dense(measured.values, fill=np.nan), rtol=1e-5)
    assert cosines.views == ("a.jpg", "b.jpg", "c.jpg")
    assert cosines.about["field"] == field.fingerprint
    assert (cosines.threshold, relevant(cosines).threshold) == (0.5, 0.5)


def test_negatives_are_scored_once():
    encoder = ToyEncoder()
    scorer = relevant(cosine_scorer(toy_field(), encoder))
    for _ in range(3):
        scorer.scores("red mug")
    assert encoder.asked == 3 + 4


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_features_of_others_are_scored_without_codes(dtype, tmp_path):
    rng = default_rng(0)
    features = (3 * unit_rows(rng, 50, TOY.dim)).astype(dtype)
    features[7] = 0
    np.save(tmp_path / "f.npy", features)
    scorer = feature_scorer(read_peer_features(tmp_path / "f.npy"), ToyEncoder())
    scores = scorer.scores("red mug")
    unit = ToyEncoder().encode_texts(["red mug"])[0]
    exact = features.astype(np.float64)
    expected = exact @ unit / np.where(exact.any(1), np.linalg.norm(exact, axis=1), np.nan)
    assert_allclose(scores, expected, atol=1e-6)
    assert np.flatnonzero(np.isnan(scores)).tolist() == [7]
    assert scorer.about["features"] == hashed(features)


def test_features_that_no_length_can_be_told_of_have_no_score():
    features = unit_rows(default_rng(0), 5, TOY.dim).astype(np.float32)
    features[1], features[2, 3], features[3, 3] = 3e38, np.nan, np.inf
    scores = feature_scorer(features, ToyEncoder()).scores("red mug")
    assert np.flatnonzero(np.isnan(scores)).tolist() == [1, 2, 3]


def test_features_of_another_kind_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((3, 4), np.float64))
    with refused("float16 or float32"):
        read_peer_features(tmp_path / "a.npy")
    with pytest.raises(MismatchError, match=r"expected \(N, 32\)"):
        feature_scorer(np.zeros((3, 4), np.float32), ToyEncoder())
    (tmp_path / "a.npy").write_bytes(b"nothing")
    with pytest.raises(FormatError):
        read_peer_features(tmp_path / "a.npy")


def test_choosers_let_absent_gaussians_have_no_say():
    scores = np.float32([np.nan, 0.1, 0.12, 0.11, 0.9, 0.95, np.nan])
    for choose, how in automatic_choosers(cosine_scorer(toy_field(), ToyEncoder())).values():
        assert how.startswith("per query")
        assert choose(np.full(4, np.nan, np.float32)) == np.inf
        assert np.isfinite(choose(scores))


def test_the_automatic_threshold_is_the_encoders_own_where_it_has_one():
    """As `drsplat select` has it: never below the encoder's, and more where the peak is high."""
    encoder = WordEncoder()
    unit = np.eye(2, encoder.identity.dim, dtype=np.float32)
    scorer = feature_scorer(unit, encoder)
    choose, how = automatic_choosers(scorer)["automatic"]
    assert scorer.least == encoder.threshold
    assert "the encoder's" in how
    low, high = np.full(100, 0.1, np.float32), np.full(100, 0.999, np.float32)
    assert choose(low) == encoder.threshold
    assert choose(2 * high) == pytest.approx(0.6 * 2 * 0.999)
    assert relevant(scorer).least is None


def lerf_result(pairs: dict[str, int], miou: float = 0.5) -> dict:
    numbers = {"miou": miou, "acc@0.25": 0.75, "acc@0.5": 0.5, "localization": 1.0}
    summary = {"scene_macro": numbers, "query_micro": numbers, "by_scene": dict.fromkeys(pairs, numbers)}
    return {
        "protocol": "lerf-ovs@1",
        "method": "ours",
        "scenes": [
            {"name": name, "pairs": count, "leaked": [], "inputs": {"gaussians": "3-abc"}}
            for name, count in pairs.items()
        ],
        "thresholds": {"fixed": "0.5 for all queries", "tuned on test": "0.4 for all queries"},
        "columns": {"fixed": summary, "tuned on test": summary},
    }


def test_differences_are_shown_on_the_same_data_only():
    first, *_ = tables.tables_of([lerf_result(tables.LERF_PAIRS)])
    (gaps,) = [row for row in first.rows if row[0] == "ours minus the paper's"]
    assert gaps[3:] == (pytest.approx(50 - 43.58), pytest.approx(75 - 63.87), None, None)
    mine, papers, _ = tables.tables_of([lerf_result({"teatime": 59})])
    assert not any("minus" in str(row[0]) or "paper" in str(row[0]) for row in mine.rows)
    assert papers.aside
    assert "cannot be compared" in papers.note
    assert not tables.same_data(lerf_result({**tables.LERF_PAIRS, "teatime": 58}))


def test_fixed_and_tuned_are_never_one_row():
    first, *_ = tables.tables_of([lerf_result({"room": 3}), lerf_result({"room": 3}, 0.6)])
    assert [row[1] for row in first.rows] == ["fixed", "fixed", "tuned on test", "tuned on test"] * 2
    assert "tuned on test: 0.4" in first.note


def test_report_is_one_page_that_needs_nothing_else(tmp_path):
    picture = np.zeros((20, 30, 3), np.uint8)
    results = [lerf_result({"<b>": 3}, float("nan"))]
    written = write_report(tmp_path, results, [Figure("a < b", picture)], [report.bars([("x", 2.0)], "s", "t")])
    page = (tmp_path / "report.html").read_text()
    assert written == [tmp_path / "results.json", tmp_path / "report.html"]
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)
    assert "data:image/jpeg;base64," in page
    assert "<b></td>" not in page
    assert "a &lt; b" in page
    document = json.loads((tmp_path / "results.json").read_text())
    assert document["format"] == "drsplat evaluation"
    assert document["results"][0]["columns"]["fixed"]["scene_macro"]["miou"] is None
    with refused("overwrite"):
        write_report(tmp_path, results)
    before = [path.read_bytes() for path in written]
    write_report(tmp_path, results, [Figure("a < b", picture)], [report.bars([("x", 2.0)], "s", "t")], True)
    assert [path.read_bytes() for path in written] == before


def test_scatter_puts_points_where_they_are():
    chart = report.scatter([(0.1, 0.2, "a & b"), (0.4, 0.4, "c")], "x", "y", "title", "note")
    root = ElementTree.fromstring(chart)
    circles = root.findall("{http://www.w3.org/2000/svg}circle")
    (ax, ay), (cx, cy) = ((float(c.get("cx")), float(c.get("cy"))) for c in circles)
    assert cx - report.MARGIN == pytest.approx(4 * (ax - report.MARGIN), abs=0.2)
    assert report.HEIGHT - report.MARGIN - cy == pytest.approx(2 * (report.HEIGHT - report.MARGIN - ay), abs=0.2)
    assert "a & b" in circles[0][0].text


def test_bars_are_as_long_as_their_values():
    root = ElementTree.fromstring(report.bars([("PQ 32", 1.0), ("cosine", 14.0)], "ms", "search"))
    lengths = [float(r.get("width")) for r in root.findall("{http://www.w3.org/2000/svg}rect")]
    assert lengths[1] == pytest.approx(14 * lengths[0], rel=0.01)


@pytest.fixture
def judged(data, tmp_path) -> dict[str, str]:  # noqa: F811
    """A scene, perfect features of it, and the texts' vectors."""
    encoder = ds.WordEncoder()
    vectors = encoder.encode_texts(list(THINGS))
    np.save(tmp_path / "features.npy", np.repeat(vectors, PER_THING, axis=0))
    ds.write_gaussians(tmp_path / "scene.ply", balls())
    words = dict(zip(THINGS, vectors.tolist(), strict=True))
    (tmp_path / "words.json").write_text(json.dumps(words))
    return {
        "data": str(data),
        "scene": str(tmp_path / "scene.ply"),
        "features": str(tmp_path / "features.npy"),
        "words": str(tmp_path / "words.json"),
        "report": str(tmp_path / "report"),
    }


def evaluate(judged: dict[str, str], *more: str, protocol: str = "lerf-ovs") -> int:
    given = ["--scene", judged["scene"], "--features", judged["features"], "--vocabulary", judged["words"]]
    return cli.main(["evaluate", protocol, judged["data"], *given, "--report", judged["report"], *more])


@pytest.mark.slow
def test_command_scores_features_of_others(judged, capsys):
    assert evaluate(judged, "--method", "peer", "--threshold", "0.9", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["method"] == "peer"
    assert answer["columns"]["fixed"]["scene_macro"]["acc@0.5"] == 1
    assert set(answer["files"]) >= {"room/frame_00001.json", "room/frame_00003.json"}
    page = Path(judged["report"], "report.html").read_text()
    assert page.count("data:image/jpeg") == 3 * 4  # label, scores and selection of each pair
    assert evaluate(judged) == 1  # it is there already
    assert "--overwrite" in capsys.readouterr().err
    assert evaluate(judged, "--score-only", "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert again["columns"] == answer["columns"]


@pytest.mark.slow
def test_command_shows_tables(judged, capsys):
    assert evaluate(judged, "--figures", "1") == 0
    shown = capsys.readouterr().out
    assert "lerf-ovs@1: selection" in shown
    assert "tuned on" in shown
    assert "in papers" not in shown


def test_command_needs_to_know_which_scenes(judged, capsys):
    for wrong, message in (
        (("--scene", judged["scene"]), "--features is given 1 time and --scene 2 times"),
        (("--field", "f"), "and not both"),
        (("--name", "hall"), "expected a folder of LERF-OVS labels"),
    ):
        assert evaluate(judged, *wrong) == 1
        assert message in capsys.readouterr().err
    Path(judged["data"], "label", "other").mkdir()
    assert evaluate(judged) == 1
    assert "name the scenes" in capsys.readouterr().err


@pytest.mark.parametrize("protocol", ["scannet-volume", "voxel"])
def test_command_scores_scannet_scenes(protocol, tmp_path, capsys):
    place, gaussians = write_scene(tmp_path / "scans")
    ds.write_gaussians(tmp_path / "scene.ply", gaussians)
    labels = tmp_path / "mine.tsv"
    labels.write_text("1\twall\n2\tfloor\n7\ttable\n")
    texts = ["wall", "floor", "table"]
    vectors = unit_rows(default_rng(0), 3, 16)
    (tmp_path / "words.json").write_text(json.dumps(dict(zip(texts, vectors.tolist(), strict=True))))
    np.save(tmp_path / "features.npy", vectors[np.arange(len(gaussians)) % 3])
    given = ["evaluate", protocol, str(place.parent), "--label-set", str(labels), "--json"]
    given += ["--scene", str(tmp_path / "scene.ply"), "--features", str(tmp_path / "features.npy")]
    given += ["--vocabulary", str(tmp_path / "words.json"), "--report", str(tmp_path / "out")]
    assert cli.main([*given, "--voxel-side", "0.2"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert 0 < answer["segmentation"]["scene_macro"]["miou"] < 0.5
    assert answer["label_set"] == "mine"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "IoU of each class" in page
    assert ("mIoU of Gaussians" in page) == (protocol == "voxel")


def asked(category: str, iou: float) -> dict:
    return {"category": category, "iou": {"fixed": 0.0, "automatic": iou}}


def test_charts_show_each_word_how_many_are_good_and_thresholds():
    queries = [asked("mug", 0.9), asked("mug", 0.7), asked("plate", 0.3)]
    result = {"method": "ours", "queries": queries, "sweep": {"sweep 0.100": 0.25, "sweep 0.300": 0.5}}
    words, good, sweep = (ElementTree.fromstring(chart) for chart in report.charts_of([result]))
    texts = ["".join(one.itertext()) for one in words.iter() if one.tag.endswith("text")]
    assert texts[1:] == ["mug", "80 %", "plate", "30 %"]
    assert "automatic" in texts[0]
    (line,) = [one for one in good.iter() if one.tag.endswith("polyline")]
    points = np.array([point.split(",") for point in line.attrib["points"].split()], float)
    top, bottom = report.MARGIN, report.HEIGHT - report.MARGIN
    reached = (bottom - points[:, 1]) / (bottom - top)
    assert_allclose(reached[[0, 12, 13, 28, 29, 36, 37, 40]], [1, 1, 2 / 3, 2 / 3, 1 / 3, 1 / 3, 0, 0], atol=1e-3)
    (line,) = [one for one in sweep.iter() if one.tag.endswith("polyline")]
    first, last = (float(point.split(",")[1]) for point in line.attrib["points"].split())
    assert first == pytest.approx(bottom - 0.25 * (bottom - top), abs=0.1)
    assert last == pytest.approx(bottom - 0.5 * (bottom - top), abs=0.1)


def test_of_many_words_the_worst_are_shown():
    queries = [asked(f"word {number}", number / 100) for number in range(50)]
    (words, _) = report.charts_of([{"method": "ours", "queries": queries}])
    assert "the 20 worst of 50" in words
    assert ">word 19<" in words
    assert ">word 20<" not in words


def test_several_methods_are_curves_of_one_chart():
    results = [{"method": name, "queries": [asked("mug", 0.5)]} for name in ("ours", "theirs <b>")]
    *_, good = report.charts_of(results)
    tree = ElementTree.fromstring(good)
    colors = [one.attrib["stroke"] for one in tree.iter() if one.tag.endswith("polyline")]
    assert colors == list(report.LINES[:2])
    assert "theirs <b>" in "".join(tree.itertext())
