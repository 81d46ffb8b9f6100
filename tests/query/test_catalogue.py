"""Many scenes in one table: what is found, in which, and what whoever reads sees while others write."""

import io
import itertools
import json
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose
from PIL import Image

from catalogued import boxes_of, write_scene
from command_line import answer_of, error_of
from drsplat import EncoderIdentity, Query, Scene, WordEncoder, load_field, read_gaussians
from drsplat.cli import main
from drsplat.errors import DrSplatWarning, MismatchError, MissingExtraError
from drsplat.formats.replacing import claimed_output
from drsplat.formats.tensors import sealed
from drsplat.formats.tiles import write_tiles
from drsplat.query.objects import support_of
from drsplat.query.sketch import Packed, Sketch, SketchedScene
from known_objects import CENTERS, EACH, known_scene
from refusing import malformed, refused

pytest.importorskip("lancedb", reason="the extra drsplat[catalogue] is not installed")

from drsplat.query.catalogue import Catalogue, Conditions, reading, record, table
from drsplat.query.catalogue.entries import quoted
from drsplat.query.catalogue.rows import MAX_BYTES, thumbnail
from drsplat.query.catalogue.snapshot import KEY, batch, current, schema_of

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


def rows_of(name: str, vectors: np.ndarray, encoder: EncoderIdentity, each: int = 2) -> Any:
    """Objects without pictures, of `each` descriptors."""
    count = len(vectors) // each
    numbers = [*range(count), -1]
    columns = {
        "scene": [name] * (count + 1),
        "tile": [0] * (count + 1),
        "object_id": numbers,
        "field": ["f"] * (count + 1),
        "added": [datetime(2026, 1, 1, tzinfo=UTC)] * (count + 1),
        **{key: [1.0] * count + [None] for key in ("x", "y", "z", "sure")},
        **{key: [5] * count + [None] for key in ("num_gaussians", "num_views")},
        "axes": [[1.0, 0, 0, 0, 1, 0, 0, 0, 1]] * count + [None],
        "extent": [[1.0, 1, 1]] * count + [None],
    }
    columns["sketch"] = [None] * count + [plain_sketch(vectors, count).to_bytes()]
    descriptors = np.split(vectors, count) if count else []
    return batch(columns, [*descriptors, np.empty((0, encoder.dim), np.float32)], encoder)


def plain_sketch(vectors: np.ndarray, count: int) -> Sketch:
    """Of objects whose Gaussians are as their descriptors are."""
    numbers = np.repeat(np.arange(count, dtype=np.int32), len(vectors) // max(count, 1))
    picture, many = np.eye(1, vectors.shape[1], dtype=np.float32), np.full(len(vectors), 40, np.int32)
    features, pictures, words = (Packed.of(some) for some in (np.nan_to_num(vectors), picture, vectors[:0]))
    return Sketch(features, many, numbers, pictures, words, np.full(count, 40, np.int32), {})


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = rng.standard_normal(shape).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


# --- asking ---


def test_the_best_objects_of_all_scenes(filled):
    assert found(filled, "red mug") == [("kitchen", 0)]
    assert found(filled, "mug") == [("kitchen", 0), ("o'hara", 0)]
    assert found(filled, "mug", top=1) == [("kitchen", 0)]
    assert found(filled, "lamp") == [("o'hara", 2)]
    assert found(filled, "elephant") == []
    assert len(filled) == 6


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
    table.replace_scene(catalogue.path, "one", rows_of("one", vectors[:500], encoder), encoder)
    table.replace_scene(catalogue.path, "two", rows_of("two", vectors[500:], encoder), encoder)
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


def test_an_index_finds_nearly_all_and_says_that_it_was_used(catalogue):
    rng, encoder = default_rng(2), EncoderIdentity("test", 32)
    centers = unit(rng, 40, 32)
    vectors = unit(rng, 1200, 32) * 0.4 + centers[rng.integers(0, 40, 1200)]
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    table.replace_scene(catalogue.path, "one", rows_of("one", vectors, encoder), encoder)
    assert catalogue.build_index() == 600
    shares = []
    for query in centers[:10]:
        asked = Query(vector=query, threshold=-1.0)
        near, exact = catalogue.answer(asked, top=10), catalogue.answer(asked, top=10, exact=True)
        assert (near.exact, exact.exact) == (False, True)
        ids = [{entry.object_id for entry in answer.entries} for answer in (near, exact)]
        shares.append(len(ids[0] & ids[1]) / 10)
    assert np.mean(shares) > 0.8
    table.replace_scene(catalogue.path, "two", rows_of("two", unit(rng, 2, 32), encoder), encoder)
    later = catalogue.scenes()
    assert [one.num_objects for one in later] == [600, 1]
    answer = catalogue.answer(Query(vector=centers[0], threshold=-1.0), Conditions(scenes=("two",)))
    assert ([(entry.scene, entry.object_id) for entry in answer.entries], answer.exact) == ([("two", 0)], True)


@pytest.mark.slow
@given(text=st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), min_size=1, max_size=40))
def test_names_are_texts_and_never_conditions(filled, text):
    name = f"x' OR 1 = 1 OR scene = '{text}"
    assert found(filled, "mug", Conditions(scenes=(text, name))) == []
    with refused("no object 0"):
        filled.thumbnail(name, 0)
    with refused("no scene"):
        filled.remove(f"{text}\\' --")
    assert len(filled) == 6


@given(text=st.text("'\"\\ a;-", max_size=12))
def test_a_quoted_text_is_one_text(text):
    """Read as SQL reads: a quote ends a text unless another follows."""
    assert re.fullmatch("'(?:[^']|'')*'", quoted(text))
    assert quoted(text)[1:-1].replace("''", "'") == text


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
    version = current(catalogue.path).version
    opened = Scene(boxes_of(("red mug", "red bowl", "red rug"), known_scene()), known_scene(), name="kitchen")
    with pytest.warns(DrSplatWarning, match="no thumbnails"):
        listed = catalogue.add(opened)
    assert current(catalogue.path).version == version + 1
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


@pytest.mark.slow
def test_whoever_asks_sees_all_of_a_change_or_nothing(tmp_path):
    """Scenes come, are replaced and go; one stays, and each answer has all of it and whole others."""
    rng, encoder, path = default_rng(3), EncoderIdentity("test", 16), tmp_path / "c"
    own = unit(rng, 16)
    stays = np.repeat(own[None], 20, axis=0)
    table.replace_scene(path, "stays", rows_of("stays", stays, encoder, 1), encoder)
    wrong = []
    done = threading.Event()

    def ask():
        catalogue = Catalogue.open(path)
        while not done.is_set():
            entries = catalogue.ask(Query(vector=own, threshold=0.5), top=200)
            counts = {name: sum(e.scene == name for e in entries) for name in {e.scene for e in entries}}
            if counts.pop("stays", 0) != 20 or any(count not in (10, 15) for count in counts.values()):
                wrong.append(str(counts))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for number in range(12):
        name, size = f"comes{number % 3}", (10, 15)[number % 2]
        table.replace_scene(path, name, rows_of(name, np.repeat(own[None], size, axis=0), encoder, 1), encoder)
        if number % 4 == 3:
            Catalogue.open(path).remove(name)
    done.set()
    for thread in threads:
        thread.join()
    assert not wrong


def test_files_are_put_together_in_time(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    vectors = unit(rng, 8, 16)
    for number in range(8):
        table.replace_scene(
            path, f"s{number}", rows_of(f"s{number}", vectors[number : number + 1], encoder, 1), encoder
        )

    def fragments():
        known = current(path)
        return int(known.table.stats()["fragment_stats"]["num_fragments"])

    table.tidy(path)
    assert fragments() == 8
    monkeypatch.setattr(table, "MAX_FRAGMENTS", 4)
    table.tidy(path)
    assert fragments() < 4
    for number in range(8):
        assert found(Catalogue.open(path), Query(vector=vectors[number], threshold=0.99)) == [(f"s{number}", 0)]


def test_nobody_waits_while_files_are_put_together(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    vectors = unit(rng, 8, 16)
    monkeypatch.setattr(table, "MAX_FRAGMENTS", 4)
    for number in range(8):
        own = vectors[number : number + 1]
        table.replace_scene(path, f"s{number}", rows_of(f"s{number}", own, encoder, 1), encoder)
    known = current(path)
    optimize = type(known.table).optimize

    def meanwhile(self, **how):
        Catalogue.open(path).remove("s3")
        with refused("is being written by"), claimed_output(path.with_name("c.tidy")):
            pass
        optimize(self, **how)

    monkeypatch.setattr(type(known.table), "optimize", meanwhile)
    table.tidy(path)  # the removal was quicker, and no warning is due
    assert sorted(one.scene for one in Catalogue.open(path).scenes()) == [f"s{n}" for n in range(8) if n != 3]


def test_nobody_waits_while_the_index_is_built(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    vectors = unit(rng, 600, 16)
    for name, own in (("stays", vectors[:500]), ("goes", vectors[500:550])):
        table.replace_scene(path, name, rows_of(name, own, encoder, 1), encoder)
    catalogue = Catalogue.open(path)
    index_names = table._index_names

    def meanwhile(path):
        catalogue.remove("goes")
        table.replace_scene(path, "comes", rows_of("comes", vectors[550:], encoder, 1), encoder)
        index_names(path)

    monkeypatch.setattr(table, "_index_names", meanwhile)
    catalogue.build_index()
    for at, expected in ((10, [("stays", 10)]), (520, []), (560, [("comes", 10)])):
        answer = catalogue.answer(Query(vector=vectors[at], threshold=0.99))
        assert ([(entry.scene, entry.object_id) for entry in answer.entries], answer.exact) == (expected, False)


def test_what_is_usual_stays_while_a_large_table_hardly_changes(tmp_path, monkeypatch):
    rng, encoder, path = default_rng(4), EncoderIdentity("test", 16), tmp_path / "c"
    monkeypatch.setattr("drsplat.query.catalogue.catalogue.LARGE_ROWS", 200)
    catalogue, asked = Catalogue.open(path), []
    for name, size in (("small", 150), ("more", 250), ("hardly", 2), ("much", 50)):
        table.replace_scene(path, name, rows_of(name, unit(rng, size, 16), encoder, 1), encoder)
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


class EveryOther(SketchedScene):
    """A scene that answers with its object if its name is an even number."""

    def __init__(self, name: str) -> None:
        self.is_even = int(name) % 2 == 0

    def answers(self, query: Query) -> np.ndarray:
        return np.array([self.is_even])


def test_no_more_scenes_are_asked_than_answers_are_missing(filled, monkeypatch):
    """Every other scene agrees: 10 are asked for 10 answers, then 5 for those that are missing, then at least 4."""
    asked = []

    def read(_, names, __):
        asked.append(sorted(map(int, names)))
        return {name: EveryOther(name) for name in names}

    monkeypatch.setattr(reading, "_read", read)
    rules = reading.SceneRules(filled._snapshot(), WordEncoder)
    objects = [(str(number), 0) for number in range(40)]
    assert rules.first(Query("mug"), objects, 10) == list(range(0, 20, 2))
    assert asked == [[*range(10)], [*range(10, 15)], [*range(15, 19)]]
    assert rules.first(Query("mug"), objects, 25) == list(range(0, 40, 2))
    with malformed("are not whole"):
        rules.first(Query("mug"), [("0", 1)], 1)


ADDING = """
import resource, sys, time
from drsplat.query.catalogue import Catalogue, table
from drsplat.query import open_scene
scene, catalogue = open_scene(sys.argv[2]), Catalogue.open(sys.argv[1])
print("ready", flush=True)
if len(sys.argv) > 3:
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]),) * 2)
    catalogue.add(scene)
while True:
    catalogue.add(scene, name=f"scene {int(time.time() * 1000) % 3}")
"""


def adding(*argv: object) -> "subprocess.Popen[str]":
    """A process that opens a scene and then adds it, again and again."""
    command = [sys.executable, "-W", "ignore", "-c", ADDING, *map(str, argv)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.slow
def test_a_killed_writer_leaves_whole_scenes(scenes, tmp_path):
    path = tmp_path / "c"
    for seconds in (0.05, 0.4):
        process = adding(path, scenes / "kitchen")
        time.sleep(seconds)
        process.kill()
        process.communicate()
        assert all(one.num_objects == 3 for one in Catalogue.open(path).scenes())
    catalogue = Catalogue.open(path)
    catalogue.add(scenes / "o'hara")  # nobody holds the lock
    assert found(catalogue, "white lamp") == [("o'hara", 2)]


@pytest.mark.parametrize("left", ["data/rows.lance", "_transactions/0-one.txn"])
def test_a_writer_killed_before_its_first_version_leaves_an_empty_catalogue(left, scenes, tmp_path):
    file = tmp_path / "c" / "objects.lance" / left
    file.parent.mkdir(parents=True)
    file.write_bytes(b"half")
    catalogue = Catalogue.open(tmp_path / "c")
    assert not list(catalogue.scenes())
    catalogue.add(scenes / "kitchen")
    assert [one.num_objects for one in catalogue.scenes()] == [3]


def test_a_catalogue_that_lost_its_versions_is_damaged(scenes, catalogue):
    catalogue.add(scenes / "kitchen")
    catalogue.add(scenes / "o'hara")
    for manifest in catalogue.path.glob("*/_versions/*"):
        manifest.unlink()
    with malformed("damaged"):
        Catalogue.open(catalogue.path)


@pytest.mark.slow
def test_a_full_disk_changes_nothing(scenes, tmp_path):
    path = tmp_path / "c"
    Catalogue.open(path).add(scenes / "kitchen")
    process = adding(path, scenes / "o'hara", 2000)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "InputError" in error
    assert "nothing was changed" in error
    assert [one.scene for one in Catalogue.open(path).scenes()] == ["kitchen"]


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


def test_without_its_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "lancedb", None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[catalogue\]"):
        Catalogue.open(tmp_path)
    code = "import sys, drsplat.query.catalogue; print('lancedb' in sys.modules or 'pyarrow' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_a_table_of_somebody_else(tmp_path):
    import lancedb
    import pyarrow as pa

    lancedb.connect(tmp_path).create_table("objects", data=pa.table({"a": [1]}))
    with malformed("not of a catalogue"):
        Catalogue.open(tmp_path)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"version": 1, "encoder": {"name": "a", "dim": 4, "weights": ""}}, "version 1.*add its scenes again"),
        ({"version": 2, "encoder": {"name": "a", "dim": 4, "weights": ""}}, "version 2.*add its scenes again"),
        ({"version": 3, "encoder": {"name": "a", "dim": 4, "weights": ""}}, "version 3.*add its scenes again"),
        ({"version": 5, "encoder": {"name": "a", "dim": 4, "weights": ""}}, "version 5.*install"),
        ({"version": 4, "encoder": {"name": "a", "dim": 4, "weights": ""}}, "other columns"),
        ({"version": 4, "encoder": {"name": "a", "dim": 10**9, "weights": ""}}, "not of a catalogue"),
        ({"version": 4, "encoder": {"name": 7, "dim": 4, "weights": ""}}, "not of a catalogue"),
        ([], "not of a catalogue"),
    ],
)
def test_a_table_that_says_it_is_a_catalogue(tmp_path, document, said):
    import lancedb
    import pyarrow as pa

    data = pa.table({"a": [1]}).replace_schema_metadata({KEY: json.dumps(document)})
    lancedb.connect(tmp_path).create_table("objects", data=data)
    with malformed(said):
        Catalogue.open(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_descriptors_without_a_direction_are_refused(value):
    vectors = unit(default_rng(0), 4, 8)
    vectors[1] = value
    with refused("descriptors: expected finite vectors"):
        batch({}, [vectors], EncoderIdentity("test", 8))


@pytest.mark.parametrize("wrong", ["zero", "box", "scene"])
def test_rows_that_are_no_objects(wrong, catalogue):
    import pyarrow as pa

    encoder = EncoderIdentity("test", 8)
    columns = rows_of("one", unit(default_rng(0), 4, 8), encoder, 1)
    name, value = {
        "zero": ("descriptors", [[[1] * 8], [[0] * 8], [[1] * 8], [[1] * 8], []]),
        "box": ("x", [None, 1.0, 1.0, 1.0, None]),
        "scene": ("scene", [None] * 5),
    }[wrong]
    at = columns.schema.get_field_index(name)
    columns = columns.set_column(at, name, pa.array(value, columns.schema.field(name).type))
    columns = columns.replace_schema_metadata(schema_of(encoder).metadata)
    table.replace_scene(catalogue.path, "one", columns, encoder)
    with malformed("damaged"):
        catalogue.ask(Query(vector=np.ones(8, np.float32), threshold=-1.0))


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
    """A catalogue of two scenes, added one after the other."""
    rng, encoder, path = default_rng(5), EncoderIdentity("test", 16), folder / "c"
    for name in ("one", "two"):
        with claimed_output(path):
            table.replace_scene(path, name, rows_of(name, unit(rng, 8, 16), encoder), encoder)
    return Catalogue.open(path)


def answer_to(catalogue: Catalogue, seed: int = 6) -> list[tuple[str, int, float]]:
    """All objects as a vector ranks them."""
    answer = catalogue.answer(Query(vector=unit(default_rng(seed), 16), threshold=-1.0), top=50)
    return [(entry.scene, entry.object_id, entry.score) for entry in answer.entries]


def test_a_flipped_bit_or_a_cut_never_changes_an_answer(tmp_path):
    catalogue, rng = two_rooms(tmp_path), default_rng(8)
    expected = answer_to(catalogue)
    for file in sorted(path for path in catalogue.path.rglob("*") if path.is_file()):
        good = file.read_bytes()
        for at in (0, len(good) - 1, *rng.integers(0, len(good), 4).tolist(), None):
            damaged = bytearray(good)
            if at is None:
                del damaged[len(good) // 2 :]
            else:
                damaged[at] ^= 1 << int(rng.integers(8))
            file.write_bytes(damaged)
            with malformed(re.escape(file.name)):
                answer_to(Catalogue.open(catalogue.path))
        file.write_bytes(good)
    assert answer_to(catalogue) == expected


def test_a_table_without_its_latest_version_is_refused(tmp_path):
    catalogue = two_rooms(tmp_path)
    latest = min((catalogue.path / "objects.lance/_versions").glob("*.manifest"))  # they count down
    latest.unlink()
    with malformed(r"version 1 is the newest that is here, and version 2 was written"):
        catalogue.ask(Query(vector=np.ones(16, np.float32)))
    with malformed("version 1 is the newest"):
        catalogue.remove("one")


def test_a_missing_file_of_a_large_table_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "SMALL_BYTES", 0)
    catalogue = two_rooms(tmp_path)
    rows = min((catalogue.path / "objects.lance/data").iterdir())
    content = rows.read_bytes()
    rows.unlink()
    with malformed(f"{rows.name}: missing"):
        Catalogue.open(catalogue.path)
    rows.write_bytes(content[:-1])
    with malformed(f"{rows.name}: damaged"):
        Catalogue.open(catalogue.path)
    rows.write_bytes(bytes(len(content)))  # of the same size: only `verify` reads all of a large table
    Catalogue.open(catalogue.path)
    with malformed(f"{rows.name}: damaged"):
        catalogue.verify()


KILLED = """
import os, sys
import numpy as np
from drsplat.query.catalogue import Catalogue, table
def killed(*given, **how):
    os.kill(os.getpid(), 9)
moment, path, scene = sys.argv[1:]
if moment == "before the record":
    table.write_record = killed
else:
    table.record = killed
Catalogue.open(path).remove("kitchen") if moment == "before the intent" else Catalogue.open(path).add(scene)
"""


@pytest.mark.slow
def test_a_writer_killed_before_its_record(scenes, catalogue):
    catalogue.add(scenes / "kitchen")
    for moment, names in (("before the record", ["kitchen", "o'hara"]), ("before the intent", ["kitchen", "o'hara"])):
        command = [sys.executable, "-W", "ignore", "-c", KILLED, moment, str(catalogue.path), str(scenes / "o'hara")]
        assert subprocess.run(command, check=False).returncode == -9
        assert [one.scene for one in catalogue.scenes()] == names
    catalogue.verify()  # what was recorded is as it was
    before = record.read_record(catalogue.path)
    assert before.version == 1
    catalogue.add(scenes / "o'hara")  # the same command again
    after = record.read_record(catalogue.path)
    assert after.version == 3
    assert len(catalogue.verify()) == 1 + sum(file.is_file() for file in (catalogue.path / "objects.lance").rglob("*"))


REMOVED = """
import os, sys
from drsplat.query.catalogue import Catalogue, table
real, times = table.record, []
def second(*given, **how):
    times.append(1)
    os.kill(os.getpid(), 9) if len(times) == 2 else real(*given, **how)
table.record = second
Catalogue.open(sys.argv[1]).remove("kitchen")
"""


@pytest.mark.slow
def test_a_killed_removal_that_had_ended_is_given_again(scenes, catalogue):
    for name in WORDS:
        catalogue.add(scenes / name)
    killed = subprocess.run([sys.executable, "-c", REMOVED, str(catalogue.path)], check=False)
    assert killed.returncode == -9
    assert [one.scene for one in catalogue.scenes()] == ["o'hara"]
    assert catalogue.remove("kitchen") is None
    catalogue.add(scenes / "kitchen")
    assert catalogue.remove("kitchen") == 3


def test_files_of_older_versions_may_go(tmp_path, monkeypatch):
    """As putting files together removes them, at the same version of the table or at a newer one."""
    monkeypatch.setattr(table, "OUTDATED", timedelta(milliseconds=1))
    monkeypatch.setattr(table, "MAX_FRAGMENTS", 0)
    catalogue = two_rooms(tmp_path)
    expected = answer_to(catalogue)
    files, tries = catalogue.path / "objects.lance/data", 0
    while tries == 0 or len(list(files.iterdir())) > 2:  # on a busy machine some stay until the next time
        time.sleep(0.05)  # so that all files are older than that
        table.tidy(catalogue.path)
        assert answer_to(catalogue) == expected
        tries += 1
        assert tries < 20
    kept = record.read_record(catalogue.path)
    assert kept.version > 2
    catalogue.verify()


def test_a_catalogue_without_a_record_is_read_and_gets_one(tmp_path):
    catalogue = two_rooms(tmp_path)
    (catalogue.path / record.RECORD).unlink()  # as older versions leave it
    assert (len(catalogue), catalogue.verify()) == (8, [])
    catalogue.remove("one")
    assert len(catalogue.verify()) > 4


def test_what_is_asked_while_others_write_is_no_damage(tmp_path):
    """Whoever asks reads the record of one version and may open the next one."""
    catalogue, path = two_rooms(tmp_path), tmp_path / "c"
    rng, encoder = default_rng(9), EncoderIdentity("test", 16)

    def write():
        for number in range(12):
            with claimed_output(path, 60.0):
                table.replace_scene(
                    path, f"s{number % 3}", rows_of(f"s{number % 3}", unit(rng, 4, 16), encoder), encoder
                )

    asked = 0
    with ThreadPoolExecutor(1) as writer:
        written = writer.submit(write)
        while not written.done():
            assert len(catalogue) >= 8
            asked += 1
        written.result()
    assert asked > 1
    catalogue.verify()


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "a//b", "data/..", 5])
def test_records_that_are_none(name, tmp_path):
    catalogue = two_rooms(tmp_path)
    path = catalogue.path / record.RECORD
    document = json.loads(path.read_text())
    del document["crc32"]
    path.write_text(json.dumps(sealed({**document, "files": {str(name): [1, "0"] if name != 5 else [1]}})))
    with malformed("expected the size and the checksum of a file"):
        catalogue.ask(Query(vector=np.ones(16, np.float32)))
