"""Every example runs as a newcomer runs it: after `drsplat demo`, beside its folder, without arguments."""

import base64
import contextlib
import io
import json
import re
import runpy
import socket
import sys
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import Mock
from urllib.error import HTTPError

import numpy as np
import pytest
from PIL import Image

import drsplat as ds
from drsplat.evaluation.demo.story import Story, Verdict
from drsplat.formats.langsplat import write_features

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = {path.name[:2]: path for path in sorted((ROOT / "examples").glob("*.py"))}
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def demo(household_story: Story, household_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Story:
    """An empty folder, but for what `drsplat demo` wrote."""
    (tmp_path / "drsplat-demo").symlink_to(household_folder)
    monkeypatch.chdir(tmp_path)
    return household_story


def run(number: str, capsys: Capture, *arguments: str) -> str:
    """What an example prints."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(EXAMPLES[number]), *arguments])
        runpy.run_path(str(EXAMPLES[number]), run_name="__main__")
    return capsys.readouterr().out


def verdict(demo: Story, text: str) -> Verdict:
    """What the demo found."""
    return next(one for one in demo.verdicts if one.probe.text == text)


def found(demo: Story, text: str) -> np.ndarray:
    return verdict(demo, text).gaussian_ids


def center(demo: Story, text: str) -> np.ndarray:
    return verdict(demo, text).center


def is_coloured(path: str) -> bool:
    with Image.open(path) as picture:
        return bool(np.ptp(np.asarray(picture), axis=2).max() > 100)


def test_there_are_ten_and_the_tour_links_them_all():
    assert list(EXAMPLES) == [f"{number:02}" for number in range(1, 11)]
    tour = (ROOT / "docs/tour.md").read_text(encoding="utf-8")
    assert re.findall(r"\(\.\./examples/(\w+\.py)\)", tour) == [p.name for p in EXAMPLES.values()]


@pytest.mark.parametrize("path", EXAMPLES.values(), ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_it_is_run(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert 15 <= sum(bool(line) and not line.lstrip().startswith("#") for line in lines) <= 40
    assert max(map(len, lines)) <= 120
    docstring = path.read_text(encoding="utf-8").split('"""')[1]
    assert "Needs " in docstring
    assert f"python examples/{path.name} [" in docstring


@pytest.mark.slow
def test_registering_gives_the_field_of_the_demo(demo, capsys):
    run("01", capsys)
    assert ds.load_field("registered.field").fingerprint == demo.field.fingerprint


def test_registering_features_of_langsplat(demo, household_folder, capsys):
    """Of three photos, in LangSplat's own files, which do not name their encoder."""
    features = ds.read_features(household_folder / "language_features")
    for name in list(features)[:3]:
        write_features("langsplat", name, *features.stored(name))
    given = ("drsplat-demo/scene.compressed.ply", "drsplat-demo", "langsplat", "mine.field", "CLIP")
    run("01", capsys, *given)
    field = ds.load_field("mine.field")
    assert (field.encoder.name, field.scene) == ("CLIP", demo.field.scene)
    assert [Path(name).stem for name in field.evidence.masks.view_names] == list(features)[:3]


def test_asking_saves_what_was_found(demo, capsys):
    assert "seen in frame_" in run("02", capsys)
    saved, vase = ds.read_gaussians("found.ply"), found(demo, "red vase")
    assert saved.fingerprint == demo.gaussians.fingerprint
    np.testing.assert_array_equal(np.flatnonzero(saved.extra["match_id"] == 0), vase)
    ids = np.load("found.npy")
    assert np.isin(vase, ids).all()
    assert saved.extra["relevancy"][ids].min() > 0.5
    assert is_coloured("found.png")


def test_asking_for_what_is_not_there_saves_nothing(demo, capsys):
    with pytest.raises(SystemExit, match="nothing found for 'laptop'"):
        run("02", capsys, "drsplat-demo", "laptop")
    assert not Path("found.ply").exists()


def test_a_click_cuts_the_vase_out(demo, capsys):
    assert run("03", capsys).startswith("this is: red vase")
    thing, rest = ds.read_gaussians("thing.ply"), ds.read_gaussians("rest.ply")
    assert len(thing) + len(rest) == len(demo.gaussians)
    vase = demo.gaussians.subset(found(demo, "red vase"))
    same = {tuple(mean) for mean in thing.means} & {tuple(mean) for mean in vase.means}
    assert len(same) > 0.9 * len(vase)
    assert np.linalg.norm(np.median(thing.means, axis=0) - center(demo, "red vase")) < 0.05


@pytest.mark.slow
def test_things_are_counted(demo, capsys):
    printed = run("04", capsys)
    counts = re.findall(r"^(\d+) x (.+)$", printed, re.MULTILINE)
    assert counts == [("2", "something to eat"), ("1", "red vase"), ("1", "toy duck"), ("0", "laptop")]
    assert f"at {center(demo, 'red vase').round(2)}" in printed
    assert run("04", capsys, "drsplat-demo", "teddy bear").splitlines() == ["0 x teddy bear"]


@pytest.mark.slow
def test_features_are_evaluated(demo, tmp_path, capsys):
    """Those of the field score as the field does; those of other Gaussians find nothing."""
    own = measured(run("05", capsys))
    assert own["miou"] > 0.65
    assert own["localization"] == 1.0
    assert len(list((tmp_path / "evaluation").rglob("*.png"))) > 12  # what was scored
    rows = demo.field.feature(slice(None)).astype(np.float16)
    features = np.zeros((len(demo.gaussians), rows.shape[1]), np.float16)
    features[demo.field.gaussian_ids[::-1]] = rows
    np.save("features.npy", features)
    assert measured(run("05", capsys, "drsplat-demo", "features.npy"))["miou"] < 0.2


def measured(printed: str) -> dict[str, float]:
    numbers: dict[str, float] = json.loads(printed.replace("'", '"'))
    return numbers


@pytest.mark.slow
def test_another_encoder_finds_what_is_red(demo, capsys):
    run("06", capsys)
    field = ds.load_field("colors.field")
    assert (field.encoder.name, len(field)) == ("mean colour", len(demo.field))
    hits = field.select(np.float32([2, -1, -1, 0]) / np.float32(6**0.5), 0.95)
    red = field.gaussian_ids[hits.rows]
    assert np.isin(found(demo, "red vase"), red).mean() > 0.9
    assert np.isin(found(demo, "couch"), red).mean() < 0.1  # it is orange


@pytest.mark.slow
def test_new_photos_are_added(demo, capsys):
    printed = run("07", capsys)
    assert "of 42 views" in printed
    evidence = ds.load_field("more.field").evidence
    names = {view.name for view in (*demo.views, *demo.held_out)}
    assert set(evidence.masks.view_names) == names
    place = [float(x) for x in re.findall(r"at \(([^)]+)\)", printed)[0].split(", ")]
    assert np.linalg.norm(np.subtract(place, center(demo, "red vase"))) < 0.05


def test_classes_are_columns_and_colours(demo, capsys):
    printed = run("08", capsys)
    saved = ds.read_gaussians("classes.ply")
    labels = saved.extra["class_id"]
    assert set(np.unique(labels)) == {-1, 0, 1, 2, 3}
    assert f"{np.count_nonzero(labels == 0):,} Gaussians are red vase" in printed
    assert (labels[found(demo, "red vase")] == 0).mean() > 0.9
    assert (labels[found(demo, "couch")] == 1).mean() > 0.9
    colors = [np.unique(saved.sh[labels == one, 0], axis=0) for one in np.unique(labels)]
    assert [len(color) for color in colors] == [1] * 5
    assert len(np.unique(np.concatenate(colors), axis=0)) == 5


@pytest.mark.slow
@pytest.mark.skipif(find_spec("fastapi") is None, reason="the extra drsplat[serve] is not installed")
def test_asking_over_http(demo, capsys):
    with contextlib.closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    printed = run("09", capsys, "drsplat-demo", "red vase", port)
    answer = json.loads(printed)
    assert answer["field"] == demo.field.fingerprint
    assert np.abs(answer["matches"][0]["center"] - center(demo, "red vase")).max() < 1e-3
    assert is_coloured("found_over_http.png")
    with pytest.raises(ConnectionRefusedError):  # it was stopped
        socket.create_connection(("127.0.0.1", int(port)), 1)


def test_a_busy_service_is_asked_again(monkeypatch):
    """503 and when to come again, then an answer; then 404, which is none."""
    fetch = runpy.run_path(str(EXAMPLES["09"]))["fetch"]
    busy, none = (HTTPError("", code, "", {"retry-after": "0"}, io.BytesIO()) for code in (503, 404))
    asked = Mock(side_effect=[busy, io.BytesIO(b"here"), none])
    monkeypatch.setitem(fetch.__globals__, "urlopen", asked)
    assert fetch("http://127.0.0.1") == b"here"
    assert asked.call_count == 2
    with pytest.raises(HTTPError, match="404"):
        fetch("http://127.0.0.1")


@pytest.mark.slow
def test_a_page_has_scene_and_answers(demo, capsys):
    printed = run("10", capsys)
    assert printed.splitlines()[:3] == ["red vase: 1 found", "couch: 1 found", "laptop: nothing found"]
    page = Path("page.html").read_text(encoding="utf-8")
    assert "A room, asked in words" in page
    assert '"red vase"' in page
    parts = [one for one in re.findall(r"[A-Za-z0-9+/=]{1000,}", page) if len(one) > 1_000_000]  # the scene, the search
    assert any(base64.b64decode(one)[:2] == b"\x1f\x8b" for one in parts)  # SPZ
