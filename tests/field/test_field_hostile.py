"""Damaged and hostile fields, codebooks and FAISS indices: sound objects or a precise error."""

import struct
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from drsplat.errors import FormatError
from drsplat.field import build_field, load_field
from drsplat.field.codes import Codebook, Mixture, load_codebook, read_faiss_codebook, save_codebook
from drsplat.formats.faiss_index import read_faiss_quantizer
from drsplat.formats.tensors import map_tensors, write_tensors
from drsplat.scene.encoders import EncoderIdentity
from fields import SCENE, random_evidence, unchecked, unit_rows, without_checksums
from known_objects import with_objects
from mutations import quota, seeded, survivors

MUTANTS = quota(5_000)  # of each family
TINY = EncoderIdentity("tiny", 4)


def tiny_codebook(residual: bool = True) -> Codebook:
    rng = np.random.default_rng(0)
    centroids = rng.standard_normal((2, 256, 2)).astype(np.float32)
    return Codebook(centroids, unit_rows(rng, 3, 4) if residual else None, TINY)


@lru_cache
def field_files(mixture: bool = False) -> dict[str, bytes]:
    """The files of a small field with a coarse codebook or a mixture, evidence and negatives, without checksums."""
    import tempfile

    rng = np.random.default_rng(1)
    evidence = random_evidence(rng, rows=30, columns=8, dim=4)
    coding = Mixture(2) if mixture else tiny_codebook()
    field = build_field(evidence, SCENE, TINY, coding)
    field = field.with_negatives(unit_rows(rng, 2, 4), ("one", "two"))
    with tempfile.TemporaryDirectory() as folder:
        field.save(Path(folder) / "a")
        for file in (Path(folder) / "a").glob("*.safetensors"):
            without_checksums(file)
        return {file.name: file.read_bytes() for file in (Path(folder) / "a").iterdir()}


@lru_cache
def field_with_objects(checksums: bool) -> dict[str, bytes]:
    """The files of a field with objects."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        with_objects()[0].save(Path(folder) / "a")
        if not checksums:
            without_checksums(Path(folder) / "a/objects.safetensors")
        return {file.name: file.read_bytes() for file in (Path(folder) / "a").iterdir()}


def use_objects(path: Path) -> None:
    """Whatever loads must also work."""
    objects = load_field(path.parent).objects
    assert objects.thing_of().max(initial=-1) < len(objects)
    for row in range(0, len(objects.node_of), 100):
        objects.path(row)
    for node in range(objects.num_nodes):
        assert len(objects.masks_of(node)[0]) == len(objects.masks_of(node)[1])
        assert np.isfinite(objects.descriptors_of(node)).all()
        assert objects.rows(node).max(initial=-1) < len(objects.node_of)
        assert (objects.above(node) or node) >= node
        assert all(below < node for below in objects.below(node))


def faiss_bytes(residual: bool) -> bytes:
    """A FAISS index, written by hand from the format's description."""
    book, dim = tiny_codebook(residual), 4
    header = struct.pack("<iqqq?i", dim, 0, 1 << 20, 1 << 20, True, 0)
    quantizer = struct.pack("<QQQQ", dim, 2, 8, book.centroids.size) + book.centroids.tobytes()
    if book.coarse is None:
        return b"IxPq" + header + quantizer + struct.pack("<Qi?i", 0, 0, False, 0)
    coarse = b"IxFI" + header + struct.pack("<Q", book.coarse.size) + book.coarse.tobytes()
    inverted = struct.pack("<QQ", 3, 1) + coarse + struct.pack("<BQ", 0, 0)
    return b"IwPQ" + header + inverted + struct.pack("<?Q", True, 2) + quantizer + b"il00"


def use_field(path: Path) -> None:
    """Load a field and do what a user would: whatever loads must also work."""
    field = load_field(path.parent)
    query = np.float32([1, 2, 3, 4])
    with np.errstate(all="ignore"):
        field.scores(query, threads=1)
        assert (field.select(query, -2.0, threads=1).rows < len(field)).all()
        assert len(field.top(query, 5, threads=1).rows) <= len(field)
        field.best(np.stack([query, -query]), threads=1)
        field.feature(slice(None))
        if field.evidence is not None:
            field.evidence.features(0, len(field), threads=1)
            field.explain(int(field.gaussian_ids[0]), query)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count", "mixture"),
    [
        ("field.json", MUTANTS, False),
        ("codes.safetensors", quota(1000), False),
        ("codes.safetensors", quota(1000), True),
        ("evidence.safetensors", quota(1000), False),
        ("negatives.safetensors", quota(300), False),
    ],
)
def test_damaged_fields(name, count, mixture, tmp_path, bounded_memory, monkeypatch):
    unchecked(monkeypatch)
    for file, content in field_files(mixture).items():
        (tmp_path / file).write_bytes(content)
    read = use_field if name != "field.json" else lambda path: load_field(path.parent)
    assert 0 < survivors(tmp_path / name, read, seeded(len(name)), count) < count


@pytest.mark.slow
def test_damaged_objects(tmp_path, bounded_memory, monkeypatch):
    unchecked(monkeypatch)
    for file, content in field_with_objects(False).items():
        (tmp_path / file).write_bytes(content)
    with np.errstate(all="ignore"):
        assert 0 < survivors(tmp_path / "objects.safetensors", use_objects, seeded(4), quota(1000)) < quota(1000)


@pytest.mark.slow
def test_damaged_objects_are_an_error_or_the_same(tmp_path, bounded_memory):
    for file, content in field_with_objects(True).items():
        (tmp_path / file).write_bytes(content)
    expected = with_objects()[0].objects

    def read(path):
        found = load_field(path.parent).objects
        assert found is not None
        for name, array in expected.tensors().items():
            np.testing.assert_array_equal(getattr(found, name), array)

    with np.errstate(all="ignore"):
        assert survivors(tmp_path / "objects.safetensors", read, seeded(5), quota(300)) < quota(300)


@pytest.mark.slow
def test_damaged_tensors(tmp_path, bounded_memory):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.zeros((0, 3), "u1"), "c": np.ones(3, "f2")}
    write_tensors(tmp_path / "a", arrays, {"key": "value"})
    without_checksums(tmp_path / "a")

    def touch(path):
        with np.errstate(all="ignore"):
            for array in map_tensors(path)[0].values():
                array.sum()

    assert 0 < survivors(tmp_path / "a", touch, seeded(1), MUTANTS) < MUTANTS


@pytest.mark.slow
def test_damaged_codebooks(tmp_path, bounded_memory):
    save_codebook(tiny_codebook(), tmp_path / "a")
    # the hash notices all damage but to the names of things that are not there
    assert survivors(tmp_path / "a", load_codebook, seeded(2), MUTANTS) < MUTANTS / 20


@pytest.mark.slow
@pytest.mark.parametrize("residual", [False, True])
def test_damaged_faiss_indices(residual, tmp_path, bounded_memory):
    path = tmp_path / "a.faiss"
    path.write_bytes(faiss_bytes(residual))
    assert read_faiss_codebook(path, TINY).hash == tiny_codebook(residual).hash
    survived = survivors(path, lambda p: read_faiss_codebook(p, TINY).hash, seeded(3), MUTANTS // 2)
    assert 0 < survived < MUTANTS // 2


def test_the_handwritten_index_is_what_faiss_reads(tmp_path):
    faiss = pytest.importorskip("faiss")
    path = tmp_path / "a.faiss"
    path.write_bytes(faiss_bytes(False))
    index = faiss.read_index(str(path))  # owns what is read from it below
    centroids = faiss.vector_to_array(index.pq.centroids)
    np.testing.assert_array_equal(centroids, read_faiss_quantizer(path).centroids.ravel())


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b'{"a":1}', "expected dtype"),
        (b'{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4],"x":1}}', "expected dtype"),
        (b'{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,8]}}', "does not fill"),
        (b'{"a":{"dtype":"F32","shape":[-1],"data_offsets":[0,4]}}', "counts"),
        (b'{"a":{"dtype":"F32","shape":[1.0],"data_offsets":[0,4]}}', "counts"),
        (b'{"a":{"dtype":"F32","shape":[true],"data_offsets":[0,4]}}', "counts"),
        (b'{"a":{"dtype":"F8","shape":[1],"data_offsets":[0,4]}}', "dtype 'F8'"),
        (b'{"a":{"dtype":["F32"],"shape":[1],"data_offsets":[0,4]}}', "dtype"),
        (b'{"a":{"dtype":"F32","shape":[],"data_offsets":[0,4]},"a":{}}', "twice"),
        (b'{"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]}}', "describes 2 bytes"),
        (
            b'{"a":{"dtype":"U8","shape":[3],"data_offsets":[0,3]},'
            b'"b":{"dtype":"U8","shape":[2],"data_offsets":[2,4]}}',
            "overlap",
        ),
        (
            b'{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]},'
            b'"b":{"dtype":"I16","shape":[1],"data_offsets":[1,3]},'
            b'"c":{"dtype":"U8","shape":[1],"data_offsets":[3,4]}}',
            "aligned",
        ),
        (b'{"__metadata__":{"a":1},"b":{"dtype":"F32","shape":[],"data_offsets":[0,4]}}', "text"),
        (b"[" * 100_000, "not JSON"),
        (b"[]", "object"),
        (b"\xff\xfe{}", "JSON"),
        (b'{"a":' + b"9" * 5000 + b"}", "JSON"),
    ],
)
def test_headers_that_lie(header, message, tmp_path):
    path = tmp_path / "a"
    header += b" " * (-len(header) % 8)
    path.write_bytes(len(header).to_bytes(8, "little") + header + bytes(4))
    with pytest.raises(FormatError, match=message):
        map_tensors(path)


@pytest.mark.parametrize("content", [b"", b"1234567", b"\xff" * 8, b"\x10" + bytes(7) + b"{}"])
def test_files_too_short_for_their_header(content, tmp_path):
    path = tmp_path / "a"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        map_tensors(path)


@pytest.mark.parametrize("offset", [4, 37, 57, 90])  # dim, lists, coarse dim, coarse numbers
def test_faiss_counts_are_checked_before_they_are_believed(offset, tmp_path, bounded_memory):
    path = tmp_path / "a.faiss"
    content = bytearray(faiss_bytes(True))
    for value in (0, 2**31 - 1, 2**32 - 1):
        content[offset : offset + 4] = value.to_bytes(4, "little")
        path.write_bytes(content)
        with pytest.raises(FormatError):
            read_faiss_codebook(path, TINY)
