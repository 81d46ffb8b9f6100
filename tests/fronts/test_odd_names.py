"""Files whose names are not UTF-8: what a verb writes of them with exit code 0 can be read, or nothing is written."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from command_line import answer_of
from drsplat.formats.json_files import written_name
from drsplat.formats.rendering_record import read_rendering_record
from drsplat.formats.tiles import read_tiles

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="file names are text here")

ODD = os.fsdecode(b"b\xff")


@pytest.fixture
def odd_room(room: Path) -> Path:
    """A scene, its field and its capture under odd names."""
    odd = room / ODD
    odd.mkdir()
    shutil.copytree(room / "room.field", odd / f"{ODD}.field")
    shutil.copyfile(room / "scene.ply", odd / f"{ODD}.ply")
    return odd


def test_a_name_is_written_byte_by_byte():
    assert written_name(ODD) == r"b\xff"
    assert written_name("väse") == "väse"


def test_tiles_of_a_scene_with_an_odd_name_can_be_read(odd_room, capsys):
    scene, output = odd_room / f"{ODD}.ply", odd_room / f"{ODD}.tiles"
    assert answer_of(capsys, "tile", scene, "--output", output)["sources"] == [r"b\xff.ply"]
    assert read_tiles(output).sources == (r"b\xff.ply",)
    answer_of(capsys, "inspect", output)


def test_photographs_of_a_scene_with_an_odd_name_can_be_read(odd_room, capsys):
    scene, output = odd_room / f"{ODD}.ply", odd_room / "capture"
    answer_of(capsys, "photograph", scene, "--output", output, "--number", 3, "--size", "48x32")
    record = read_rendering_record(output)
    assert record["scene"]["name"] == r"b\xff.ply"
    answer_of(capsys, "inspect", output)


@pytest.mark.parametrize("suffix", ["glb", "ply", "spz", "usda"])
def test_exports_of_a_scene_with_an_odd_name_can_be_read(suffix, odd_room, capsys):
    if suffix == "usda":
        pytest.importorskip("pxr")
    output = odd_room / f"{ODD} out.{suffix}"
    given = (odd_room / f"{ODD}.ply", "--field", odd_room / f"{ODD}.field")
    answer_of(capsys, "export", *given, "--output", output)
    answer_of(capsys, "inspect", output)


def test_edits_and_labels_beside_odd_names_can_be_read(odd_room, capsys):
    scene, field = odd_room / f"{ODD}.ply", odd_room / f"{ODD}.field"
    answer_of(capsys, "edit", scene, "--field", field, "--object", 0, "--recolour", "#2060ff")
    answer_of(capsys, "objects", field, "--label", "my thing", "--id", 0)
    answer_of(capsys, "inspect", field)
    assert answer_of(capsys, "edit", scene)["edits"]


@pytest.mark.parametrize("odd", ["input", "output"])
def test_a_scan_whose_record_could_not_be_read_is_refused_first(odd, tmp_path, capsys):
    photos = tmp_path / (ODD if odd == "input" else "photos")
    photos.mkdir()
    (photos / "a.png").write_bytes(b"")
    output = tmp_path / (ODD if odd == "output" else "scan")
    answer = answer_of(capsys, "scan", photos, "--output", output, code=1)
    assert "expected a path in UTF-8" in answer["error"]
    assert ODD in answer["error"]
    assert not output.exists()
