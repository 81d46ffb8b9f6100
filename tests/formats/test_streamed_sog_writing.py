"""Streamed SOG that we write: a tree whose leaves are the scene at several levels, in chunks that hold nothing else."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

import drsplat as ds
from command_line import answer_of, error_of
from drsplat.authoring.editing import Edit, EditFile, Remove, Rows
from drsplat.authoring.exporting import export
from drsplat.errors import FormatError
from drsplat.field.tiles.cutting import cut
from drsplat.formats.sog import read_unpacked_sog
from drsplat.formats.sources import Block, sources_of
from drsplat.formats.streamed_sog import (
    LEVEL_RATIO,
    LEVELS,
    LOD_META,
    counts_of_levels,
    read_streamed_labels,
    read_streamed_sog,
    write_streamed_sog,
)
from drsplat.formats.tiles import Tiles
from drsplat.scene.gaussians import Gaussians
from drsplat.scene.labelled import LabelledScene
from labelled_scenes import labelled
from mutations import quota, seeded, survivors
from refusing import malformed, refused

COUNT, LEAF, CHUNK = 300, 40, 90


def scene_of(count: int = COUNT, degree: int = 1) -> LabelledScene:
    scene = labelled(count, degree, ('<b>mug</b> & "jug"', "🫖 théière", "../../etc/passwd"))
    return replace(scene, gaussians=replace(scene.gaussians, origin=np.zeros(3)))


def written(folder: Path, scene: LabelledScene | Tiles) -> Path:
    path = folder / "out" / LOD_META
    write_streamed_sog(path, scene, leaf_rows=LEAF, chunk_rows=CHUNK)
    return path


def leaves_of(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    assert ("lods" in node) != ("children" in node)
    if "lods" in node:
        yield node
    children = node.get("children", [])
    assert len(children) in (0, 2)
    for child in children:
        for end, is_within in (("min", np.greater_equal), ("max", np.less_equal)):
            assert is_within(child["bound"][end], node["bound"][end]).all()
        yield from leaves_of(child)


def document_of(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def chunk(path: Path, number: int) -> Gaussians:
    return read_unpacked_sog(path.parent / document_of(path)["filenames"][number])


def test_the_finest_level_is_the_scene_with_its_objects(tmp_path):
    scene = scene_of()
    read = ds.read_gaussians(written(tmp_path, scene))
    apart, rows = cKDTree(scene.gaussians.means).query(read.means)
    assert apart.max() < 1e-3
    assert_array_equal(np.sort(rows), np.arange(COUNT))
    assert_array_equal(read.extra["object_id"], scene.object_numbers[rows])
    assert_allclose(read.extra["relevancy"], scene.relevancy[rows], atol=1 / 65535)
    assert_allclose(read.opacities, scene.gaussians.opacities[rows], atol=0.5 / 255 + 1e-6)


def test_names_lie_beside_once(tmp_path):
    path = written(tmp_path, scene_of())
    labels = read_streamed_labels(path)
    assert [(one.number, one.name) for one in labels.things] == [(one.number, one.name) for one in scene_of().things]
    assert labels.query == "red mug"
    assert [file.parent for file in path.parent.rglob("drsplat_labels.json")] == [path.parent]


def test_chunks_are_the_runs_of_the_leaves_and_nothing_else(tmp_path):
    """Each run has its rows in one chunk of its level; together they are the chunk, none of which is overfull."""
    path = written(tmp_path, scene_of())
    document = document_of(path)
    leaves = list(leaves_of(document["tree"]))
    runs = [(int(level), run) for leaf in leaves for level, run in leaf["lods"].items()]
    assert len(leaves) == -(-COUNT // LEAF)
    for number, name in enumerate(document["filenames"]):
        own = [(level, run) for level, run in runs if run["file"] == number]
        assert {level for level, _ in own} == {int(name.split("_")[0])}
        ends = [run["offset"] + run["count"] for _, run in own]
        assert [run["offset"] for _, run in own] == [0, *ends[:-1]]
        assert ends[-1] == len(chunk(path, number)) < CHUNK + LEAF
    assert len(document["filenames"]) == len({run["file"] for _, run in runs}) > LEVELS
    sums = [sum(run["count"] for level, run in runs if level == wanted) for wanted in range(LEVELS)]
    assert document["counts"] == counts_of_levels(path) == sums
    assert document["count"] == sum(sums)
    assert document["lodLevels"] == LEVELS


def test_levels_are_coarser_and_in_the_boxes(tmp_path):
    path = written(tmp_path, scene_of())
    for leaf in leaves_of(document_of(path)["tree"]):
        low, high = (np.array(leaf["bound"][end]) for end in ("min", "max"))
        parts = []
        for run in leaf["lods"].values():
            whole = chunk(path, run["file"])
            parts.append(whole.subset(np.arange(run["offset"], run["offset"] + run["count"])))
        for part in parts:
            reach = 2.9 * np.sqrt(part.covariances()[:, [0, 3, 5]])  # scales are rounded
            assert (part.means - reach >= low - 1e-3).all()
            assert (part.means + reach <= high + 1e-3).all()
            assert set(part.extra["object_id"]) == set(parts[0].extra["object_id"])  # none is merged with another
        for fine, coarse in pairwise(parts):
            few = max(1, len(fine) // LEVEL_RATIO, len(set(fine.extra["object_id"])))
            assert len(coarse) <= max(few, len(fine) // 2)


def test_without_objects_levels_have_a_quarter_each(tmp_path):
    path = written(tmp_path, LabelledScene(scene_of(256).gaussians))
    assert counts_of_levels(path)[0] == 256
    for leaf in leaves_of(document_of(path)["tree"]):
        counts = [leaf["lods"][str(level)]["count"] for level in range(LEVELS)]
        assert counts == [counts[0], *(max(1, counts[0] // LEVEL_RATIO**level) for level in (1, 2, 3))]
    assert not list(path.parent.glob("drsplat*"))
    assert read_streamed_labels(path).things == ()


def test_tiles_are_written_without_the_whole_scene(tmp_path, monkeypatch, capsys):
    gaussians = scene_of().gaussians
    ds.write_gaussians(tmp_path / "scene.ply", gaussians)
    cut([Block(source) for source in sources_of(tmp_path / "scene.ply")], tmp_path / "city.tiles", 100)

    def refused(_):
        raise AssertionError("the whole scene was loaded")

    monkeypatch.setattr(Tiles, "gaussians", refused)
    answer = answer_of(capsys, "export", tmp_path / "city.tiles", "--output", tmp_path / "out" / LOD_META)
    assert answer["num_gaussians"] == COUNT
    assert answer["format"] == LOD_META
    assert answer["bytes"] == sum(file.stat().st_size for file in (tmp_path / "out").rglob("*") if file.is_file())
    read = read_streamed_sog(tmp_path / "out" / LOD_META)
    assert len(read) == COUNT
    assert cKDTree(gaussians.means).query(read.means)[0].max() < 1e-3


def test_a_scene_far_from_zero_keeps_its_place(tmp_path):
    own = replace(scene_of().gaussians, origin=np.array([5e5, 4e6, 100.0]))
    read = read_streamed_sog(written(tmp_path, LabelledScene(own)), 0)
    local = cKDTree(own.means.astype(np.float64))
    assert local.query(read.positions - own.origin)[0].max() < 1e-3


@pytest.mark.parametrize("count", [1, 2, LEAF, LEAF + 1])
def test_small_scenes_have_a_tree(count, tmp_path):
    path = written(tmp_path, LabelledScene(scene_of(count, 0).gaussians))
    assert counts_of_levels(path)[0] == count
    assert len(read_streamed_sog(path, LEVELS - 1)) == sum(1 for _ in leaves_of(document_of(path)["tree"]))


def test_the_same_bytes_twice(tmp_path):
    folders = [tmp_path / name for name in "ab"]
    files = []
    for folder in folders:
        folder.mkdir()
        out = written(folder, scene_of()).parent
        files.append({path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()})
    assert files[0] == files[1]


def test_export_and_inspect_by_the_verb(tmp_path, capsys):
    ds.write_gaussians(tmp_path / "scene.ply", scene_of().gaussians)
    out = tmp_path / "out" / LOD_META
    answer_of(capsys, "export", tmp_path / "scene.ply", "--output", out)
    for place in (out, out.parent):
        facts = answer_of(capsys, "inspect", place)
        assert facts["kind"] == "scene"
        assert facts["num_gaussians_of_levels"][0] == facts["num_gaussians"] == COUNT
    assert "exists already: pass --overwrite" in error_of(capsys, "export", tmp_path / "scene.ply", "--output", out)
    answer_of(capsys, "export", tmp_path / "scene.ply", "--output", out, "--overwrite")
    lost = error_of(capsys, "export", tmp_path / "scene.ply", "--output", tmp_path / "no" / "where" / LOD_META)
    assert "there is no folder" in lost
    (tmp_path / "mine").mkdir()
    theirs = tmp_path / "mine" / LOD_META
    refused = error_of(capsys, "export", tmp_path / "scene.ply", "--output", theirs, "--overwrite")
    assert "not ours to replace" in refused


def test_names_are_inspected(tmp_path, capsys):
    export(tmp_path / "out" / LOD_META, scene_of())
    for place in (tmp_path / "out", tmp_path / "out" / LOD_META):
        facts = answer_of(capsys, "inspect", place)
        assert [one["id"] for one in facts["objects"]] == [0, 2, 4]


def test_a_level_that_is_not_there_is_refused(tmp_path):
    path = written(tmp_path, scene_of())
    with malformed("no chunk of level 4"):
        read_streamed_sog(path, LEVELS)


def test_what_cannot_be_written_is_refused(tmp_path):
    scene = scene_of(5)
    with refused("no Gaussians to write"):
        written(tmp_path, LabelledScene(scene.gaussians.subset(np.zeros(0, int))))
    scene.gaussians.means[3] = np.nan
    with refused("row 3"):
        written(tmp_path, scene)
    assert not (tmp_path / "out").exists()


def test_damaged_indices_and_names_are_refused_or_read(tmp_path):
    path, rng = written(tmp_path, scene_of(60)), seeded(41)
    for name in (LOD_META, "drsplat_labels.json"):
        for read in (read_streamed_labels, counts_of_levels):
            survivors(path.parent / name, lambda _, read=read: read(path), rng, quota(100))


@pytest.mark.parametrize("name", ["../secret.json", "/etc/passwd", "", 3])
def test_names_elsewhere_are_refused(name, tmp_path):
    path = written(tmp_path, scene_of(60))
    path.write_text(json.dumps(document_of(path) | {"drsplat": {"labels": name}}))
    with pytest.raises(FormatError):
        read_streamed_labels(path)


def test_tiles_with_kept_edits_are_written_as_edited(tmp_path, capsys):
    ds.write_gaussians(tmp_path / "scene.ply", scene_of().gaussians)
    tiles = cut([Block(source) for source in sources_of(tmp_path / "scene.ply")], tmp_path / "city.tiles", 100)
    edit = Edit(Rows.of(np.arange(50), "query", "some"), Remove())
    EditFile.beside(tmp_path / "city.tiles").change(tiles.gaussians(), lambda edits: edits.with_edit(edit))
    for number, more in enumerate([[], ["--edits", "none"]]):
        out = tmp_path / str(number)
        answer = answer_of(capsys, "export", tmp_path / "city.tiles", "--output", out / LOD_META, *more)
        assert len(read_streamed_sog(out / LOD_META)) == answer["num_gaussians"] == COUNT - 50 * (number == 0)
