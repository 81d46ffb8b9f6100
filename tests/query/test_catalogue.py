"""Many scenes at once: what is found, in which, and what whoever reads sees while others write."""

import io
import itertools
import json
import re
import subprocess
import sys
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from PIL import Image

from catalogued import add_plain, boxes_of, edit_document, unit, write_scene
from command_line import answer_of, error_of
from drsplat import EncoderIdentity, Query, Scene, WordEncoder, load_field, read_gaussians
from drsplat.cli import main
from drsplat.errors import DrSplatWarning, MismatchError
from drsplat.formats.replacing import NoRoom
from drsplat.formats.tensors import header_checksum, map_tensors, write_tensors
from drsplat.formats.tiles import write_tiles
from drsplat.query.catalogue import Catalogue, Conditions, changes, reading, snapshot
from drsplat.query.catalogue.rows import MAX_BYTES, thumbnail
from drsplat.query.catalogue.snapshot import DOCUMENT
from drsplat.query.objects import support_of
from full_disk import files_of_at_most
from known_objects import CENTERS, EACH, known_scene
from refusing import malformed, refused

ANYWHERE = Conditions()
WORDS = {"kitchen": ("red mug", "wooden table", "green plant"), "o'hara": ("blue mug", "red chair", "white lamp")}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for number, (name, words) in enumerate(WORDS.items()):
        write_scene(folder / name, words, moved=10.0 * number)
    return folder


@pytest.fixture(scope="module")
def filled(scenes, tmp_path_factory) -> Catalogue:
    catalogue = Catalogue.open(tmp_path_factory.mktemp("c") / "flats.catalogue")
    for name in WORDS:
        catalogue.add(scenes / name)
    return catalogue


@pytest.fixture
def catalogue(tmp_path) -> Catalogue:
    """An empty one, in a folder that is not there yet."""
    return Catalogue.open(tmp_path / "c")


def found(
    catalogue: Catalogue, query: Query | str, where: Conditions = ANYWHERE, **options: Any
) -> list[tuple[str, int]]:
    return [(entry.scene, entry.object_id) for entry in catalogue.ask(query, where, **options)]


# --- asking ---


def test_the_best_objects_of_all_scenes(filled):
    assert found(filled, "red mug") == [("kitchen", 0)]
    assert found(filled, "mug") == [("kitchen", 0), ("o'hara", 0)]
    assert found(filled, "mug", top=1) == [("kitchen", 0)]
    assert found(filled, "lamp") == [("o'hara", 2)]
    assert found(filled, "elephant") == []
    assert len(filled) == 6


def test_no_more_scenes_are_asked_than_answers_need(filled, monkeypatch):
    asked, real = [], reading.SceneRules.scene

    def counted(rules, snapshot, place):
        asked.append(place.entry.scene)
        return real(rules, snapshot, place)

    monkeypatch.setattr(reading.SceneRules, "scene", counted)
    assert (found(filled, "mug", top=1), asked) == ([("kitchen", 0)], ["kitchen"])


def test_exclusions_and_thresholds_mean_what_they_mean_in_a_scene(filled):
    assert found(filled, "mug, not red") == [("o'hara", 0)]
    assert found(filled, Query("mug", exclude=("red",))) == [("o'hara", 0)]
    assert found(filled, Query("mug", threshold=0.99)) == []
    assert len(found(filled, Query("mug", threshold=-1.0))) == 6
    answer = filled.answer(Query("red mug", relevancy=True))
    assert (answer.measure, answer.threshold) == ("relevancy", 0.5)
    assert [entry.scene for entry in answer.entries[:2]] == ["kitchen", "o'hara"]
    vector = WordEncoder().encode_texts(["white lamp"])[0]
    assert found(filled, Query(vector=vector)) == [("o'hara", 2)]


def test_what_means_nothing_across_scenes_is_refused(filled):
    for query in (Query(point=(0.0, 0.0, 0.0)), Query(click=("a", 1.0, 1.0)), Query("mug", top_share=0.1)):
        with refused("one scene only"):
            filled.ask(query)
    with pytest.raises(MismatchError, match="3 numbers"):
        filled.ask(Query(vector=np.ones(3, np.float32)))
    with refused("top: expected 1 to"):
        filled.ask("mug", top=0)


def test_filters(filled):
    assert found(filled, "mug", Conditions(scenes=("o'hara",))) == [("o'hara", 0)]
    assert found(filled, "mug", Conditions(scenes=("nobody",))) == []
    assert found(filled, "mug", Conditions(box=(-1.0, -1.0, -1.0, 1.0, 1.0, 1.0))) == [("kitchen", 0)]
    now = datetime.now(UTC)
    assert found(filled, "mug", Conditions(since=now + timedelta(hours=1))) == []
    assert len(found(filled, "mug", Conditions(since=now - timedelta(hours=1)))) == 2
    assert found(filled, "mug", Conditions(area=(-180.0, -90.0, 180.0, 90.0))) == []  # none has a georeference


def test_an_answer_says_what_it_is(filled, scenes):
    (entry,) = filled.ask("white lamp")
    field = load_field(scenes / "o'hara/a.field")
    assert (entry.scene, entry.tile, entry.object_id, entry.photo) == ("o'hara", 0, 2, entry.photo)
    assert entry.score == pytest.approx(1.0, abs=2e-3)
    assert_allclose(entry.center, np.add(CENTERS[2], (10, 0, 0)), atol=0.02)
    assert_allclose(entry.extent, field.objects.extents[field.objects.thing(2)], rtol=1e-6)
    assert entry.field == field.fingerprint
    masks = {(mask.view_name, mask.mask_id) for mask in support_of(field, field.objects.thing(2))}
    assert (entry.photo, entry.mask) in masks
    picture = entry.picture()
    assert picture.shape == (180, 240, 3)
    assert entry.thumbnail == filled.thumbnail("o'hara", 2)
    assert json.loads(json.dumps(entry.json()))["scene"] == "o'hara"


def test_exact_answers_are_those_of_all_descriptors(catalogue):
    rng, encoder = default_rng(1), EncoderIdentity("test", 24)
    vectors = unit(rng, 800, 24)
    add_plain(catalogue.path, "one", vectors[:500], encoder)
    add_plain(catalogue.path, "two", vectors[500:], encoder)
    query = unit(rng, 24)
    stored = np.rint(vectors * (127 / np.abs(vectors).max(axis=1, keepdims=True)))
    stored /= np.linalg.norm(stored, axis=1, keepdims=True)
    assert_allclose(stored @ query, vectors @ query, atol=0.01)
    best = (stored.astype(np.float32).reshape(400, 2, 24) @ query).max(1)
    order = np.argsort(-best)[:20]
    expected = [("one", int(at)) if at < 250 else ("two", int(at) - 250) for at in order]
    with refused("so words must be too: pass encoder=NAME"):
        catalogue.ask("mug")
    answer = catalogue.answer(Query(vector=query, threshold=-1.0), top=20)
    assert [(entry.scene, entry.object_id) for entry in answer.entries] == expected
    assert answer.exact
    assert_allclose([entry.score for entry in answer.entries], best[order], atol=1e-3)


@pytest.mark.parametrize("name", ["", "a" * 201, "a\0b", "\ud800"])
def test_names_that_are_none(filled, name):
    with refused("a scene's name"):
        Conditions(scenes=(name,))


def test_boxes_and_times_that_are_none():
    with refused("expected a list of names"):
        Conditions("kitchen")
    for wrong in ({"box": (1.0, 0.0, 0.0, 0.0, 1.0, 1.0)}, {"box": (0.0, 0.0, 0.0, 1.0, 1.0, float("nan"))},
                  {"area": (0.0, 5.0, 1.0, 4.0)}, {"area": (0.0, 0.0, 181.0, 4.0)},
                  {"since": datetime(2026, 1, 1)}):  # fmt: skip
        with refused(r"box|area|since"):
            Conditions(**wrong)


def test_places_on_the_earth(tmp_path, catalogue):
    folder = write_scene(tmp_path / "roof", WORDS["kitchen"], photos=False)
    here = {"format": "drsplat georeference", "version": 1, "longitude": 13.4, "latitude": 52.5, "height": 80.0,
            "scale": 10.0, "enu_from_world": np.eye(3).tolist()}  # fmt: skip
    (folder / "georeference.json").write_text(json.dumps(here))
    with pytest.warns(DrSplatWarning, match="no thumbnails"):
        catalogue.add(folder)
    (entry,) = catalogue.ask("green plant")  # 3 units, 30 metres, to the east
    assert_allclose(entry.position[:2], (13.4 + 30 / 67_900, 52.5), atol=5e-6)
    assert entry.position.height == pytest.approx(80, abs=0.02)
    east = Conditions(area=(13.4002, 52.4, 13.5, 52.6))
    assert found(catalogue, "green plant", east) == [("roof", 2)]
    assert found(catalogue, "red mug", east) == []
    assert found(catalogue, "red mug", Conditions(area=(179.0, 52.4, 13.40001, 52.6))) == [
        ("roof", 0)
    ]  # round the back


# --- adding and removing ---


def test_a_scene_that_is_added_again_takes_its_place(scenes, catalogue):
    catalogue.add(scenes / "kitchen")
    field = load_field(scenes / "kitchen/a.field")
    opened = Scene(boxes_of(("red mug", "red bowl", "red rug"), known_scene()), known_scene(), name="kitchen")
    with pytest.warns(DrSplatWarning, match="no thumbnails"):
        listed = catalogue.add(opened)
    assert listed.field != field.fingerprint
    assert found(catalogue, "green plant") == []
    assert found(catalogue, "red rug") == [("kitchen", 2)]
    assert [(one.scene, one.num_objects, one.state) for one in catalogue.scenes()] == [("kitchen", 3, "unknown")]
    assert catalogue.ask("red rug")[0].thumbnail is None
    with refused("has no thumbnail"):
        catalogue.thumbnail("kitchen", 2)


def test_all_objects_of_a_scene_in_tiles(tmp_path, catalogue):
    """Once each, also those across a border, with the tile that has most of them."""
    folder = write_scene(tmp_path / "kitchen", WORDS["kitchen"])
    whole = read_gaussians(folder / "scene.ply")
    count = len(whole)
    extra = {"block": np.zeros(count, np.uint16), "source_row": np.arange(count, dtype=np.uint32)}
    border = EACH + EACH // 3  # within the second box
    parts = (replace(whole, extra=extra).subset(np.arange(*ends)) for ends in ((0, border), (border, count)))
    tiles = write_tiles(folder / "scene.tiles", parts, whole.origin, ["scene.ply"], overwrite=False)
    assert (len(tiles.tiles), tiles.fingerprint) == (2, whole.fingerprint)
    (folder / "scene.ply").unlink()
    for _ in range(2):
        assert catalogue.add(folder).num_objects == 3
        entries = catalogue.ask(Query(vector=WordEncoder().encode_texts(["mug"])[0], threshold=-1.0))
        by_place = sorted((float(entry.center[0]), entry.tile) for entry in entries)
        assert [tile for _, tile in by_place] == [0, 1, 1]
        assert all(catalogue.thumbnail(one.scene, one.object_id, one.tile) == one.thumbnail for one in entries)


def test_removing(scenes, catalogue):
    for name in WORDS:
        catalogue.add(scenes / name)
    assert catalogue.remove("o'hara") == 3
    assert found(catalogue, "mug") == [("kitchen", 0)]
    assert catalogue.remove("o'hara") is None  # a killed command is given again
    with refused(r"there is no scene \"o'neill\""):
        catalogue.remove("o'neill")
    catalogue.remove("kitchen")
    assert (len(catalogue), catalogue.scenes(), catalogue.ask("mug")) == (0, [], [])


def test_stale_scenes_are_told(tmp_path, catalogue):
    for name, words in WORDS.items():
        catalogue.add(write_scene(tmp_path / name, words))
    assert [one.state for one in catalogue.scenes()] == ["current", "current"]
    gaussians = known_scene()
    boxes_of(("red bowl", "red rug", "red sofa"), gaussians).save(tmp_path / "kitchen/a.field", overwrite=True)
    (tmp_path / "o'hara").rename(tmp_path / "elsewhere")
    assert [(one.scene, one.state) for one in catalogue.scenes()] == [("kitchen", "changed"), ("o'hara", "missing")]


def test_another_encoder_is_refused(filled):
    other = EncoderIdentity("somebody", 512, "abc")
    gaussians = known_scene()
    with pytest.raises(MismatchError, match=r"somebody.*a catalogue has one encoder"):
        filled.add(Scene(boxes_of(WORDS["kitchen"], gaussians, other), gaussians, name="x"))
    assert len(filled) == 6


def test_a_field_without_objects_says_how_to_find_them(tmp_path, catalogue):
    gaussians = known_scene()
    field = boxes_of(WORDS["kitchen"], gaussians).with_objects(None)
    with refused("drsplat objects FIELD --scene SCENE"):
        catalogue.add(Scene(field, gaussians))
    assert not (tmp_path / "c").exists()


def test_two_scenes_of_one_name_are_told_apart(scenes, tmp_path, catalogue):
    catalogue.add(scenes / "kitchen")
    other = write_scene(tmp_path / "kitchen", WORDS["o'hara"], photos=False)
    with refused("pass name=NAME"):
        catalogue.add(other)
    with pytest.warns(DrSplatWarning, match="second: no thumbnails"):
        catalogue.add(other, name="second")
    assert [one.scene for one in catalogue.scenes()] == ["kitchen", "second"]


def test_thumbnails_are_small_whatever_they_show():
    noise = default_rng(0).integers(0, 256, (900, 1200, 3), np.uint8)
    data = thumbnail(noise)
    assert len(data) <= MAX_BYTES
    assert Image.open(io.BytesIO(data)).format == "JPEG"


# --- many at once ---


def test_what_is_usual_stays_while_a_large_table_hardly_changes(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    monkeypatch.setattr("drsplat.query.catalogue.catalogue.LARGE_ROWS", 200)
    catalogue, asked = Catalogue.open(path), []
    for name, size in (("small", 150), ("more", 250), ("hardly", 2), ("much", 50)):
        add_plain(path, name, unit(rng, size, 16), encoder, 1)
        asked.append(catalogue._surroundings(catalogue._snapshot()).usual)
    assert [a is b for a, b in itertools.pairwise(asked)] == [False, True, False]
    catalogue.remove("hardly")
    catalogue.remove("much")
    catalogue.remove("more")  # is small again: every change counts
    assert len(catalogue._surroundings(catalogue._snapshot()).usual) == 150


@pytest.mark.slow
def test_writers_take_turns(scenes, tmp_path):
    """Two processes add at once, and a thread of this one."""
    code = "import sys; from drsplat.query.catalogue import Catalogue; Catalogue.open(sys.argv[1]).add(sys.argv[2])"
    path = tmp_path / "c"
    processes = [
        subprocess.Popen([sys.executable, "-c", code, str(path), str(scenes / name)], stderr=subprocess.PIPE)
        for name in WORDS
    ]
    Catalogue.open(path).add(scenes / "kitchen")
    for process in processes:
        _, error = process.communicate(timeout=120)
        assert process.returncode == 0, error.decode()
    assert [(one.scene, one.num_objects) for one in Catalogue.open(path).scenes()] == [("kitchen", 3), ("o'hara", 3)]


@pytest.mark.parametrize("coded", [False, True])
def test_whoever_asks_while_others_write_sees_whole_changes(tmp_path, coded):
    """Scenes come, are replaced and go; one stays, and each answer has all of it and whole others."""
    rng, encoder, path = default_rng(3), EncoderIdentity("test", 16), tmp_path / "c"
    own = unit(rng, 16)
    add_plain(path, "stays", np.repeat(own[None], 300, axis=0), encoder, 1)
    wrong, answers, done = [], [], threading.Event()

    def ask():
        catalogue = Catalogue.open(path)
        while not done.is_set():
            entries = catalogue.ask(Query(vector=own, threshold=0.5), top=1000)
            counts = {name: sum(e.scene == name for e in entries) for name in {e.scene for e in entries}}
            answers.append(1)
            if counts.pop("stays", 0) != 300 or any(count not in (10, 15) for count in counts.values()):
                wrong.append(str(counts))

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for number in range(12):
        name, size = f"comes{number % 3}", (10, 15)[number % 2]
        add_plain(path, name, np.repeat(own[None], size, axis=0), encoder, 1)
        if number % 4 == 3:
            Catalogue.open(path).remove(name)
        if coded and number % 6 == 2:
            Catalogue.open(path).build_index()
    done.set()
    for thread in threads:
        thread.join()
    assert (wrong, len(answers) > 3) == ([], True)
    assert sorted(path.iterdir()) == sorted(path / name for name in Catalogue.open(path).verify())


def test_small_parts_are_put_together_and_removed_objects_leave_the_disk(tmp_path):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    vectors, catalogue = unit(rng, 32, 16), Catalogue.open(path)
    for number in range(32):
        add_plain(path, f"s{number}", vectors[number : number + 1], encoder, 1)
        assert len(list(path.glob("rows-*"))) <= 6
    assert len(list(path.glob("rows-*"))) == 1
    for number in range(32):
        assert found(catalogue, Query(vector=vectors[number], threshold=0.99)) == [(f"s{number}", 0)]
    for number in range(30):
        catalogue.remove(f"s{number}")
        parts = catalogue._snapshot().parts
        assert sum(map(len, parts)) <= 2 * len(catalogue)
        assert found(catalogue, Query(vector=vectors[number], threshold=0.99)) == []
    assert found(catalogue, Query(vector=vectors[31], threshold=0.99)) == [("s31", 0)]


def test_no_part_grows_beyond_its_limit(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    monkeypatch.setattr(changes, "MOST_OBJECTS", 4)
    for number in range(8):
        add_plain(path, f"s{number}", unit(rng, 2, 16), encoder, 1)
    assert sorted(len(part) for part in Catalogue.open(path)._snapshot().parts) == [4, 4, 4, 4]


KILLED = """
import os, sys
from pathlib import Path
from drsplat.query.catalogue import Catalogue, changes
name, at, act, path, *more = sys.argv[1:]
where = {"unlink": Path, "replace": os}.get(name, changes)
real, times = getattr(where, name), []
def killed(*given, **how):
    times.append(1)
    os.kill(os.getpid(), 9) if len(times) == int(at) else None
    return real(*given, **how)
setattr(where, name, killed)
getattr(Catalogue.open(path), act)(*more)
raise SystemExit(len(times))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "at"),
    [("write_json", 1), ("write_json", 2), ("write_tensors", 1), ("replace", 1), ("replace", 2), ("replace", 3),
     ("unlink", 1)],
)  # fmt: skip
@pytest.mark.parametrize("act", ["add", "remove", "first"])
def test_a_kill_leaves_one_version_or_the_other(scenes, catalogue, name, at, act):
    if act != "first":
        for scene in WORDS:
            catalogue.add(scenes / scene, name=scene)
    before = [one.scene for one in catalogue.scenes()]
    more = "kitchen" if act == "remove" else str(scenes / "kitchen")
    command = [sys.executable, "-W", "ignore", "-c", KILLED, name, str(at), "remove" if act == "remove" else "add"]
    ended = subprocess.run([*command, str(catalogue.path), more], check=False, capture_output=True, text=True)
    assert ended.returncode == -9 or ended.returncode < at, ended.stderr
    after = ["o'hara"] if act == "remove" else sorted({*before, "kitchen"})
    assert [one.scene for one in catalogue.scenes()] in (before, after)
    catalogue.verify()
    catalogue.remove("kitchen") if act == "remove" else catalogue.add(scenes / "kitchen")  # the same command again
    assert [one.scene for one in catalogue.scenes()] == after
    assert [one.num_objects for one in catalogue.scenes()] == [3] * len(after)


def test_what_a_killed_writer_left_goes_in_an_hour(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    add_plain(path, "one", unit(rng, 2, 16), encoder)
    left = path / "rows-0123456789abcdef.safetensors"
    left.write_bytes(b"half")
    add_plain(path, "two", unit(rng, 2, 16), encoder)
    assert left.exists()  # another process may be writing it
    monkeypatch.setattr(changes, "OUTDATED_S", -1.0)
    Catalogue.open(path).remove("one")
    assert not left.exists()
    Catalogue.open(path).verify()


def test_a_full_disk_changes_nothing(scenes, catalogue):
    catalogue.add(scenes / "kitchen")
    scene = Scene(boxes_of(WORDS["o'hara"], known_scene()), known_scene())
    with files_of_at_most(2000), pytest.raises(NoRoom, match="left as it was"):
        catalogue.add(scene, name="x")
    assert [one.scene for one in catalogue.scenes()] == ["kitchen"]
    catalogue.verify()


# --- damaged and strange folders ---


def test_a_folder_of_something_else(tmp_path):
    (tmp_path / "a.txt").write_text("no table")
    with malformed("expected a catalogue"):
        Catalogue.open(tmp_path)
    with malformed("expected a catalogue"):
        Catalogue.open(tmp_path / "a.txt")
    with refused("no catalogue is here"):
        Catalogue.open(tmp_path / "none").ask("mug")
    assert not (tmp_path / "none").exists()


def test_a_catalogue_of_before_is_to_be_made_again(tmp_path):
    (tmp_path / "objects.lance").mkdir()
    with malformed("an earlier drsplat made: remove the folder and add its scenes again"):
        Catalogue.open(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_descriptors_without_a_direction_are_refused(value, tmp_path):
    vectors = unit(default_rng(0), 4, 8)
    vectors[1] = value
    with refused("descriptors: expected finite vectors"):
        add_plain(tmp_path / "c", "one", vectors, EncoderIdentity("test", 8))
    assert not (tmp_path / "c").exists()


def edit(catalogue: Catalogue, change: Any) -> None:
    """Write the only file of rows and the document anew, as somebody may who knows the format."""
    (file,) = catalogue.path.glob("rows-*")
    arrays, about = map_tensors(file)
    arrays, about = {name: array.copy() for name, array in arrays.items()}, dict(about)

    def both(document):
        change(arrays, about, document)
        write_tensors(file, arrays, {"scenes": about["scenes"]}, overwrite=True)
        document["parts"][0]["rows"]["crc32"] = header_checksum(map_tensors(file)[1])

    edit_document(catalogue.path, both)


STRANGE = {
    "a zero": (lambda a, m, d: a["descriptors"].fill(0), "descriptors without a direction"),
    "no box": (lambda a, m, d: a["centers"].fill(np.nan), "has no finite box"),
    "no sketch": (lambda a, m, d: a["sketches"].fill(0), "no sketch of a scene"),
    "no record": (lambda a, m, d: a["records"].fill(ord("7")), "expected an object with"),
    "other counts": (lambda a, m, d: a["descriptor_counts"].fill(9), "expected boxes of the objects of 1 scenes"),
    "two numbers": (lambda a, m, d: a.update(
        {k: a[k][:, :2].copy() for k in ("centers", "positions", "extents")}, axes=a["axes"][:, :2, :2].copy()
    ), "expected boxes of the objects of 1 scenes"),
    "other types": (lambda a, m, d: a.update(extents=a["extents"].astype(np.float64)), "extents: expected float32"),
    "no arrays": (lambda a, m, d: a.pop("positions"), "positions: expected"),
    "more scenes": (lambda a, m, d: m.update(scenes=json.dumps(2 * json.loads(m["scenes"]))), "of 2 scenes"),
    "fewer objects": (lambda a, m, d: m.update(scenes=m["scenes"].replace('cts": 4', 'cts": -4')), "of -4 objects"),
    "no time": (lambda a, m, d: m.update(scenes=m["scenes"].replace("2026", "now")), "added at 'now"),
    "another encoder": (lambda a, m, d: d["encoder"].update(dim=9), "of 9 numbers"),
    "a huge encoder": (lambda a, m, d: d["encoder"].update(dim=10**9), "1 to 65536 dimensions"),
    "a name for a number": (lambda a, m, d: d["encoder"].update(name=7), "expected a text"),
    "a way out": (lambda a, m, d: d["parts"][0]["rows"].update(name="../rows"), "names of files"),
    "an older version": (lambda a, m, d: d.update(version=4), "of version 5, got 4.*add its scenes again"),
    "another format": (lambda a, m, d: d.update(format="x"), "expected 'drsplat catalogue'"),
}  # fmt: skip


@pytest.mark.parametrize("strange", STRANGE)
def test_strange_files_are_refused(strange, catalogue):
    change, said = STRANGE[strange]
    add_plain(catalogue.path, "one", unit(default_rng(0), 4, 8), EncoderIdentity("test", 8), 1)
    edit(catalogue, change)
    with malformed(said):
        Catalogue.open(catalogue.path).ask(Query(vector=np.ones(8, np.float32), threshold=-1.0))


def test_thumbnails_that_are_none(filled):
    (entry,) = filled.ask("red mug")
    for data in (b"", b"<svg onload=alert(1)>", entry.thumbnail[:40], b"\xff\xd8\xff" + bytes(500)):
        with malformed("add the scene again"):
            replace(entry, thumbnail=data).picture()


# --- the command line ---


def test_the_command_line(scenes, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def said(*argv):
        return answer_of(capsys, "catalogue", *argv)

    added = said("add", "flats", *(str(scenes / name) for name in WORDS))
    assert [one["num_objects"] for one in added["scenes"]] == [3, 3]
    answer = said("ask", "flats", "mug", "--picture", "sheet.jpg")
    assert [one["scene"] for one in answer["matches"]] == ["kitchen", "o'hara"]
    assert np.asarray(Image.open("sheet.jpg")).std() > 20
    assert said("ask", "flats", "mug", "--scene", "o'hara", "--box=9,-1,-1,11,1,1")["num_matches"] == 1
    assert said("ask", "flats", "mug", "--since", "2999-01-01")["num_matches"] == 0
    assert said("ask", "flats", "mug", "--exclude", "red")["num_matches"] == 1
    assert [one["state"] for one in said("list", "flats")["scenes"]] == ["current", "current"]
    assert said("remove", "flats", "kitchen")["removed"] == {"kitchen": 3}
    nobody = ["ask", "flats", "mug", "--scene", "nobody"]
    for argv in (["list", "flats"], ["ask", "flats", "mug"], ["ask", "flats", "elephant"], nobody):
        assert main(["catalogue", *argv]) == 0
    text = capsys.readouterr().out
    assert "No object of any scene answers this" in text
    assert "Nothing was compared" in text
    for argv, message in (
        (["add", "flats"], "expected folders"),
        (["list", "flats", "x"], "takes no more"),
        (["ask", "flats"], "exactly one of text"),
        (["ask", "flats", "mug", "--box", "1,2"], "--box 1,2: expected 6"),
        (["ask", "flats", "mug", "--since", "never"], "--since never"),
        (["ask", "flats", "mug", "--picture", "a.gif"], r"written as .png or .jpg"),
        (["index", "flats"], "256 objects or more"),
    ):
        assert message in error_of(capsys, "catalogue", *argv)


# --- checksums ---


def two_rooms(folder: Path) -> Catalogue:
    """A catalogue of two scenes, one of few objects beside one of many, so that each is in a part of its own."""
    rng, encoder, path = default_rng(5), EncoderIdentity("test", 16), folder / "c"
    for name, size in (("one", 600), ("two", 8)):
        add_plain(path, name, unit(rng, size, 16), encoder)
    return Catalogue.open(path)


def answer_to(catalogue: Catalogue, seed: int = 6) -> list[tuple[str, int, float]]:
    """The first objects as a vector ranks them."""
    answer = catalogue.answer(Query(vector=unit(default_rng(seed), 16), threshold=-1.0), top=50)
    return [(entry.scene, entry.object_id, entry.score) for entry in answer.entries]


@pytest.mark.parametrize("coded", [False, True])
def test_a_flipped_bit_or_a_cut_never_changes_an_answer(tmp_path, coded):
    catalogue, rng = two_rooms(tmp_path), default_rng(8)
    if coded:
        catalogue.build_index()
    expected = answer_to(catalogue)
    for file in sorted(catalogue.path.iterdir()):
        good = file.read_bytes()
        for at in (0, len(good) - 1, *rng.integers(0, len(good), 4).tolist(), None, "missing"):
            damaged = bytearray(good)
            if at is None:
                del damaged[len(good) // 2 :]
            elif at != "missing":
                damaged[at] ^= 1 << int(rng.integers(8))
            file.unlink() if at == "missing" else file.write_bytes(damaged)
            of_codes = file.name.startswith("code")
            said = "expected a catalogue" if at == "missing" and file.name == DOCUMENT else re.escape(file.name)
            with malformed(f"{said}.*index. makes these files anew" if of_codes else said):
                answer_to(Catalogue.open(catalogue.path))
            if of_codes:
                assert len(Catalogue.open(catalogue.path).ask(Query(vector=unit(rng, 16), threshold=-1.0), exact=True))
        file.write_bytes(good)
    assert answer_to(catalogue) == expected
    if coded:
        next(catalogue.path.glob("codes-*")).unlink()
        Catalogue.open(catalogue.path).build_index()
        assert answer_to(Catalogue.open(catalogue.path)) == expected


def test_only_verifying_reads_all_of_a_large_file(tmp_path, monkeypatch):
    monkeypatch.setattr(snapshot, "SMALL_BYTES", 0)
    catalogue = two_rooms(tmp_path)
    file = max(catalogue.path.glob("rows-*"), key=lambda file: file.stat().st_size)
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    Catalogue.open(catalogue.path)
    with malformed(f"{file.name}: damaged"):
        catalogue.verify()


def test_an_edited_document_is_refused(tmp_path):
    catalogue = two_rooms(tmp_path)
    text = (catalogue.path / DOCUMENT).read_text()
    (catalogue.path / DOCUMENT).write_text(text.replace('"changes": 3', '"changes": 4'))
    with malformed("damaged or edited"):
        Catalogue.open(catalogue.path)
    (catalogue.path / DOCUMENT).write_text(text.replace("\n ", "\n  "))  # says the same, and was not written so
    assert len(catalogue) == 304
    with malformed("damaged or edited"):
        catalogue.verify()
