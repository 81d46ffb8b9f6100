"""Objects of scenes in blocks: cut anywhere, by anybody, in any order of rows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array
from test_objects_found import registered

import drsplat as ds
from command_line import answer_of, error_of
from drsplat.base.working import HERE
from drsplat.cli import main
from drsplat.field.objects import finding
from drsplat.field.objects.block_nodes import BlockNodes, in_blocks
from drsplat.field.objects.finding import Division
from drsplat.field.objects.uniting import fits_of, united
from drsplat.field.tiles import finding as in_tiles
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.launching import OneProcess, Processes
from drsplat.formats.sources import blocks_of
from drsplat.formats.tiles import Tiles, read_tiles


def row_of_things(count: int = 6, each: int = 150, seed: int = 0) -> tuple[ds.Gaussians, ds.LanguageField]:
    """Things along a line, and a plank under all of them, each with a mask in every view."""
    rng = default_rng(seed)
    things = rng.normal(0, 0.08, (count * each, 3)) + np.repeat(np.arange(count), each)[:, None] * [0.7, 0, 0]
    plank = rng.random((count * each, 3)) * [0.7 * count, 0.6, 0.02] - [0.35, 0.3, 0.5]
    owner = np.append(np.repeat(np.arange(count), each), np.full(count * each, count))
    return registered(5, owner, np.concatenate([things, plank]), count + 1)


@pytest.fixture
def small_blocks(monkeypatch) -> None:
    """Of three thousand weights each; three or four for a row of things."""
    monkeypatch.setattr(finding, "MAX_WEIGHTS", 0)
    monkeypatch.setattr(finding, "WEIGHTS_PER_ROW", 1000)
    monkeypatch.setattr("drsplat.field.objects.finding.BLOCK_WEIGHTS", 3000)


def divided(scene: ds.Gaussians, field: ds.LanguageField) -> Division:
    assert field.evidence is not None
    return finding.divided(field.evidence, scene.means[field.gaussian_ids])


@given(st.integers(0, 10_000), st.integers(1, 300), st.integers(20, 400))
def test_each_point_is_in_one_block_however_they_are_ordered(seed, count, most):
    rng = default_rng(seed)
    points, counts = rng.integers(0, 9, (count, 3)).astype(np.float32), rng.integers(0, 20, count)
    blocks = in_blocks(points, counts, most)
    inside = np.array([block.away(points) == 0 for block in blocks])
    assert (inside.sum(axis=0) == 1).all()
    for block, own in zip(blocks, inside, strict=True):
        assert counts[own].sum() <= most or len(np.unique(points[own], axis=0)) < count
        assert (block.away(points[own]) == 0).all()
    order = rng.permutation(count)
    for block, again in zip(blocks, in_blocks(points[order], counts[order], most), strict=True):
        assert_array_equal(block.low, again.low)
        assert_array_equal(block.high, again.high)


def test_points_of_one_place_are_one_block():
    assert len(in_blocks(np.ones((50, 3), np.float32), np.full(50, 9), 10)) == 1
    assert len(in_blocks(np.empty((0, 3), np.float32), np.empty(0, np.int64), 10)) == 1


def test_a_plank_across_blocks_is_one_object_and_what_lies_on_it_others(small_blocks):
    scene, field = row_of_things()
    assert len(divided(scene, field).blocks) > 2
    objects = finding.find_objects(field, scene)
    numbers = objects.thing_of()
    assert len(objects) == 7
    owner = np.append(np.repeat(np.arange(6), 150), np.full(900, 6))[field.gaussian_ids]
    for thing in range(7):
        own = numbers[owner == thing]
        assert (own == np.bincount(own[own >= 0]).argmax()).mean() > 0.97
    assert len({int(np.bincount(numbers[(owner == k) & (numbers >= 0)]).argmax()) for k in range(7)}) == 7


def test_one_block_has_the_forest_of_the_whole(monkeypatch):
    scene, field = row_of_things(seed=1)
    whole = finding.find_objects(field, scene)
    monkeypatch.setattr(finding, "MAX_WEIGHTS", 0)
    monkeypatch.setattr(finding, "WEIGHTS_PER_ROW", 1000)
    assert len(divided(scene, field).blocks) == 1
    found = finding.find_objects(field, scene)
    assert_array_equal(found.thing_of(), whole.thing_of())
    assert_allclose(np.sort(found.sure), np.sort(whole.sure), atol=1e-6)


def test_the_order_of_rows_changes_nothing(small_blocks):
    scene, field = row_of_things(seed=2)
    evidence, points = field.evidence, scene.means[field.gaussian_ids]
    order = default_rng(3).permutation(len(evidence))
    one, other = finding.tree_of(evidence, points), finding.tree_of(evidence.rows(order), points[order])
    assert_array_equal(one.tree.node_of[order], other.tree.node_of)
    assert_array_equal(one.tree.parents, other.tree.parents)
    assert_array_equal(one.tree.sure, other.tree.sure)


def test_fits_are_those_of_the_forest():
    """Of nodes of a block that is all of the scene: the sums of their rows have the fit that the kernel found."""
    scene, field = row_of_things(seed=4)
    division = divided(scene, field)
    held = HERE(division.nodes, division.blocks, "")
    (nodes,) = (BlockNodes(**one.arrays) for one in held)
    assert field.evidence is not None
    forest = united(held, division.blocks, division.masses).forest
    place = np.zeros((len(nodes.parents), len(field.evidence)), np.float32)
    for row, node in zip(nodes.rows, nodes.lowest.tolist(), strict=True):
        while node >= 0:
            place[node, row] = 1
            node = int(nodes.parents[node])
    sums = csr_array(csr_array(place) @ field.evidence.weights)
    assert_allclose(fits_of(sums, division.masses), nodes.fits, atol=2e-6)
    assert_array_equal(forest.sizes, place.sum(axis=1))


def test_what_blocks_cut_off_is_judged_by_all_of_its_rows(small_blocks):
    scene, field = row_of_things(seed=5)
    division = divided(scene, field)
    parts = HERE(division.nodes, division.blocks, "")
    assert any(part.arrays["cut"].any() for part in parts)  # the plank
    found = united(parts, division.blocks, division.masses)
    largest = int(found.forest.sizes.argmax())
    assert found.forest.sizes[largest] > 850
    assert found.forest.fits[largest] > 0.95
    assert found.forest.fits.max() <= 1


# --- tiles --------------------------------------------------------------------------------------------


def in_tiles_of(folder: Path, seed: int = 0) -> tuple[Tiles, ds.LanguageField]:
    """The row of things in tiles, and its field, whose rows are in their order."""
    scene, field = row_of_things(seed=seed)
    ds.write_gaussians(folder / "scene.ply", scene)
    tiles = cut(blocks_of([folder / "scene.ply"]), folder / "scene.tiles", 250)
    order = np.concatenate([tiles.gaussians().extra["source_row"]]).astype(np.int64)
    whole = field.evidence.rows(order)
    made = ds.Registration(whole, tiles.fingerprint, field.encoder).to_field()
    return tiles, made


def looking(scene: Tiles) -> list[ds.View]:
    from scenes import look_at_view

    return [
        replace(look_at_view((x, -4.0, 1.0), (x, 0.0, -0.3), width=96, height=64), name=f"{x}.jpg")
        for x in (0.5, 1.5, 2.5, 3.5)
    ]


@pytest.mark.parametrize(
    "launcher", [OneProcess(), pytest.param(Processes(2), marks=pytest.mark.slow)], ids=["here", "processes"]
)
def test_objects_of_tiles_are_those_of_the_whole(tmp_path, small_blocks, launcher):
    tiles, field = in_tiles_of(tmp_path)
    views = looking(tiles)
    seen = replace(field.evidence.masks, view_names=(*(view.name for view in views), "other.jpg"))
    field = replace(field, evidence=replace(field.evidence, masks=seen))
    whole = finding.find_objects(field, tiles.gaussians(), views=views)
    how = {"parts": str(tmp_path / "parts"), "views": views, "launcher": launcher, "threads": 1}
    found = in_tiles.find_objects(field, tiles, **how)
    for name, array in whole.tensors().items():
        assert_array_equal(array, found.tensors()[name])
    files = {file: file.stat().st_mtime_ns for file in (tmp_path / "parts").rglob("*.safetensors")}
    assert sum(".bordering." in file.name for file in files) == 4
    assert sum(".nodes." in file.name for file in files) > 2
    assert {"sharing", "growing", "summing", "describing"} <= {file.name.split(".")[1] for file in files}
    damaged = next(file for file in files if ".nodes." in file.name)
    damaged.write_bytes(damaged.read_bytes()[:-9])
    in_tiles.find_objects(field, tiles, **how)
    made = {file for file, before in files.items() if file.stat().st_mtime_ns != before}
    assert made == {damaged}  # nothing else is done again


def test_a_killed_worker_costs_its_block_alone(tmp_path, small_blocks):
    """Cut off while it writes: what it left is no file of a block, and the others stay."""
    tiles, field = in_tiles_of(tmp_path, seed=1)
    how = {"parts": str(tmp_path / "parts"), "views": [], "threads": 1}
    launcher = Stopped(2)
    with pytest.raises(KeyboardInterrupt):
        in_tiles.find_objects(field, tiles, **how, launcher=launcher)
    done = {file: file.stat().st_mtime_ns for file in (tmp_path / "parts").rglob("*.nodes.safetensors")}
    assert len(done) == 2
    found = in_tiles.find_objects(field, tiles, **how)
    assert all(file.stat().st_mtime_ns == before for file, before in done.items())
    assert_array_equal(found.node_of, finding.find_objects(field, tiles.gaussians(), views=[]).node_of)


class Stopped(OneProcess):
    """Work that ends after some tasks."""

    def __init__(self, most: int) -> None:
        self.most = most

    def results(self, work, items):
        for number in range(len(items)):
            if number == self.most:
                raise KeyboardInterrupt
            yield work(items[number])


def test_labels_stay_when_objects_are_found_by_workers(tmp_path, capsys):
    _, field = in_tiles_of(tmp_path)
    field.save(tmp_path / "s.field")
    command = ["objects", str(tmp_path / "s.field"), "--scene", str(tmp_path / "scene.tiles")]
    first = answer_of(capsys, *command)["objects"]
    assert len(first) == 7
    assert main([*command, "--label", "my plank", "--id", "0"]) == 0
    capsys.readouterr()
    again = answer_of(capsys, *command, "--again", "--workers", "2", "--threads", "1")["objects"]
    assert [one["label"] for one in again] == ["my plank", *[None] * 6]
    assert [one["num_gaussians"] for one in again] == [one["num_gaussians"] for one in first]
    assert not (tmp_path / "s.field.parts").exists()
    ds.write_gaussians(tmp_path / "plain.ply", read_tiles(tmp_path / "scene.tiles").gaussians())
    command[3] = str(tmp_path / "plain.ply")
    assert "drsplat tile" in error_of(capsys, *command, "--again", "--workers", "2")
