"""Mistakes that people make, and the words that help them on."""

import os
import shlex
import shutil
import zipfile
from pathlib import Path

import pytest

from drsplat.cli import main
from drsplat.errors import did_you_mean
from drsplat.formats.scenes import Kind, recognised
from toy_capture import write_balls


def test_what_is_near_is_suggested():
    assert did_you_mean("Vaze", ["mug", "Vase"]) == " Did you mean 'Vase'?"
    assert did_you_mean("lokate", ["locate", "view"]) == " Did you mean 'locate'?"
    assert did_you_mean("cup", ["cap", "cups"], most=1) == " Did you mean 'cups'?"


def test_what_is_far_is_not():
    assert did_you_mean("rote", ["carrot", "window"]) == ""
    assert did_you_mean("quantum", []) == ""


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One of each kind that people name: a toy capture with its scene and field, and what they take for these."""
    folder = write_balls(tmp_path_factory.mktemp("things"))
    capture = folder / "capture"
    for name, content in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    shutil.copy(capture / "images/photo_0.png", folder / "photos/0.png")
    (folder / "empty").mkdir()
    with zipfile.ZipFile(folder / "capture.zip", "w") as archive:
        archive.write(capture / "cameras.json", "cameras.json")
    return folder


FILES = {
    "video.mp4": b"", "unnamed": b"\0\0\0\x20ftypisom", "clips/a.mov": b"\0\0\0\x14ftypqt  ",
    "heic/IMG_1.HEIC": b"x", "heic/IMG_2.HEIC": b"x", "photo.jpg.1": b"\xff\xd8\xff\xe0", "live": b"\0\0\0\x18ftypheic",
    "photos/.hidden": b"", "hello.ply": b"hello", "mesh.obj": b"v 0 0 0", "notes.txt.gz": b"\x1f\x8b\x08",
    "points.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n",
    "earth/tileset.json": b"{}", "earth/0.glb": b"", "room.rrd": b"RRF2",
    "colmap/images/1.jpg": b"", "colmap/database.db": b"SQLite format 3\0",
}  # fmt: skip
MISTAKES = [
    # what is no capture
    ("train photos -o model", "photos without poses ... drsplat capture PHOTOS ... COLMAP ... from_a_phone.md"),
    ("train video.mp4 -o model", "got a video ... drsplat capture VIDEO ... poses"),
    ("embed unnamed", "got a video ... drsplat capture VIDEO"),
    ("embed clips", "got a video ... drsplat capture VIDEO"),
    ("train heic -o model", "HEIC ... drsplat capture PHOTOS ... poses"),
    ("train live -o model", "HEIC ... drsplat capture PHOTOS"),
    ("train capture.zip -o model", "got an archive ... unpack it"),
    ("train empty -o model", "got an empty folder ... COLMAP model"),
    ("train colmap -o model", "COLMAP's database ... mapper"),
    ("train capture/images -o model", "photos without poses ... did you mean capture?"),
    ("train captur -o model", "no such file or folder ... Did you mean 'capture'"),
    ("train scene.ply -o model", "got a scene ... photos that this scene was trained from"),
    ("train room.field -o model", "got a field ... photos that the scene of this field was trained from"),
    # what is no scene
    (
        "register capture scene.ply --features capture/language_features --output new.field",
        "got posed photos ... drsplat train ... takes the scene first",
    ),
    (
        "register scen.ply capture --features capture/language_features --output new.field",
        "no such file or folder ... Did you mean 'scene.ply'",
    ),
    ("inspect photo.jpg.1", "got a single photo"),
    ("inspect mesh.obj", "got a mesh ... drsplat train"),
    ("inspect points.ply", "points without Gaussians ... drsplat train"),
    ("inspect capture.zip", "got an archive ... unpack it"),
    ("inspect earth", "got 3D Tiles ... does not read them"),
    ("inspect earth/tileset.json", "got 3D Tiles ... does not read them"),
    ("export earth --output earth.glb", "got 3D Tiles ... does not read them"),
    ("inspect room.rrd", "got a recording of rerun ... does not read them"),
    ("inspect hello.ply", "hello.ply ... no scene format"),
    ("locate room.field 'red mug' --scene room.field", "got a field ... that this field was registered on"),
    # what is no field
    ("locate scene.ply 'red mug'", "expected a field ... got a scene ... drsplat register"),
    ("view capture", "expected a field ... got posed photos ... embed"),
    ("locate rom.field 'red mug'", "no such file or folder ... Did you mean 'room.field'"),
    ("locate 'red mug' room.field", "the field comes first ... room.field 'red mug'"),
    # what are no features
    ("register scene.ply capture --features capture/images -o n.field", "expected features"),
    ("register scene.ply capture --features nofeat -o n.field", "no such file ... drsplat embed"),
    # names and values
    ("locate room.field 'red mug' --click photo_0:1,1", "got WORDS and --click VIEW:X,Y"),
    ("locate room.field ''", "WORDS is empty: give a value"),
    ("edit scene.ply --click photo_0:1,1 --object 3 --remove", "--click and --object each name"),
    ("render scene.ply -o o.png", "--path orbit ... --views CAPTURE"),
    ("locate room.field 'red mug' --threshold 50%", "write 0.5 for 50%"),
    ("locate room.field 'red mug' --top-share 50%", "write 0.5 for 50%"),
    ("render scene.ply --views capture --view photo_9 -o o.png", "Did you mean 'photo_"),
    ("embed capture --segmenter graph --encoder clip", "AUTHOR/NAME ... laion/CLIP ... drsplat-mini"),
    ("embed capture --segmenter sam", "AUTHOR/NAME ... facebook/sam ... graph"),
    ("embed capture --without photo_00", "a photo's name on each line ... every:N"),
    ("evaluate lerf-ovs capture --scene scene.ply --field room.field --report r", "label/NAME ... no label/ in it"),
    ("train capture --resolution 3 -o model", "3x2 pixels ... 11x11 ... --resolution PIXELS ... divide"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("line", "said"), MISTAKES, ids=lambda part: part[:50])
def test_the_answer_to_a_mistake_says_the_way_on(line, said, things, monkeypatch, capsys):
    argv = shlex.split(line)
    if argv[0] == "view":
        pytest.importorskip("uvicorn", reason="the extra drsplat[viewer] is not installed")
    if {"sam", "clip"} & set(argv):
        pytest.importorskip("transformers", reason="the extra drsplat[models] is not installed")
    monkeypatch.chdir(things)
    capsys.readouterr()
    assert main(argv) in (1, 2)
    err = capsys.readouterr().err.splitlines()
    error = next(text for text in err if text.startswith("drsplat: error: "))
    assert [words for words in said.split(" ... ") if words not in error] == [], error
    assert len(error) < 420


def test_photos_that_are_small_are_warned_of(things, tmp_path, capsys):
    argv = [things / "capture", "--resolution", "4", "--iterations", "1", "--output-dir", tmp_path / "model"]
    assert main(["train", *map(str, argv), "--device", "cpu"]) == 0
    assert "warning: photos of 24x18 pixels" in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with a name")
def test_a_pipe_is_recognised_without_waiting_for_its_writer(tmp_path):
    os.mkfifo(tmp_path / "pipe.mp4")
    assert recognised(tmp_path / "pipe.mp4") is Kind.OTHER
    assert recognised(tmp_path / "nothing") is None
