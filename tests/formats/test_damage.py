"""A flipped bit in what was kept is noticed, everywhere; what killed processes leave is swept."""

import json
import os
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from command_line import answer_of, error_of
from drsplat import _native
from drsplat.cli import main
from drsplat.errors import DrSplatError, FormatError
from drsplat.field import LanguageField, build_field, load_field
from drsplat.field.codes import PQ, Mixture, load_codebook, save_codebook
from drsplat.formats.replacing import brief, replacing, sweep, together
from drsplat.formats.tensors import map_tensors, read_tensors, sealed, write_tensors
from drsplat.formats.vocabulary import read_vocabulary
from fields import SCENE, TOY, random_evidence, toy_field, unit_rows, without_checksums
from mutations import quota
from refusing import malformed

FLIPS = quota(400)


def saved_field(folder: Path, mixture: bool = False) -> Path:
    rng = default_rng(2)
    evidence = random_evidence(rng)
    field = build_field(evidence, SCENE, TOY, Mixture(2) if mixture else PQ())
    field.with_negatives(unit_rows(rng, 2, 32), ("one", "two")).save(folder / "a.field")
    return folder / "a.field"


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
    return bytes(changed)


def answers(field: LanguageField) -> list[object]:
    """Everything that a field says, as comparable values."""
    queries = unit_rows(default_rng(5), 2, 32)
    evidence = field.evidence
    arrays = (
        field.gaussian_ids, field.scores(queries), field.relevancy(queries[0]), evidence.weights.data,
        evidence.weights.indptr, evidence.weights.indices, evidence.embeddings, evidence.masks.views,
        evidence.masks.ids, field.negatives.embeddings,
    )  # fmt: skip
    said = (field.encoder, field.scene, field.num_gaussians, field.aggregator)
    names = evidence.masks.view_names, field.negatives.texts
    return [array.tobytes() for array in arrays] + [said, names]


@pytest.mark.slow
@pytest.mark.parametrize("mixture", [False, True])
def test_a_flipped_bit_in_a_field_never_changes_an_answer(mixture, tmp_path):
    path, rng = saved_field(tmp_path, mixture), default_rng(3)
    expected = answers(load_field(path))
    for file in sorted(path.iterdir()):
        good, refused = file.read_bytes(), 0
        for _ in range(FLIPS // 4):
            file.write_bytes(flipped(good, rng))
            try:
                assert answers(load_field(path)) == expected, file.name
            except DrSplatError:
                refused += 1
        assert refused > FLIPS // 8  # but for unused bits, such as spaces
        file.write_bytes(good)


def damage(path: Path, tensor: str, at: int = 0) -> None:
    """Flip a bit of one tensor in place."""
    array = map_tensors(path)[0][tensor]
    data = bytearray(path.read_bytes())
    offset = data.index(array.tobytes()) + at
    data[offset] ^= 4
    path.write_bytes(data)


def test_damage_is_found_at_first_use_and_by_verify(tmp_path):
    path = saved_field(tmp_path)
    load_field(path).verify()
    damage(path / "evidence.safetensors", "data")
    field = load_field(path)
    assert len(field.top(unit_rows(default_rng(0), 1, 32)[0], 3).rows) == 3
    for use in (field.verify, lambda: field.evidence, lambda: field.explain(0, np.ones(32, "f4"))):
        with malformed(r"evidence.*'data' is not what was written.*register"):
            use()
    with malformed("not what was written"):
        field.save(tmp_path / "b.field")  # would give the damage new checksums
    assert not (tmp_path / "b.field").exists()


def test_inspect_verifies(tmp_path, capsys):
    path = saved_field(tmp_path)
    (path / "notes.txt").write_text("not of the field")
    manifest = json.loads((path / "field.json").read_text())
    verified = answer_of(capsys, "inspect", path, "--verify")["verified"]
    del manifest["crc32"]
    assert verified == sorted(["field.json", *manifest["files"]])
    damage(path / "negatives.safetensors", "maxima")
    assert "'maxima' is not what was written" in error_of(capsys, "inspect", path, "--verify")


@pytest.mark.parametrize("given", [["--output", ""], ["--output="]])
def test_empty_names_are_refused(given, capsys):
    """They would be the current folder, or the default."""
    assert main(["embed", "capture", *given]) == 2
    assert "--output is empty: give a value" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "encoding"), [("v\xe4se", "ascii"), ("v\udcffse", "utf-8")])
def test_any_name_is_printed_on_any_terminal(name, encoding, tmp_path):
    toy_field().save(tmp_path / name)
    ran = subprocess.run(
        [sys.executable, "-m", "drsplat", "inspect", tmp_path / name],
        env=os.environ | {"PYTHONIOENCODING": encoding}, capture_output=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert rb"v\xe4se" in ran.stdout or rb"v\udcffse" in ran.stdout


@pytest.mark.parametrize(
    ("text", "reason"),
    [('{"vase": [1, 0], "vase": [0, 1]}', "'vase' is given twice"), (r'{"\ud800": [1, 0]}', "half a character")],
)
def test_vocabularies_whose_names_are_no_names_are_refused(text, reason, tmp_path):
    (tmp_path / "a.json").write_text(text)
    with malformed(reason):
        read_vocabulary(tmp_path / "a.json")


@pytest.mark.parametrize("dtype", ["F8_E4M3", "F4", "BF16", "C64"])
def test_vocabularies_of_other_numbers_are_refused(dtype, tmp_path):
    entry = {"dtype": dtype, "shape": [1, 16], "data_offsets": [0, 16]}
    header = json.dumps({"__metadata__": {"texts": '["vase"]'}, "embeddings": entry}).encode()
    content = len(header).to_bytes(8, "little") + header + bytes(16)
    (tmp_path / "a.safetensors").write_bytes(content)
    with malformed(f"dtype '{dtype}' is none of"):
        read_vocabulary(tmp_path / "a.safetensors")


def test_a_field_without_checksums_is_refused(tmp_path):
    path = saved_field(tmp_path)
    manifest = json.loads((path / "field.json").read_text())
    without_checksums(path / "negatives.safetensors")
    with malformed("checksum of every tensor"):
        load_field(path).verify()
    manifest.pop("crc32")
    (path / "field.json").write_text(json.dumps(manifest))
    with malformed("damaged or edited"):
        load_field(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_weights_that_are_no_weights_are_refused(value, tmp_path):
    path = saved_field(tmp_path) / "evidence.safetensors"
    tensors, metadata = map_tensors(path)
    arrays = {name: np.array(array) for name, array in tensors.items()}
    arrays["data"][7] = value
    write_tensors(path, arrays, metadata, overwrite=True)  # with the right checksums
    with malformed("finite numbers of 0 or more"):
        load_field(path.parent).verify()


def test_negatives_that_are_no_numbers_are_refused(tmp_path):
    path = saved_field(tmp_path) / "negatives.safetensors"
    tensors, metadata = map_tensors(path)
    arrays = {name: np.array(array) for name, array in tensors.items()}
    arrays["maxima"][0] = np.nan
    write_tensors(path, arrays, metadata, overwrite=True)
    with malformed("finite"):
        load_field(path.parent)


def test_a_flipped_bit_in_a_tensor_file_is_noticed(tmp_path):
    rng = default_rng(4)
    arrays = {"a": rng.random((40, 3)), "b": np.zeros((0, 3), "u1"), "c": np.arange(7, dtype="u2")}
    write_tensors(tmp_path / "a", arrays, {"key": "value \ud800"})
    good = (tmp_path / "a").read_bytes()
    for _ in range(FLIPS):
        (tmp_path / "a").write_bytes(flipped(good, rng))
        try:
            tensors, metadata = read_tensors(tmp_path / "a")
        except FormatError:
            continue
        assert metadata["key"] == "value \ud800"
        assert all(np.array_equal(tensors[name], array) for name, array in arrays.items())


def test_a_codebook_of_ours_is_checked_whole(tmp_path):
    save_codebook(toy_field().codebook, tmp_path / "a")
    good, rng = (tmp_path / "a").read_bytes(), default_rng(6)
    expected = load_codebook(tmp_path / "a")
    for _ in range(FLIPS):
        (tmp_path / "a").write_bytes(flipped(good, rng))
        try:
            book = load_codebook(tmp_path / "a")
        except DrSplatError:
            continue
        assert book.encoder == expected.encoder
        assert_array_equal(book.centroids, expected.centroids)


def test_sums_of_any_bytes_are_those_of_zlib():
    """Few bytes go by tables, many by products of polynomials, millions on threads; they may go on from others."""
    content = default_rng(0).integers(0, 256, 9_000_000, np.uint8).tobytes()
    for size in (*range(200), 1023, 4096, len(content) - 1):
        for value in (0, 1, 0xFFFFFFFF, 0x12345678):
            part = memoryview(content)[size % 2 :][:size]
            assert _native.crc32(part, value) == zlib.crc32(part, value)
    half = _native.crc32(content[:33_333], 0)
    assert _native.crc32(content[33_333:], half) == zlib.crc32(content)
    with pytest.raises((BufferError, ValueError)):
        _native.crc32(np.zeros((4, 4), np.uint8)[:, ::2], 0)


def test_checksums_are_those_of_zlib(tmp_path):
    """As docs/formats.md describes them, so that others can check our files."""
    array = np.arange(12, dtype="f4").reshape(3, 4)
    write_tensors(tmp_path / "a", {"a": array}, {"key": "value"})
    raw = (tmp_path / "a").read_bytes()
    header = json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])
    metadata = header["__metadata__"]
    assert json.loads(metadata["crc32"]) == {"a": f"{zlib.crc32(array.tobytes()):08x}"}
    whole = metadata.pop("crc32_header")
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    assert whole == f"{zlib.crc32(text):08x}"
    document = sealed({"b": 1, "a": ["ä"]})
    canonical = rb'{"a":["\u00e4"],"b":1}'
    assert document["crc32"] == f"{zlib.crc32(canonical):08x}"


# --- files that stay ---


def test_files_are_on_the_disk_before_they_get_their_name(tmp_path, monkeypatch):
    seen = []
    names = {"fsync": "fsync", "replace": "name", "rename": "name"}
    for name, kind in names.items():
        real = getattr(os, name)

        def spy(*given, real=real, kind=kind):
            seen.append(kind)
            return real(*given)

        monkeypatch.setattr(os, name, spy)
    with replacing(tmp_path / "a") as file:
        file.write(b"a")
    assert seen == ["fsync", "name", "fsync"]  # the file, its name, the folder
    seen.clear()
    with brief(), replacing(tmp_path / "b") as file:
        file.write(b"b")
    assert seen == ["name"]
    seen.clear()
    toy_field().save(tmp_path / "a.field")
    assert seen[-2:] == ["name", "fsync"]
    assert seen.count("fsync") == 2 * 3 + 1  # two files and the manifest, each with its name


KILLED = """
import os, sys
from pathlib import Path
from drsplat.formats.replacing import replacing
with replacing(Path(sys.argv[1]) / "a") as file:
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), 9)
"""


def test_what_a_killed_process_left_is_swept_and_what_is_in_use_is_not(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    left = next(iter(tmp_path.iterdir()))
    (tmp_path / ".a.field.0123456789abcdef.tmp").mkdir()
    (tmp_path / ".a.field.0123456789abcdef.tmp/codes.safetensors").write_bytes(b"half")
    old = tmp_path / ".a.field.0123456789abcdef.old.tmp"
    old.mkdir()  # the only copy there may be
    (tmp_path / ".mine.tmp").write_bytes(b"")
    with replacing(tmp_path / "b") as file:
        hidden = set(tmp_path.iterdir()) - {old, tmp_path / ".mine.tmp"}
        assert left not in hidden
        assert len(hidden) == 1
        sweep.cache_clear()
        sweep(tmp_path)
        file.write(b"whole")
    assert (tmp_path / "b").read_bytes() == b"whole"
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([old.name, ".mine.tmp", "b"])


FULL = """
import resource, sys
from pathlib import Path
import numpy as np
from PIL import Image
from drsplat.field import load_field
from drsplat.errors import InputError
from drsplat.formats.npy import write_npy
from drsplat.drawing.pictures import write_picture
folder = Path(sys.argv[1])
field = load_field(folder / "a.field")
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
writers = {"b.npy": lambda p: write_npy(p, noise), "b.png": lambda p: write_picture(p, noise), "b.field": field.save}
for name, write in writers.items():
    try:
        write(folder / name)
    except InputError as error:
        print(name, error)
"""


def test_a_full_disk_is_told_in_our_words_by_every_writer(tmp_path):
    saved_field(tmp_path)
    ran = subprocess.run([sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True, check=True)
    told = ran.stdout.splitlines()
    for name, line in zip(("b.npy", "b.png", "b.field"), told, strict=True):
        assert line.startswith(f"{name} {tmp_path / name}: there is no room left to write it")
        assert "free some space" in line
    assert [path.name for path in tmp_path.iterdir()] == ["a.field"]


def test_files_that_belong_together_appear_together(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    with together():
        with replacing(first) as file:
            file.write(b"1")
        assert not first.exists()
        with replacing(second) as file:
            file.write(b"2")
        assert not second.exists()
    assert (first.read_bytes(), second.read_bytes()) == (b"1", b"2")
    assert sorted(tmp_path.iterdir()) == [first, second]


def test_of_files_that_belong_together_all_or_none(tmp_path):
    with pytest.raises(ValueError, match="stop"), together():  # noqa: PT012
        with replacing(tmp_path / "a") as file:
            file.write(b"1")
        raise ValueError("stop")
    assert not list(tmp_path.iterdir())
    with replacing(tmp_path / "a") as file:  # and afterwards files appear by themselves
        file.write(b"1")
    assert (tmp_path / "a").exists()
