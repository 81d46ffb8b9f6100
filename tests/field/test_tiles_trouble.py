"""A disk that is full at any file of any step of tiles, and tiles that are damaged between steps: nothing is lost."""

import re
from pathlib import Path

import pytest
from test_tiles import inputs, saved, written

import drsplat as ds
from drsplat.errors import FormatError
from drsplat.field.objects import finding
from drsplat.field.tiles import finding as in_tiles
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.launching import OneProcess, Processes
from drsplat.field.tiles.registering import register_tiles
from drsplat.formats import replacing
from drsplat.formats.sources import blocks_of
from drsplat.formats.tiles import read_tiles
from toy_capture import write_toy_capture

AGGREGATOR = "robust"  # which has the most steps
HERE = OneProcess()


@pytest.fixture
def capture(tmp_path, monkeypatch) -> Path:
    """Some photos and tiles, of which runs and blocks are made small, so that there are several."""
    monkeypatch.setattr("drsplat.field.tiles.transposing.RUN_BYTES", 20_000)
    monkeypatch.setattr(finding, "MAX_WEIGHTS", 0)
    monkeypatch.setattr(finding, "BLOCK_WEIGHTS", 2000)
    folder = write_toy_capture(tmp_path / "toy")
    cut(blocks_of([folder / "scene.ply"]), folder / "scene.tiles", 37)
    return folder


def with_objects(capture: Path, parts: Path | str, launcher: OneProcess | Processes = HERE) -> ds.LanguageField:
    """Go through all steps: columns, rows, votes, codes, blocks and borders."""
    tiles, how = read_tiles(capture / "scene.tiles"), {"launcher": launcher, "threads": 1}
    views, features = inputs(capture)
    made = register_tiles(tiles, views, features, parts=parts, **how)
    field = made.to_field(ds.PQ(), aggregator=AGGREGATOR, gaussians=None, threads=1)
    return field.with_objects(in_tiles.find_objects(field, tiles, parts=str(parts), views=views, **how))


def kind_of(name: str) -> str:
    """Return a file's name without the numbers that tell it from others of its kind."""
    return re.sub(r"[0-9a-f]{8,}|\d+", "#", name)


def made_by_tasks(parts: Path) -> dict[str, int]:
    """Return when each file was written, without what tasks are given each time: embeddings, and the rows of blocks."""
    return {
        name: at for name, at in written(parts).items() if not re.search(r"\.embeddings\.|objects/.*\.rows\.", name)
    }


@pytest.mark.slow
def test_a_full_disk_at_any_kind_of_file_is_told_and_loses_nothing(capture, tmp_path, monkeypatch):
    names = []
    new_file, refused = replacing._new_file, ""

    def maybe_full(path):
        nonlocal refused
        names.append(kind_of(path.name))
        if names[-1] == refused:
            raise OSError(28, "No space left on device", str(path))
        return new_file(path)

    monkeypatch.setattr(replacing, "_new_file", maybe_full)
    expected = saved(with_objects(capture, tmp_path / "whole"), tmp_path / "whole.field")
    kinds = list(dict.fromkeys(names))
    assert len(kinds) >= 8
    for number, kind in enumerate(kinds):
        parts, field, refused = tmp_path / f"{number}.parts", tmp_path / f"{number}.field", kind
        with pytest.raises(replacing.NoRoom, match="no room left to write it"):
            with_objects(capture, parts).save(field)
        before, refused = made_by_tasks(parts), ""
        assert saved(with_objects(capture, parts), field) == expected, kind
        after = made_by_tasks(parts)
        assert {name: after[name] for name in before} == before, kind


@pytest.mark.parametrize("step", ["features", "objects"])
def test_a_tile_that_is_damaged_between_steps_is_told(capture, tmp_path, step):
    tiles, parts = read_tiles(capture / "scene.tiles"), tmp_path / "parts"
    made = register_tiles(tiles, *inputs(capture), parts=parts, threads=1)
    field = made.to_field(ds.PQ(), threads=1)
    steps = {
        "features": lambda: made.to_field(ds.PQ(), aggregator=AGGREGATOR, gaussians=None, threads=1),
        "objects": lambda: in_tiles.find_objects(field, read_tiles(tiles.path), parts=str(parts), views=[], threads=1),
    }
    for file in tiles.path.glob("*.safetensors"):
        file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(FormatError, match="Restore the folder"):
        steps[step]()


@pytest.mark.slow
@pytest.mark.parametrize("launcher", [HERE, Processes(2)], ids=["here", "processes"])
def test_an_object_store_holds_the_work_of_every_step(capture, tmp_path, launcher, monkeypatch):
    pytest.importorskip("fsspec", reason="needs fsspec")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    expected = saved(with_objects(capture, tmp_path / "parts"), tmp_path / "a.field")
    bucket = tmp_path / "bucket"
    assert saved(with_objects(capture, f"local://{bucket}", launcher), tmp_path / "b.field") == expected
    before = made_by_tasks(bucket)
    for cached in tmp_path.glob("drsplat-store-*"):  # another machine has none of it
        cached.rename(tmp_path / "gone")
    assert saved(with_objects(capture, f"local://{bucket}", launcher), tmp_path / "c.field") == expected
    assert made_by_tasks(bucket) == before
