"""A catalogue's codes: what they find of all, and that no change, kill or damage makes an answer wrong."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import EncoderIdentity, Query
from drsplat.errors import FormatError
from drsplat.formats.replacing import claimed_output
from drsplat.formats.tensors import map_tensors, write_tensors
from refusing import malformed

pytest.importorskip("lancedb", reason="the extra drsplat[catalogue] is not installed")

from test_catalogue import rows_of, unit

from drsplat.query.catalogue import Catalogue, Conditions, codes, table
from drsplat.query.catalogue.codes import Search, nearest_objects
from drsplat.query.catalogue.record import fragments_of, manifest_of
from drsplat.query.catalogue.snapshot import current

ENCODER = EncoderIdentity("test", 64)
ANYWHERE = Conditions()
OBJECTS = 300  # of a scene, of two descriptors each


def drawn(rng: np.random.Generator, scenes: int, dim: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors of pictures and queries in words: a narrow cone of a falling spectrum, and words beside it."""
    spread = np.linspace(1, 0.05, dim) ** 2
    common = unit(rng, dim) * 2
    things = common + rng.standard_normal((80, dim)) * spread * 1.5
    masks = things[rng.integers(0, 80, scenes * OBJECTS)].repeat(2, axis=0)
    masks = masks + rng.standard_normal(masks.shape) * spread * 0.8
    words = unit(rng, dim) * 1.5 + 0.5 * (things - common) + 0.6 * unit(rng, 80, dim)
    return tuple((rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32) for rows in (masks, words))


def add(path: Path, name: str, vectors: np.ndarray) -> None:
    with claimed_output(path, 60.0):
        table.replace_scene(path, name, rows_of(name, vectors, ENCODER), ENCODER)


def answer(catalogue: Catalogue, vector: np.ndarray, where: Conditions = ANYWHERE, exact: bool = False) -> list[object]:
    entries = catalogue.answer(Query(vector=vector, threshold=-1.0), where, exact=exact).entries
    return [(entry.scene, entry.object_id, round(entry.score, 5)) for entry in entries]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, np.ndarray, np.ndarray]:
    """A catalogue of four scenes with codes, each in a file of its own, its descriptors and words."""
    path = tmp_path_factory.mktemp("coded") / "c"
    vectors, words = drawn(default_rng(0), 4)
    for number, own in enumerate(np.split(vectors, 4)):
        add(path, f"s{number}", own)
    with mock.patch.object(table, "_put_together"):
        assert Catalogue.open(path).build_index() == 4 * OBJECTS
    return path, vectors, words


@pytest.fixture
def coded(made, tmp_path) -> tuple[Catalogue, np.ndarray, np.ndarray]:
    shutil.copytree(made[0], tmp_path / "c")
    return Catalogue.open(tmp_path / "c"), *made[1:]


def uncoded(catalogue: Catalogue) -> int:
    read = codes.CodeReader(catalogue.path).of(catalogue._snapshot())
    return len(read.without)


def test_codes_find_what_comparing_all_finds(coded):
    catalogue, vectors, words = coded
    snapshot = catalogue._snapshot()
    read = codes.CodeReader(catalogue.path).of(snapshot)
    for queries in (words[:20], vectors[:400:20]):
        shares = []
        for query in queries:
            found, exact = (nearest_objects(snapshot, by, Search(query, "", 256, 1)) for by in (read, None))
            ids = [nearest_rows.rows["_rowid"].to_pylist() for nearest_rows in (found, exact)]
            assert (found.is_exact, exact.is_exact, len(ids[0])) == (False, True, 256)
            best = found.described.cosines(query)
            assert_array_equal(best, np.sort(best)[::-1])
            assert_allclose(best[:10], np.sort(exact.described.cosines(query))[:-11:-1], atol=1e-6)
            shares.append(len(set(ids[0]) & set(ids[1])) / 256)
        assert np.mean(shares) > 0.9
    assert answer(catalogue, words[0]) == answer(catalogue, words[0], exact=True)


def test_of_larger_tables_more_candidates_are_compared():
    assert [codes.refine_factor(rows) for rows in (0, 300_000, 750_000, 3_000_000, 30_000_000)] == [4, 4, 4, 8, 25]


def test_the_same_answer_with_any_number_of_threads(coded):
    catalogue, _, words = coded
    expected = answer(catalogue, words[1])
    for threads in (1, 2, 3):
        assert answer(Catalogue.open(catalogue.path, threads=threads), words[1]) == expected


def test_what_is_removed_or_replaced_is_never_answered(coded):
    catalogue, vectors, words = coded
    query = vectors[2 * OBJECTS * 2]  # the first object of s2
    assert answer(catalogue, query)[0][:2] == ("s2", 0)
    catalogue.remove("s2")
    assert "s2" not in {scene for scene, *_ in answer(catalogue, query)}
    add(catalogue.path, "s1", drawn(default_rng(7), 1)[0])  # in place of another
    add(catalogue.path, "new", np.repeat(query[None], 4, axis=0))
    assert uncoded(catalogue) == 0
    assert [one[:2] for one in answer(catalogue, query)[:2]] == [("new", 0), ("new", 1)]
    for vector in (query, *words[:5]):
        assert answer(catalogue, vector) == answer(catalogue, vector, exact=True)


def test_codes_of_many_deleted_rows_are_passed_over(coded):
    """All that are nearest are gone: those after them are found."""
    catalogue, _, words = coded
    opened = current(catalogue.path)
    opened.table.delete("object_id >= 20")  # of 300, in each scene
    table.record(catalogue.path)
    snapshot = catalogue._snapshot()
    read = codes.CodeReader(catalogue.path).of(snapshot)
    for word in words[:3]:
        found, exact = (nearest_objects(snapshot, by, Search(word, "", 30, 1)).rows for by in (read, None))
        assert max(found["object_id"].to_pylist()) < 20
        assert set(found["_rowid"].to_pylist()) == set(exact["_rowid"].to_pylist())


def test_conditions(coded, monkeypatch):
    catalogue, vectors, words = coded
    monkeypatch.setattr(codes, "FEW_ROWS", 0)  # by codes too
    for where in (
        Conditions(scenes=("s1",)),
        Conditions(scenes=("s0", "s3")),
        Conditions(box=(0.0, 0.0, 0.0, 2.0, 2.0, 2.0)),
    ):
        asked = catalogue.answer(Query(vector=words[2], threshold=-1.0), where)
        assert not asked.exact
        for query in (*words[:3], vectors[0], -words[0]):
            assert answer(catalogue, query, where) == answer(catalogue, query, where, exact=True)
    assert answer(catalogue, words[0], Conditions(scenes=("nobody",))) == []


def test_files_that_were_put_together_are_coded(coded, monkeypatch):
    catalogue, _, words = coded
    encoded = []
    monkeypatch.setattr(table, "_is_scattered", lambda _: True)
    monkeypatch.setattr(table, "_encoded", lambda *given: encoded.append(given))
    before = {file.name for file in (catalogue.path / "codes").rglob("*")}
    catalogue.remove("s3")
    table.tidy(catalogue.path)
    fragments = catalogue._snapshot().fragments
    assert fragments is not None
    assert (len(fragments), uncoded(catalogue)) == (1, 0)
    assert {file.name for file in (catalogue.path / "codes").rglob("*")} - before
    assert encoded == []  # they were carried over
    assert answer(catalogue, words[3]) == answer(catalogue, words[3], exact=True)
    assert any(name.startswith("codes/") for name in catalogue.verify())


def test_an_index_puts_files_together(coded):
    catalogue, _, words = coded
    expected = [answer(catalogue, word) for word in words[:3]]
    assert catalogue.build_index() == 4 * OBJECTS
    snapshot = Catalogue.open(catalogue.path)._snapshot()
    assert snapshot.fragments is not None
    assert [one.num_rows for one in snapshot.fragments] == [4 * (OBJECTS + 1)]
    assert uncoded(catalogue) == 0
    assert [answer(catalogue, word) for word in words[:3]] == expected
    catalogue.verify()


KILLED = """
import os, sys
from drsplat.query.catalogue import Catalogue, table
real, times = table.{name}, []
def killed(*given, **how):
    times.append(1)
    os.kill(os.getpid(), 9) if len(times) == {at} else None
    return real(*given, **how)
table.{name} = killed
Catalogue.open(sys.argv[1]).build_index()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "at"),
    [
        *((name, 1) for name in ("_put_together", "_write_codes", "_record_arranged", "_index_names")),
        *((name, 1) for name in ("write_tensors", "publish", "sweep")),
        ("write_tensors", 2),
    ],
)
def test_a_kill_while_codes_are_written_leaves_the_old_ones(coded, name, at):
    catalogue, _, words = coded
    catalogue.remove("s0")  # so that the next codebook is another one
    expected = [answer(catalogue, word) for word in words[:3]]
    code = KILLED.format(name=name, at=at)
    assert subprocess.run([sys.executable, "-c", code, str(catalogue.path)], check=False).returncode == -9
    again = Catalogue.open(catalogue.path)
    assert [answer(again, word) for word in words[:3]] == expected
    again.build_index()
    assert [answer(again, word) for word in words[:3]] == expected
    assert len([one for one in (catalogue.path / "codes").iterdir() if one.is_dir()]) == 1
    again.verify()


@pytest.mark.slow
def test_damaged_codes_are_told_and_written_anew(coded):
    catalogue, _, words = coded
    expected, rng = answer(catalogue, words[0]), default_rng(1)
    for number in range(5):
        file = sorted((catalogue.path / "codes").rglob("*.safetensors"))[number]
        good = file.read_bytes()
        for at in (8, len(good) - 1, *rng.integers(0, len(good), 3).tolist()):
            damaged = bytearray(good)
            damaged[at] ^= 1 << int(rng.integers(8))
            file.write_bytes(damaged)
            again = Catalogue.open(catalogue.path)
            for act in (lambda asked=again: answer(asked, words[0]), again.verify):
                with malformed(rf"{re.escape(file.name)}.*index. makes these files anew"):
                    act()
        file.write_bytes(good[:-7])
        with malformed(re.escape(file.name)):
            answer(Catalogue.open(catalogue.path), words[0])
        assert answer(Catalogue.open(catalogue.path), words[0], exact=True) == expected
        with mock.patch.object(table, "_put_together"):
            catalogue.build_index()
        assert answer(Catalogue.open(catalogue.path), words[0]) == expected


def test_codes_of_another_codebook_or_other_rows_are_refused(coded):
    catalogue, _, words = coded
    first, second = sorted((catalogue.path / "codes").glob("*/*"))[:2]
    tensors, about = map_tensors(second)
    for wrong in (about, {**about, "codebook": "0" * 32}, {**about, "data": "x"}):
        write_tensors(first, tensors, {key: wrong[key] for key in ("format", "codebook", "data")}, overwrite=True)
        with malformed("expected the codes of"):
            answer(Catalogue.open(catalogue.path), words[0])
    own = {"format": codes.FORMAT, "codebook": about["codebook"], "data": first.name.rsplit(".", 2)[0]}
    beyond = {**tensors, "rows": tensors["rows"] + np.uint32(OBJECTS)}
    write_tensors(first, beyond, own, overwrite=True)
    with malformed("codes of more than 301 rows"):
        answer(Catalogue.open(catalogue.path), words[0])


def test_rows_without_codes_are_compared_until_they_have_some(coded):
    catalogue, _, words = coded
    expected = answer(catalogue, words[4])
    for file in sorted((catalogue.path / "codes").glob("*/*"))[:2]:
        file.unlink()
    again = Catalogue.open(catalogue.path)
    assert (uncoded(again), answer(again, words[4])) == (2, expected)
    where = Conditions(scenes=("s0", "s1", "s2"))
    assert answer(again, words[4], where) == answer(again, words[4], where, exact=True)
    table.tidy(catalogue.path)
    assert (uncoded(again), answer(again, words[4])) == (0, expected)
    shutil.rmtree(catalogue.path / "codes")
    assert catalogue.answer(Query(vector=words[4], threshold=-1.0)).exact


def test_a_version_never_uses_codes_of_a_later_one(coded, monkeypatch):
    """Codes that are written late lack rows that were deleted meanwhile, and that an older version still has."""
    catalogue, _, words = coded
    monkeypatch.setattr(table, "_write_codes", lambda *_: None)
    near = np.repeat(words[:1], 20, axis=0)
    add(catalogue.path, "late", near)
    older = catalogue._snapshot()
    opened = current(catalogue.path)
    opened.table.delete("scene = 'late' AND object_id >= 4")
    monkeypatch.undo()
    table.tidy(catalogue.path)
    for snapshot, without, count in ((older, 1, 10), (catalogue._snapshot(), 0, 4)):
        read = codes.CodeReader(catalogue.path).of(snapshot)
        assert len(read.without) == without
        found = nearest_objects(snapshot, read, Search(words[0], "", 10, 1)).rows["scene"].to_pylist()
        assert found.count("late") == count


ASKING = """
import sys
import numpy as np
from drsplat import Query
from drsplat.query.catalogue import Catalogue
catalogue, vector = Catalogue.open(sys.argv[1]), np.load(sys.argv[2])
while True:
    entries = catalogue.ask(Query(vector=vector, threshold=0.99), top=20)
    print(*sorted({entry.scene for entry in entries}), len(entries), flush=True)
"""


@pytest.mark.slow
def test_another_process_sees_every_change_whole(coded):
    catalogue, _, words = coded
    vector = -words[0]
    np.save(catalogue.path.parent / "v.npy", vector)
    add(catalogue.path, "stays", np.repeat(vector[None], 8, axis=0))
    command = [sys.executable, "-c", ASKING, str(catalogue.path), str(catalogue.path.parent / "v.npy")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as asking:
        lines = [asking.stdout.readline()]
        for number in range(3):
            add(catalogue.path, "comes", np.repeat(vector[None], 12, axis=0))
            lines += [asking.stdout.readline() for _ in range(4)]
            catalogue.build_index() if number == 1 else table.tidy(catalogue.path)
            lines += [asking.stdout.readline() for _ in range(4)]
            catalogue.remove("comes")
            lines += [asking.stdout.readline() for _ in range(4)]
        asking.kill()
    assert set(lines) == {"stays 4\n", "comes stays 10\n"}


# --- manifests ---


def test_fragments_are_those_of_the_row_ids(coded):
    snapshot = coded[0]._snapshot()
    ids = np.sort(
        np.array(snapshot.table.search().with_row_id(True).select(["scene"]).to_arrow()["_rowid"].to_pylist())
    )
    fragments = snapshot.fragments
    assert fragments is not None
    assert [one.num_rows for one in fragments] == [OBJECTS + 1] * 4
    expected = np.concatenate([one.first + np.arange(one.num_rows) for one in fragments])
    assert_array_equal(ids, expected)
    names = {file.name for file in (snapshot.path / "objects.lance/data").iterdir()}
    assert {one.data for one in fragments} == names


def test_damaged_manifests_are_told_or_read(coded, tmp_path):
    snapshot, rng = coded[0]._snapshot(), default_rng(3)
    manifest = manifest_of(snapshot.path / "objects.lance", snapshot.version)
    good, told = manifest.read_bytes(), 0
    for number in range(300):
        damaged = bytearray(good[: int(rng.integers(0, len(good)))] if number % 3 == 0 else good)
        for at in rng.integers(0, max(len(damaged), 1), 6 if damaged else 0):
            damaged[at] = int(rng.integers(256))
        (tmp_path / "m").write_bytes(damaged)
        try:
            fragments_of(tmp_path / "m")
        except FormatError as error:
            told += str(tmp_path / "m") in str(error)
    assert told > 100
