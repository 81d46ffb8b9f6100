"""A catalogue's codes: what they find of all, and that no change, kill or damage makes an answer wrong."""

import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from catalogued import add_plain, edit_document, unit
from drsplat import EncoderIdentity, Query
from drsplat.query.catalogue import Catalogue, Conditions, changes, nearest
from drsplat.query.catalogue.nearest import ANYWHERE, Search, nearest_objects
from drsplat.query.catalogue.snapshot import Snapshot
from refusing import malformed, refused

ENCODER = EncoderIdentity("test", 64)
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


def answer(catalogue: Catalogue, vector: np.ndarray, where: Conditions = ANYWHERE, exact: bool = False) -> list[object]:
    entries = catalogue.answer(Query(vector=vector, threshold=-1.0), where, exact=exact).entries
    return [(entry.scene, entry.object_id, round(entry.score, 5)) for entry in entries]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, np.ndarray, np.ndarray]:
    """A catalogue of four scenes with codes, in two parts, its descriptors and words."""
    path = tmp_path_factory.mktemp("coded") / "c"
    vectors, words = drawn(default_rng(0), 4)
    for number, own in enumerate(np.split(vectors, 4)):
        with mock.patch.object(changes, "MOST_OBJECTS", 2 * OBJECTS):
            add_plain(path, f"s{number}", own, ENCODER)
        if number == 1:
            assert Catalogue.open(path).build_index() == 2 * OBJECTS
    return path, vectors, words


@pytest.fixture
def coded(made, tmp_path) -> tuple[Catalogue, np.ndarray, np.ndarray]:
    shutil.copytree(made[0], tmp_path / "c")
    return Catalogue.open(tmp_path / "c"), *made[1:]


def nearest_of(snapshot: Snapshot, query: np.ndarray, wanted: int, exact: bool) -> nearest.Nearest:
    return nearest_objects(snapshot, Search(query, ANYWHERE, wanted, 1), exact)


def test_codes_find_what_comparing_all_finds(coded):
    catalogue, vectors, words = coded
    snapshot = catalogue._snapshot()
    for queries in (words[:20], vectors[:400:20]):
        shares = []
        for query in queries:
            by_codes, exact = (nearest_of(snapshot, query, 256, exact) for exact in (False, True))
            assert (by_codes.is_exact, exact.is_exact, len(by_codes.rows)) == (False, True, 256)
            best, best_of_all = (np.sort(one.described.cosines(query))[::-1] for one in (by_codes, exact))
            assert_allclose(best[:10], best_of_all[:10], atol=1e-6)
            shares.append(len(set(by_codes.rows.tolist()) & set(exact.rows.tolist())) / 256)
        assert np.mean(shares) > 0.9
    for threads in (1, 2, 3):
        assert answer(Catalogue.open(catalogue.path, threads=threads), words[0]) == answer(catalogue, words[0])


def test_of_larger_catalogues_more_candidates_are_compared():
    assert [nearest.refine_factor(rows) for rows in (0, 300_000, 750_000, 3_000_000, 30_000_000)] == [4, 4, 4, 8, 25]


def test_an_index_takes_enough_objects(tmp_path):
    add_plain(tmp_path / "c", "one", unit(default_rng(0), 300, 64), ENCODER)
    with refused("256 objects or more, there are 150"):
        Catalogue.open(tmp_path / "c").build_index()


def test_what_is_removed_or_replaced_is_never_answered(coded):
    catalogue, vectors, words = coded
    query = vectors[2 * OBJECTS * 2]  # the first object of s2
    assert answer(catalogue, query)[0][:2] == ("s2", 0)
    catalogue.remove("s2")
    assert "s2" not in {scene for scene, *_ in answer(catalogue, query)}
    add_plain(catalogue.path, "s1", drawn(default_rng(7), 1)[0], ENCODER)  # in place of another
    add_plain(catalogue.path, "new", np.repeat(query[None], 4, axis=0), ENCODER)
    assert [one[:2] for one in answer(catalogue, query)[:2]] == [("new", 0), ("new", 1)]
    for vector in (query, *words[:5]):
        assert answer(catalogue, vector) == answer(catalogue, vector, exact=True)
    catalogue.verify()


def test_codes_of_many_removed_objects_are_passed_over(tmp_path):
    """All that are nearest are gone, and their part is not written anew: those after them are found."""
    path, query = tmp_path / "c", unit(default_rng(0), 64)
    near = query + 0.01 * default_rng(1).standard_normal((400, 64)).astype(np.float32)
    add_plain(path, "far", unit(default_rng(2), 1000, 64), ENCODER)
    add_plain(path, "near", near, ENCODER)
    catalogue = Catalogue.open(path)
    catalogue.build_index()
    add_plain(path, "all", unit(default_rng(3), 1000, 64), ENCODER)  # puts these together
    catalogue.remove("near")
    assert max(map(len, catalogue._snapshot().parts)) == 1200
    found, exact = (nearest_of(catalogue._snapshot(), query, 30, exact) for exact in (False, True))
    assert (found.is_exact, set(found.rows.tolist())) == (False, set(exact.rows.tolist()))


def test_conditions(coded, monkeypatch):
    catalogue, vectors, words = coded
    one, many = Conditions(scenes=("s1",)), Conditions(scenes=("s0", "s3"))
    assert catalogue.answer(Query(vector=words[2], threshold=-1.0), one).exact
    monkeypatch.setattr(nearest, "FEW_ROWS", 0)  # by codes too
    for where in (one, many, Conditions(box=(0.0, 0.0, 0.0, 2.0, 2.0, 2.0))):
        assert not catalogue.answer(Query(vector=words[2], threshold=-1.0), where).exact
        for query in (*words[:3], vectors[0], -words[0]):
            assert answer(catalogue, query, where) == answer(catalogue, query, where, exact=True)
    assert answer(catalogue, words[0], Conditions(scenes=("nobody",))) == []


def test_nobody_waits_while_the_index_is_built(tmp_path, monkeypatch):
    path, vectors = tmp_path / "c", unit(default_rng(4), 600, 64)
    for name, own in (("stays", vectors[:500]), ("goes", vectors[500:550])):
        add_plain(path, name, own, ENCODER, 1)
    catalogue, train = Catalogue.open(path), changes.train_codebook

    def meanwhile(*given, **how):
        catalogue.remove("goes")
        add_plain(path, "comes", vectors[550:], ENCODER, 1)
        return train(*given, **how)

    monkeypatch.setattr(changes, "train_codebook", meanwhile)
    catalogue.build_index()
    for at, expected in ((10, [("stays", 10)]), (520, []), (560, [("comes", 10)])):
        asked = catalogue.answer(Query(vector=vectors[at], threshold=0.99))
        assert ([(entry.scene, entry.object_id) for entry in asked.entries], asked.exact) == (expected, False)


KILLED = """
import os, sys
from drsplat.query.catalogue import Catalogue, changes
real, times = changes.{name}, []
def killed(*given, **how):
    times.append(1)
    os.kill(os.getpid(), 9) if len(times) == {at} else None
    return real(*given, **how)
changes.{name} = killed
Catalogue.open(sys.argv[1]).build_index()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "at"), [("save_codebook", 1), ("write_tensors", 1), ("write_tensors", 2), ("write_json", 1)]
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
    again.verify()


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
    add_plain(catalogue.path, "stays", np.repeat(vector[None], 8, axis=0), ENCODER)
    command = [sys.executable, "-c", ASKING, str(catalogue.path), str(catalogue.path.parent / "v.npy")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as asking:
        lines = [asking.stdout.readline()]
        for number in range(3):
            add_plain(catalogue.path, "comes", np.repeat(vector[None], 12, axis=0), ENCODER)
            lines += [asking.stdout.readline() for _ in range(4)]
            if number == 1:
                catalogue.build_index()
                lines += [asking.stdout.readline() for _ in range(4)]
            catalogue.remove("comes")
            lines += [asking.stdout.readline() for _ in range(4)]
        asking.kill()
    assert set(lines) == {"stays 4\n", "comes stays 10\n"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["parts"][0].update(codes=d["parts"][-1]["codes"]), "codes of other descriptors"),
        (lambda d: d["parts"][0].update(codes=None), "a part without codes"),
        (lambda d: d["encoder"].update(name="x"), "a codebook of test"),
    ],
)
def test_codes_that_do_not_fit_are_refused(coded, change, said):
    catalogue, vectors, words = coded
    add_plain(catalogue.path, "small", vectors[:4], ENCODER)
    edit_document(catalogue.path, change)
    with malformed(f"{said}.*index. makes these files anew"):
        answer(catalogue, words[0])
