"""Streamed SOG: the finest level, chunk by chunk; trees that lie are refused."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from drsplat.errors import DrSplatError
from drsplat.field.tiles.cutting import cut
from drsplat.formats.sources import blocks_of, sources_of
from drsplat.formats.streamed_sog import LOD_META
from refusing import malformed
from scene_files import random_gaussians, sog_files

BOX = {"min": [-1, -1, -1], "max": [1, 1, 1]}


def leaf(chunk: int, coarse: int, count: int) -> dict[str, object]:
    return {
        "bound": BOX,
        "lods": {"0": {"file": chunk, "offset": 0, "count": count}, "1": {"file": coarse, "offset": 0, "count": 5}},
        "errors": [0, 0.25],  # of levels, which splat-transform writes with --lod-errors
    }


def write_streamed(folder: Path, has_environment: bool = True, **change: object) -> list[ds.Gaussians]:
    """Three chunks of the finest level, one of a coarser one, and an environment: those that are to be read."""
    chunks = [random_gaussians(np.random.default_rng(seed), 40 + seed, 1) for seed in range(5)]
    names = ["0_0", "0_1", "0_2", "1_0", "env"]
    for name, chunk in zip(names, chunks, strict=True):
        (folder / name).mkdir(parents=True)
        for file, content in sog_files(chunk).items():
            (folder / name / file).write_bytes(content)
    tree = {"bound": BOX, "children": [leaf(0, 3, 40), {"bound": BOX, "children": [leaf(1, 3, 41), leaf(2, 3, 42)]}]}
    meta = {
        "version": 1, "asset": {"generator": "a test"}, "count": 128, "counts": [123, 5], "lodLevels": 2,
        "lodErrors": True, "filenames": [f"{name}/meta.json" for name in names[:4]], "tree": tree,
    }  # fmt: skip
    meta |= {"environment": "env/meta.json"} if has_environment else {}
    (folder / LOD_META).write_text(json.dumps(meta | change))
    return [*chunks[:3], *([chunks[4]] if has_environment else [])]


@pytest.mark.parametrize("environment", [True, False])
def test_the_finest_level_is_the_scene(tmp_path, environment):
    chunks = write_streamed(tmp_path, environment)
    for place in (tmp_path, tmp_path / LOD_META):
        found = ds.read_gaussians(place)
        assert_allclose(found.means, np.concatenate([chunk.means for chunk in chunks]), atol=2e-4)
        assert found.sh_degree == 1


def test_a_streamed_scene_is_cut_chunk_by_chunk(tmp_path):
    write_streamed(tmp_path / "sog")
    tiles = cut(blocks_of([tmp_path / "sog"]), tmp_path / "s.tiles", 50)
    assert tiles.sources == ("0_0/meta.json", "0_1/meta.json", "0_2/meta.json", "env/meta.json")
    found, whole = tiles.gaussians(), ds.read_gaussians(tmp_path / "sog")
    starts = np.cumsum([0, *(len(source.positions()) for source in sources_of(tmp_path / "sog"))])
    rows = starts[found.extra["block"]] + found.extra["source_row"]
    assert_array_equal(found.means, whole.means[rows])
    assert_array_equal(found.scales, whole.scales[rows])


def one(tree: object) -> dict[str, object]:
    return {"tree": tree}


DEEP = {"bound": BOX}
for _ in range(70):
    DEEP = {"bound": BOX, "children": [DEEP]}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"version": 2}, "version 1"),
        ({"version": True}, "version 1"),
        ({"filenames": "0_0/meta.json"}, "filenames: expected a list"),
        (one({"bound": BOX}), "names no chunk"),
        (one(3), "tree: expected an object with lods, children"),
        (one({"children": {}}), "expected a list"),
        (one({"lods": []}), "expected an object"),
        (one({"lods": {"0": {"file": 9}}}), "chunk 9, there are 4"),
        (one({"lods": {"0": {"file": -1}}}), "0 or more"),
        (one({"lods": {"0": {"file": 1.5}}}), "whole number"),
        (one({"lods": {"0": {"file": 1}, "1": {"file": 1}}}), "chunk 1 holds several levels"),
        (one(DEEP), "64 deep"),
        ({"filenames": ["../secret/meta.json"] * 4}, "in this folder"),
        ({"filenames": ["/etc/meta.json"] * 4}, "in this folder"),
        ({"filenames": ["0_0/other.json"] * 4}, "in this folder"),
        ({"environment": 3}, "in this folder"),
    ],
)
def test_trees_that_lie(tmp_path, change, said):
    write_streamed(tmp_path, **change)
    with malformed(said):
        ds.read_gaussians(tmp_path)


def test_a_missing_chunk_is_told(tmp_path):
    write_streamed(tmp_path)
    (tmp_path / "0_1/meta.json").unlink()
    with malformed(r"meta\.json"):
        ds.read_gaussians(tmp_path)


@pytest.mark.slow
@given(st.data())
def test_damaged_indices_are_refused_or_read(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    write_streamed(folder)
    content = bytearray((folder / LOD_META).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (folder / LOD_META).write_bytes(content)
    with contextlib.suppress(DrSplatError):
        ds.read_gaussians(folder)
