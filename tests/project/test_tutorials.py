"""Every line of the tutorials, in their order: toy models and data under the very names, or the demo's folder."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import drsplat as ds
from drsplat.cli import main
from drsplat.evaluation.demo.story import Story
from fake_models import ColorSegmenter
from toured import blocks, commands_of, write_lerf, write_tour
from toy_capture import THINGS, write_toy_capture

TUTORIALS = Path(__file__).resolve().parents[2] / "docs/tutorials"
CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
Capsys = pytest.CaptureFixture[str]


def run_lines(commands: list[list[str]], capsys: Capsys) -> None:
    for command in commands:
        assert main(command) == 0, f"{command}: {capsys.readouterr().err}"


def run_snippets(document: str) -> dict[str, object]:
    names: dict[str, object] = {}
    for number, snippet in enumerate(blocks(TUTORIALS / document, "python")):
        exec(compile(snippet, f"{document}, python block {number}", "exec"), names)
    return names


@pytest.mark.slow
def test_from_a_phone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capsys) -> None:
    pytest.importorskip("transformers", reason="the extra drsplat[models] is not installed")
    from drsplat.photos.models import sam

    monkeypatch.chdir(write_tour(tmp_path, CLIP))
    monkeypatch.setattr(sam, "load_segmenter", lambda *_, **__: ColorSegmenter())
    lines = commands_of(TUTORIALS / "from_a_phone.md")
    assert lines[0][:2] == ["scan", "photos"]  # test_scan_command.py finds poses; the toy's photos have some
    run_lines([["scan", "capture", *lines[0][2:], "--segmenter", "graph", "--iterations", "30"]], capsys)
    shutil.copy("scene.ply", "room/model/point_cloud/iteration_30/point_cloud.ply")  # what more iterations would make
    again = ["register", "room/model", "capture", "--features", "room/features", "--output", "room/scene.field"]
    run_lines([[*again, "--overwrite"], *lines[1:]], capsys)
    for name in ("room/index.html", "objects.jpg", "mug.ply", "mug.png", "room.html"):
        assert (tmp_path / name).stat().st_size > 0


def test_scene_and_features(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capsys) -> None:
    write_toy_capture(tmp_path)
    write_lerf(tmp_path)
    monkeypatch.chdir(tmp_path)
    run_lines(commands_of(TUTORIALS / "scene_and_features.md"), capsys)
    names = run_snippets("scene_and_features.md")
    matches = names["matches"]
    assert isinstance(matches, list)
    np.testing.assert_allclose(matches[0].center, THINGS["red mug"], atol=0.1)
    assert len(ds.read_gaussians("without_mug.ply")) == len(ds.read_gaussians("scene.ply")) - len(
        np.load("mug_ids.npy")
    )
    assert (tmp_path / "teatime_report/results.json").exists()


@pytest.mark.slow
def test_without_a_model(
    household_story: Story, household_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    """The lines on the demo's folder are run on it, those on one's own photos on a toy's."""
    write_toy_capture(tmp_path)
    shutil.rmtree(tmp_path / "capture/language_features")
    shutil.copytree(household_folder, tmp_path / "drsplat-demo")
    monkeypatch.chdir(tmp_path)
    run_lines([line for line in commands_of(TUTORIALS / "without_a_model.md") if line[0] != "demo"], capsys)
    run_snippets("without_a_model.md")
    said = capsys.readouterr().out
    assert "things are like it" in said
    assert "1 match of 'my table'" in said
    table, rest, whole = (len(ds.read_gaussians(name)) for name in (
        "table.ply", "room_without_table.ply", "drsplat-demo/scene.compressed.ply"))  # fmt: skip
    assert table + rest == whole
    room = ds.open_scene("drsplat-demo")
    assert room.locate("brown table")[0].object_id == 2  # not the floor, for instance
    assert table >= room.objects[2].gaussian_ids.size  # and its loose border


@pytest.mark.slow
def test_films(
    household_story: Story, household_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    shutil.copytree(household_folder, tmp_path / "drsplat-demo")
    monkeypatch.chdir(tmp_path)
    run_lines(commands_of(TUTORIALS.parent / "films.md"), capsys)
    for name in ("vase.webp", "walk.webp", "swing.gif", "row.png"):
        assert (tmp_path / name).stat().st_size > 0
