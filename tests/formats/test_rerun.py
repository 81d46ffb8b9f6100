"""Recordings of rerun, read back by its own program."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_line import answer_of, error_of
from drsplat import read_views
from drsplat.errors import InputError, MissingExtraError
from drsplat.formats.known import write_scene
from drsplat.formats.moving_scenes import write_motion
from drsplat.formats.rerun_writing import write_rrd
from drsplat.scene.labelled import LabelledScene, Thing
from drsplat.scene.moving import Frames, Moving
from drsplat.scene.views import View
from labelled_scenes import labelled
from scene_files import random_gaussians


def printed(path: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "rerun", "rrd", *arguments, str(path)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.mark.slow
@pytest.mark.oracle
def test_rerun_reads_what_we_write(tmp_path):
    pytest.importorskip("rerun")
    view = View("a.png", np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), np.eye(4), 100, 80)
    write_rrd(tmp_path / "out.rrd", replace(labelled(), views=(view,)))
    text = printed(tmp_path / "out.rrd", "print", "-vvv")
    for place in ("/world/splats", "/world/things", "/world/groups", "/world/matches", "/world/annotations"):
        assert place in text
    assert "/world/photos/0" in text
    assert "Pinhole:image_from_camera" in text
    assert "GaussianSplats3D:sh_coefficients" in text
    printed(tmp_path / "out.rrd", "verify")
    with pytest.raises(InputError, match="exists already"):
        write_rrd(tmp_path / "out.rrd", labelled())


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("degree", range(4))
def test_each_degree_is_written(degree, tmp_path):
    pytest.importorskip("rerun")
    write_scene(tmp_path / "out.rrd", LabelledScene(random_gaussians(np.random.default_rng(0), 5, degree)))
    assert ("sh_coefficients" in printed(tmp_path / "out.rrd", "print", "-v")) == (degree > 0)


def test_without_the_sdk_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"\[rerun\]"):
        write_scene(tmp_path / "out.rrd", labelled())
    assert not (tmp_path / "out.rrd").exists()


def moving() -> Moving:
    """Four rows that go a unit to the right in two seconds."""
    first = random_gaussians(np.random.default_rng(0), 4, 1)
    frames = [first, replace(first, means=first.means + np.float32([1, 0, 0]))]
    times = np.array([0.0, 2.0])
    return Moving(first, times, Frames(times, frames.__getitem__))


@pytest.mark.oracle
def test_motion_is_on_a_timeline_with_tracks_of_objects(tmp_path):
    pytest.importorskip("rerun")
    thing = Thing("mug", 0.5, np.array([5.0, 0, 0]), np.eye(3), np.ones(3))
    owners, motion = np.int32([0, 0, -1, 0]), moving()
    scene = LabelledScene(motion.canonical, things=(thing,), object_of=owners, motion=motion)
    write_rrd(tmp_path / "out.rrd", scene)
    printed(tmp_path / "out.rrd", "verify")
    chunks = printed(tmp_path / "out.rrd", "print", "-vvv").split("Chunk(")
    boxes, splats, tracks = (
        next(one for one in chunks if f"/world/{name} -" in one) for name in ("things", "splats", "tracks")
    )
    assert "with 2 rows" in splats
    for time, frame in (("P0D", motion.at(0)), ("PT2S", motion.at(2))):
        assert any(time in line and f"[[{frame.means[0, 0]!s}," in line for line in splats.splitlines())
    for time, center in (("P0D", "[[5.0, 0.0, 0.0]]"), ("PT2S", "[[6.0, 0.0, 0.0]]")):
        assert any(time in line and center in line for line in boxes.splitlines())
    assert "[[[5.0, 0.0, 0.0], [6.0, 0.0, 0.0]]]" in tracks


@pytest.mark.oracle
def test_the_verb_writes_all_of_a_motion_or_one_time(tmp_path, capsys):
    pytest.importorskip("rerun")
    write_motion(tmp_path / "film.motion", moving())
    base = ("export", tmp_path / "film.motion")
    answer_of(capsys, *base, "--output", tmp_path / "all.rrd")
    answer_of(capsys, *base, "--at", 1, "--output", tmp_path / "one.rrd")
    text = {name: printed(tmp_path / f"{name}.rrd", "print", "-vvv") for name in ("all", "one")}
    assert "PT2S" in text["all"]
    assert "PT2S" not in text["one"]
    assert "pass --at T, from 0 to 2" in error_of(capsys, *base, "--output", tmp_path / "all.glb")


@pytest.mark.oracle
def test_photos_go_along_where_they_are_asked_for(edited_room, tmp_path, capsys):
    pytest.importorskip("rerun")
    scene, views = edited_room / "scene.ply", edited_room / "capture"
    refused = error_of(capsys, "export", scene, "--photos", "--output", tmp_path / "no.rrd")
    assert "pass --views CAPTURE" in refused
    count = len(read_views(views))
    for number, base in enumerate([(scene,), (scene, "--field", edited_room / "room.field")]):
        out = tmp_path / f"{number}.rrd"
        answer_of(capsys, "export", *base, "--photos", "--views", views, "--output", out)
        text = printed(out, "print", "-v")
        assert f"/world/photos/{count - 1}" in text
        assert "Pinhole:image_from_camera" in text
    answer = answer_of(capsys, "export", scene, "--photos", "--views", views, "--output", tmp_path / "a.sog")
    assert any("no photos" in sentence for sentence in answer["lacks"])


def test_a_part_of_what_moves_has_one_time():
    motion = moving()
    with pytest.raises(InputError, match=r"4 Gaussians move and 3 are written.*pass time=T"):
        LabelledScene(motion.canonical.subset(np.arange(3)), motion=motion)
