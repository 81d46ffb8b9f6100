"""`drsplat objects`, and the same in Python: what is listed, written, drawn and named."""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from command_line import Capture, Line, answer_of, error_of
from drsplat import Scene, load_field, open_scene, read_gaussians, write_gaussians
from drsplat.drawing.cards import (
    GAP_PIXELS,
    HEADING_PIXELS,
    LINE_SPACING,
    MARGIN_PIXELS,
    NOTE_PIXELS,
    TILE_PIXELS,
    cut_out,
)
from drsplat.drawing.pictures import PAPER
from drsplat.formats.poses import write_cameras_json
from drsplat.fronts.commands import objects as objects_command
from known_objects import CENTERS, EACH, VIEWS, described, known_field, known_scene
from refusing import refused
from scenes import look_at_view

EYES = ((0.5, -4.0, 1.5), (1.5, -4.5, 2.0), (2.5, -4.0, 1.0))


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """scene.ply, capture/ and a.field with objects, as `drsplat register` leaves them."""
    gaussians = known_scene()
    field = known_field(gaussians)
    thick = np.full_like(gaussians.scales, 0.02)  # so that photos show more than dots
    write_gaussians(tmp_path / "scene.ply", replace(gaussians, scales=thick))
    field.with_objects(described(field, read_gaussians(tmp_path / "scene.ply"))).save(tmp_path / "a.field")
    (tmp_path / "capture/images").mkdir(parents=True)
    views = [replace(look_at_view(eye, (1.5, 0, 0)), name=name) for eye, name in zip(EYES, VIEWS, strict=True)]
    write_cameras_json(tmp_path / "capture/cameras.json", views)
    for view in views:
        Image.new("RGB", (view.width, view.height), (90, 140, 200)).save(tmp_path / "capture/images" / view.name)
    return tmp_path


@pytest.fixture
def listed(room: Path, capsys: Capture) -> Line:
    return Line(capsys, "objects", room / "a.field", "--scene", room / "scene.ply")


def test_the_list(listed):
    told = listed()
    assert told["num_objects"] == 3
    assert told["num_in_objects"] == 3 * EACH - 10
    assert [one["id"] for one in told["objects"]] == [0, 1, 2]
    for one, center in zip(told["objects"], CENTERS, strict=True):
        assert_allclose(one["center"], center, atol=0.03)
        assert_allclose(one["extent"], (0.46, 0.26, 0.17), rtol=0.05)
        assert np.shape(one["axes"]) == (3, 3)
        assert one["num_views"] == 3
        assert sorted(one["views"]) == list(VIEWS)
        assert one["label"] is one["name"] is None  # nobody embeds words for this field
    assert told["objects"][0]["sure"] == pytest.approx(0.8)
    assert told["objects"][0]["mass"] == pytest.approx(EACH, rel=1e-4)


def test_the_list_needs_no_scene_once_it_is_kept(room, capsys, listed):
    alone, with_scene = answer_of(capsys, "objects", room / "a.field"), listed()
    assert [one.pop("surface") for one in alone["objects"]] == [None] * 3  # which takes the Gaussians
    assert [one.pop("surface") for one in with_scene["objects"]] == [False] * 3
    assert alone == with_scene


def test_surfaces_and_what_few_photos_see_are_told(monkeypatch, listed):
    assert [one["few_photos"] for one in listed()["objects"]] == [True] * 3  # all see three
    monkeypatch.setattr("drsplat.query.documents.FEW_PHOTOS", 2)
    monkeypatch.setattr("drsplat.field.objects.surfaces.MIN_SIDE_AROUND", 0.01)
    told = listed()["objects"]
    assert [(one["few_photos"], one["surface"]) for one in told] == [(False, True)] * 3
    listed("--label", "red, mug", "--id", 1)
    text = listed.text()
    assert "red, mug, surface" in text
    assert "few photos" not in text


def test_inspect_counts_them(room, capsys):
    assert answer_of(capsys, "inspect", room / "a.field")["num_objects"] == 3
    load_field(room / "a.field").with_objects(None).save(room / "b.field")
    assert answer_of(capsys, "inspect", room / "b.field")["num_objects"] is None


def test_the_table(listed):
    text = listed.text()
    assert text.startswith("3 objects, 1,490 of 1,490 registered Gaussians in them")
    assert "0.80" in text


def test_the_table_has_the_first_and_counts_the_rest(monkeypatch, listed):
    """A real capture has hundreds of objects, of which the last are crumbs."""
    monkeypatch.setattr(objects_command, "MAX_ROWS_SHOWN", 2)
    text = listed.text()
    assert [line.split()[0] for line in text.splitlines() if line.strip()[:1].isdigit()][1:] == ["0", "1"]
    assert "and 1 with less mass: --json, or --save OUT.csv, has all" in text


def test_ids_of_every_gaussian(room, listed):
    listed("--save", room / "ids.npy")
    ids = np.load(room / "ids.npy")
    assert ids.dtype == np.int32
    assert_array_equal(ids, [*np.repeat([0, 1, 2], [EACH, EACH, EACH - 10]), *[-1] * 10])


def test_a_scene_with_a_column(room, listed):
    listed("--save", room / "objects.ply")
    saved = read_gaussians(room / "objects.ply")
    assert saved.fingerprint == read_gaussians(room / "scene.ply").fingerprint
    assert_array_equal(saved.extra["object_id"], open_scene(room / "a.field").object_ids())


def test_a_folder_of_objects(room, listed):
    told = listed("--save", room / "cut")
    assert sorted(path.name for path in (room / "cut").iterdir()) == [
        "object_0000.ply", "object_0001.ply", "object_0002.ply", "objects.json",
    ]  # fmt: skip
    assert len(read_gaussians(room / "cut/object_0002.ply")) == EACH - 10
    assert json.loads((room / "cut/objects.json").read_text())["objects"] == told["objects"]
    assert "exists already" in listed.error("--save", room / "cut")
    listed("--save", room / "cut", "--overwrite")
    (room / "mine").mkdir()
    assert "not ours to replace" in listed.error("--save", room / "mine", "--overwrite")


def test_tables(room, listed):
    told = listed("--save", room / "o.json")
    document = json.loads((room / "o.json").read_text())
    assert document["objects"] == told["objects"]
    assert document["field"] == load_field(room / "a.field").fingerprint
    listed("--save", room / "o.csv", "--label", 'a "red", mug', "--id", 1)
    with open(room / "o.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["label"] for row in rows] == ["", 'a "red", mug', ""]
    assert float(rows[2]["center_0"]) == told["objects"][2]["center"][0]
    assert float(rows[0]["axes_8"]) == pytest.approx(1)
    assert rows[0]["views"].split(";") == told["objects"][0]["views"]


@pytest.mark.parametrize("label", ["=1+1", "+1", "-1", "@SUM(1)", '=HYPERLINK("http://evil.example","mug")'])
def test_tables_hold_no_formulas(room, label, listed):
    listed("--save", room / "o.csv", f"--label={label}", "--id", 1)
    with open(room / "o.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["label"] for row in rows] == ["", f"'{label}", ""]
    assert any(row["center_1"].startswith("-") for row in rows)  # numbers stay numbers
    assert float(rows[0]["center_0"]) == pytest.approx(0, abs=0.2)
    listed("--save", room / "o.json")
    assert json.loads((room / "o.json").read_text())["objects"][1]["label"] == label


PHOTO, GHOST = (90, 140, 200), 232  # of a photo of one colour: its pale grey is 255 - 0.16 * (255 - luma)


def test_the_sheet_shows_each_object_on_its_pale_surroundings(room, listed):
    listed("--views", room / "capture", "--picture", room / "sheet.png")
    sheet = np.asarray(Image.open(room / "sheet.png").convert("RGB"))
    left, top = (
        MARGIN_PIXELS + 1,
        MARGIN_PIXELS + sum(round(LINE_SPACING * size) for size in (HEADING_PIXELS, NOTE_PIXELS)) + GAP_PIXELS + 1,
    )
    step = TILE_PIXELS[0] + 2 + GAP_PIXELS
    assert sheet.shape[1] == 2 * MARGIN_PIXELS + 3 * step - GAP_PIXELS
    tiles = [sheet[top : top + 240, left + n * step : left + n * step + 320].astype(int) for n in range(3)]
    for tile in tiles:
        lit = np.abs(tile - PHOTO).max(axis=2) < 12  # the object's place in the photo
        pale = np.abs(tile - GHOST).max(axis=2) < 12
        assert 0.05 < lit.mean() < 0.9
        assert pale.mean() > 0.1
        assert np.abs(np.argwhere(lit).mean(axis=0) - (120, 160)).max() < 30  # in the middle
    captions = sheet[top + 242 : top + 320]
    assert (captions.min(axis=2) < 60).any(axis=0).sum() > 20  # names, in ink
    assert tuple(np.median(captions.reshape(-1, 3), axis=0)) == PAPER


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--save", "x.txt"), "ends in .npy, .ply, .json or .csv"),
        (("--save", "nowhere/x.npy"), "there is no folder"),
        (("--picture", "x.gif"), ".png or .jpg"),
        (("--picture", "x.jpg"), "--views CAPTURE"),
        (("--label", "mug"), "--id N"),
        (("--id", "1"), "--label NAME"),
        (("--label", "mug", "--id", "3"), "there is no object 3: there are 0 to 2"),
        (("--label", "  ", "--id", "1"), "expected a text"),
    ],
)
def test_bad_input(more, said, room, monkeypatch, listed):
    monkeypatch.chdir(room)
    assert said in listed.error(*more)
    assert not list(room.glob("x.*"))


def test_a_field_without_objects_needs_the_scene(room, capsys):
    load_field(room / "a.field").with_objects(None).save(room / "b.field")
    assert "pass --scene SCENE" in error_of(capsys, "objects", room / "b.field")
    with refused("nobody has looked"):
        _ = open_scene(room / "b.field").objects


def test_they_are_found_once_and_kept(room, capsys, monkeypatch, listed):
    load_field(room / "a.field").with_objects(None).save(room / "b.field")
    calls = []

    def find_objects(field, gaussians, *, threads=0):
        calls.append(threads)
        return described(field, gaussians, threads)

    found = ModuleType("drsplat.field.objects.finding")
    found.find_objects = find_objects
    monkeypatch.setitem(sys.modules, "drsplat.field.objects.finding", found)
    again = Line(capsys, "objects", room / "b.field", "--scene", room / "scene.ply", "--threads", 1)
    told = again()
    assert told["objects"] == listed()["objects"]
    assert again()["objects"] == told["objects"]
    assert calls == [1]
    again("--again")
    assert calls == [1, 1]
    assert load_field(room / "b.field").fingerprint == load_field(room / "a.field").fingerprint


def test_nothing_belongs_together(room, capsys):
    field = load_field(room / "a.field")
    empty = {name: array[:0] for name, array in field.objects.tensors().items()}
    empty |= {"node_of": np.full(len(field), -1, np.int32)}
    empty |= {name: np.zeros(1, np.int64) for name in ("mask_starts", "descriptor_starts")}
    field.with_objects(type(field.objects)(**empty)).save(room / "b.field")
    none = Line(capsys, "objects", room / "b.field", "--scene", room / "scene.ply")
    told = none("--save", room / "ids.npy")
    assert told["num_objects"] == 0
    assert told["objects"] == []
    assert (np.load(room / "ids.npy") == -1).all()
    assert none.text().startswith("0 objects, 0 of 1,490")
    assert "this field has none" in none.error("--label", "mug", "--id", 0)
    assert "no object" in none.error("--views", room / "capture", "--picture", room / "a.png")


def test_what_is_at_a_place(room):
    scene = open_scene(room / "a.field", scene=room / "scene.ply", views=room / "capture")
    assert scene.object_at(0) == [0, 2, 5]
    assert scene.object_at(EACH) == [3, 5]
    assert scene.object_at(CENTERS[2]) == [4]
    view = scene.views[0]
    seen = view.K @ (view.cam_from_world[:3] @ [*CENTERS[1], 1.0])
    assert scene.object_at((view.name, seen[0] / seen[2], seen[1] / seen[2])) == [3, 5]
    with refused("no feature"):
        scene.object_at(3 * EACH - 1)
    with refused("nothing with a feature"):
        scene.object_at((50.0, 0.0, 0.0))
    with refused("no Gaussian at pixel"):
        scene.object_at((view.name, 1.0, 1.0))
    assert scene.field.objects is not None
    lonely = replace(scene.field.objects, node_of=np.full(len(scene.field), -1, np.int32))
    with refused("belongs to no object"):
        Scene(scene.field.with_objects(lonely), scene.gaussians).object_at(0)


def test_objects_are_matches(room):
    scene = open_scene(room / "a.field")
    matches = scene.objects
    assert [match.object_id for match in matches] == [0, 1, 2]
    assert_array_equal(matches[2].gaussian_ids, np.arange(2 * EACH, 3 * EACH - 10))
    assert [one.mask_id for one in matches[1].support] == [1, 4, 8]
    assert sum(one.share for one in matches[1].support) == pytest.approx(1)
    assert replace(scene.field, evidence=None).objects is not None
    assert Scene(replace(scene.field, evidence=None)).objects[0].support == ()


@pytest.mark.parametrize("corner", [(0, 0), (71, 95)])
def test_a_cut_out_stays_in_the_photo(corner):
    """And a thing that is hardly seen is still looked for."""
    share = np.zeros((72, 96), np.float32)
    rows, columns = (slice(max(at - 8, 0), at + 8) for at in corner)
    share[rows, columns] = 0.2
    photo = np.full((72, 96, 3), 100, np.uint8)
    tile = cut_out(photo, share)
    assert tile.shape == (240, 320, 3)
    assert tile.max() < 235  # the ghost is 230; paper, 255, would be beyond the photo
    assert tile.min() < 215
    assert np.abs(np.argwhere(tile[..., 0] < 215).mean(axis=0) - (120, 160)).max() > 30


@pytest.mark.parametrize("light", [0, 255])
def test_a_cut_out_is_seen_whatever_its_colour(light):
    """Black and white things alike differ from what is around them by a grey line, and black ones by themselves."""
    share = np.zeros((72, 96), np.float32)
    share[24:48, 32:64] = 1
    tile = cut_out(np.full((72, 96, 3), light, np.uint8), share).astype(int)
    middle, corner, row = tile[120, 160], tile[5, 5], tile[120, :, 0]
    assert middle.tolist() == [light] * 3
    assert corner.min() >= 213  # 255 - 0.16 * 255 at the darkest: never a black cell
    assert row.min() < 140
    assert (row < 140).sum() >= 2


def test_nothing_seen_is_the_whole_photo():
    tile = cut_out(np.full((72, 96, 3), 200, np.uint8), np.zeros((72, 96), np.float32))
    assert (tile == 246).all()  # 255 - 0.16 * (255 - 200)
