"""Features in the compact form: the same as LangSplat's files hold, read by all that read those."""

import json
from pathlib import Path

import numpy as np
import pytest
import zstandard
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from test_embedding import a_view

import drsplat as ds
from command_line import answer_of
from drsplat.errors import FormatError, InputError
from drsplat.formats import compact_features
from drsplat.formats.compact_features import read_compact, write_compact
from drsplat.formats.embedding_record import COMPACT
from drsplat.formats.langsplat import LEVELS, FeatureFolder, read_features, write_features
from drsplat.formats.tensors import map_tensors, write_tensors
from drsplat.photos.embedding.embed import EmbeddingReport, embed
from fake_models import ColorSegmenter, LargeSegmenter, ThumbnailEncoder
from fields import unit_rows, without_checksums
from mutations import quota, seeded, survivors


def blocks(seed: int = 0, levels: int = 4, count: int = 9) -> np.ndarray:
    """Maps of large areas, as masks are."""
    small = default_rng(seed).integers(-1, count, (levels, 6, 8))
    return small.repeat(30, 1).repeat(30, 2).astype(np.int32)


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("maps", [blocks(), blocks(1)[:, :7, :5].copy(), blocks(2, 1)[0]])
def test_both_forms_hold_the_same_and_turn_into_each_other(maps, tmp_path):
    rows = unit_rows(default_rng(1), 9, 16)
    write_features(tmp_path / "theirs", "cam0/a", maps, rows)
    theirs = read_features(tmp_path / "theirs")
    write_features(tmp_path / "ours", "cam0/a", *theirs.stored("cam0/a"), form="compact")
    ours = read_features(tmp_path / "ours")
    assert list(ours) == list(theirs) == ["cam0/a"]
    assert ours.dim == theirs.dim == 16
    for level in LEVELS:
        one, other = (read_features(tmp_path / n, level)["cam0/a"] for n in ("ours", "theirs"))
        assert_array_equal(one.mask_ids, other.mask_ids)
        assert_array_equal(one.embeddings, other.embeddings)
        assert_array_equal(one.file_rows, other.file_rows)
    write_features(tmp_path / "back", "cam0/a", *ours.stored("cam0/a.jpg"))
    assert files_of(tmp_path / "back") == files_of(tmp_path / "theirs")


def test_alike_levels_are_kept_once_and_it_is_small(tmp_path):
    rows = unit_rows(default_rng(1), 9, 16)
    write_features(tmp_path, "four", blocks(), rows, form="compact")
    write_features(tmp_path, "one", np.stack([blocks()[3]] * 4), rows, form="compact")
    assert len(read_compact(tmp_path / f"four{COMPACT}").maps) == 4
    assert len(read_compact(tmp_path / f"one{COMPACT}").maps) == 1
    assert (tmp_path / f"four{COMPACT}").stat().st_size < blocks().nbytes / 100
    write_features(tmp_path, "many", blocks(0, 4, 70_000), np.ones((70_000, 1), "f4"), form="compact")
    assert_array_equal(FeatureFolder(tmp_path, 0).stored("many")[0], blocks(0, 4, 70_000))


def test_a_photo_in_two_forms_and_unknown_forms_are_refused(tmp_path):
    rows = unit_rows(default_rng(1), 9, 16)
    write_features(tmp_path, "a", blocks(), rows)
    theirs = files_of(tmp_path)
    with pytest.raises(InputError, match="another form"):
        write_features(tmp_path, "a", blocks(), rows, form="compact")
    with pytest.raises((InputError, TypeError), match="compact"):
        write_features(tmp_path, "b", blocks(), rows, form="png")
    write_features(tmp_path, "a", blocks(), rows, overwrite=True, form="compact")
    assert list(files_of(tmp_path)) == [f"a{COMPACT}"]
    for name, content in theirs.items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(FormatError, match=r"two forms.*remove one: a"):
        read_features(tmp_path)


# --- embed ---


def embedded(views: list[ds.View], folder: Path, **options: object) -> EmbeddingReport:
    return embed(views, folder, ColorSegmenter(), ThumbnailEncoder(), **options)


def test_embed_writes_it_by_default_and_turns_what_is_finished(tmp_path):
    views = [a_view(tmp_path, name) for name in ("a.png", "cam0/b.png")]
    assert embedded(views, tmp_path / "theirs", form="langsplat").reused == 0
    assert embedded(views, tmp_path / "out").reused == 0
    ours = files_of(tmp_path / "out")
    assert set(ours) == {"embedding.json", f"a{COMPACT}", f"cam0/b{COMPACT}"}
    turned = embedded(views, tmp_path / "out", form="langsplat")
    assert (turned.reused, turned.redone, turned.changes) == (2, 0, ())
    assert files_of(tmp_path / "out") == files_of(tmp_path / "theirs")
    assert embedded(views, tmp_path / "out").reused == 2
    assert files_of(tmp_path / "out") == ours


def test_damaged_files_are_embedded_again(tmp_path):
    views = [a_view(tmp_path, name) for name in ("a.png", "b.png")]
    embedded(views, tmp_path / "out")
    before = files_of(tmp_path / "out")
    path = tmp_path / "out" / f"a{COMPACT}"
    path.write_bytes(before[path.name][:-1] + b"\0")
    report = embedded(views, tmp_path / "out")
    assert (report.reused, report.redone) == (1, 1)
    assert files_of(tmp_path / "out") == before


def test_an_edited_record_is_refused(tmp_path):
    views = [a_view(tmp_path, "a.png")]
    embedded(views, tmp_path / "out")
    record = tmp_path / "out/embedding.json"
    document = json.loads(record.read_text())
    document["settings"]["encoder"]["name"] += "x"
    record.write_text(json.dumps(document))
    with pytest.raises(FormatError, match=r"embedding\.json: damaged or edited"):
        embedded(views, tmp_path / "out")


def test_inspect_tells_features_of_either_form(tmp_path, capsys):
    views = [a_view(tmp_path, "a.png")]
    told = []
    for form in ("compact", "langsplat"):
        embed(views, tmp_path / form, LargeSegmenter(), ThumbnailEncoder(), form=form)
        told.append(answer_of(capsys, "inspect", tmp_path / form) | {"path": ""})
    assert told[0] == told[1]
    assert told[0]["kind"] == "features"


# --- hostile files ---


def hostile(path: Path, **changes: object) -> Path:
    """A sound file with some tensors or metadata replaced, and the right checksums."""
    write_compact(path, blocks(), unit_rows(default_rng(1), 9, 4), overwrite=True)
    tensors, about = map_tensors(path)
    arrays = {name: np.array(array) for name, array in tensors.items()}
    for name, value in changes.items():
        (arrays if isinstance(value, np.ndarray) else about)[name] = value
    write_tensors(path, arrays, about, overwrite=True)
    return path


def squeezed(data: bytes) -> np.ndarray:
    return np.frombuffer(zstandard.ZstdCompressor().compress(data), np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"size": "[1, 2]"},
        {"size": "[180]"},
        {"size": "[0, 240]"},
        {"size": "[100000, 100000]"},
        {"size": "[11000, 12000]"},
        {"size": "[" * 5000},
        {"levels": "[0, 1, 2]"},
        {"levels": "[0, 1, 2, 4]"},
        {"levels": "[0, 0, 0, 0]", "map_0": np.zeros(5, np.uint8)},
        {"levels": "[0, 1, 2, true]"},
        {"format": "drsplat features 2"},
        {"map_3": squeezed(bytes(180 * 240))},
        {"map_3": squeezed(bytes(1 << 28))},
        {"map_3": squeezed(b"\xff" * (180 * 240 * 2))},
        {"map_3": np.zeros((3, 3), np.uint8)},
        {"embeddings": np.zeros((9, 0), np.float32)},
        {"embeddings": np.zeros((9, 4), np.float64)},
        {"embeddings": np.zeros((9, 4), np.float32)},
    ],
)
def test_hostile_files_are_refused(changes, tmp_path, bounded_memory):
    hostile(tmp_path / f"a{COMPACT}", **changes)
    with pytest.raises(FormatError):
        FeatureFolder(tmp_path, LEVELS.index("large"))["a"]


def test_mutants_are_read_or_refused(tmp_path, bounded_memory, monkeypatch):
    """With checksums out of the way, which would refuse nearly all."""
    path = hostile(tmp_path / f"a{COMPACT}")
    without_checksums(path)
    monkeypatch.setattr(compact_features, "read_tensors", map_tensors)
    count = quota(800)
    survived = survivors(path, lambda _: FeatureFolder(tmp_path, LEVELS.index("large"))["a"], seeded(0), count)
    assert 0 < survived < count
