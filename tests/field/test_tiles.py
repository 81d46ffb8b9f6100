"""Scenes in tiles: what a camera may see, the same bits as the whole, by any workers and after any kill."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import drsplat as ds
from command_line import answer_of, error_of
from drsplat.cli import main
from drsplat.errors import FormatError, InputError
from drsplat.field.codes import Smaller
from drsplat.field.evidence.aggregation import Aggregator
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.launching import OneProcess, Processes
from drsplat.field.tiles.registering import Work, register_tiles
from drsplat.field.tiles.seeing import Gallery, seen_tiles
from drsplat.field.tiles.store import Remote
from drsplat.formats.sources import Block, Keep, blocks_of, read_blocks, sources_of
from drsplat.formats.tiles import TILES, Tiles, read_tiles
from drsplat.kernels import splat_arrays, view_weights
from drsplat.scene.morton import morton_codes
from fields import unit_rows
from refusing import malformed, refused
from scenes import look_at_view
from toy_capture import write_toy_capture


def scattered(count: int, seed: int = 0, spread: float = 20.0, sh: int = 1) -> ds.Gaussians:
    """Gaussians of all sizes along a street, some of them huge, some hardly there."""
    rng = default_rng(seed)
    quats = rng.normal(size=(count, 4))
    columns = (
        rng.normal(size=(count, 3)) * [spread, spread / 10, 1],
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.exp(rng.normal(-3, 1.2, (count, 3))),
        rng.uniform(0, 1, count) ** 2,
        rng.normal(size=(count, sh, 3)) * 0.3,
    )
    return ds.Gaussians(*(column.astype(np.float32) for column in columns))


def tiled(gaussians: ds.Gaussians, folder: Path, rows: int = 50) -> Tiles:
    ds.write_gaussians(folder / "scene.ply", gaussians)
    return cut(blocks_of([folder / "scene.ply"]), folder / "scene.tiles", rows)


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    folder = write_toy_capture(tmp_path_factory.mktemp("toy"))
    cut(blocks_of([folder / "scene.ply"]), folder / "scene.tiles", 37)
    return folder


# --- cutting ------------------------------------------------------------------------------------------


def test_morton_codes_are_those_of_interleaved_bits():
    cells = default_rng(0).integers(0, 2**21, (50, 3))
    cells[:2] = [[0, 0, 0], [2**21 - 1] * 3]  # so that the box has whole cells
    expected = [
        sum(((int(c) >> bit) & 1) << (3 * bit + axis) for axis, c in enumerate(row) for bit in range(21))
        for row in cells
    ]
    assert morton_codes(cells.astype(np.float64)).tolist() == expected


def test_tiles_hold_each_gaussian_once_to_the_bit(tmp_path):
    whole = scattered(777)
    tiles = tiled(whole, tmp_path)
    assert (len(tiles), max(tile.num_rows for tile in tiles.tiles)) == (777, 50)
    back = ds.read_gaussians(tmp_path / "scene.tiles")
    source = ds.read_gaussians(tmp_path / "scene.ply").subset(back.extra["source_row"].astype(np.int64))
    assert_array_equal(np.sort(back.extra["source_row"]), np.arange(777))
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert_array_equal(getattr(back, name), getattr(source, name), err_msg=name)
    assert (tiles.fingerprint, tiles.near) == (back.fingerprint, back.near)


def test_tiles_far_from_zero_are_counted_from_an_origin(tmp_path):
    whole = replace(scattered(300), origin=np.array([4.5e6, 3.1e5, 0.0]))
    tiles = tiled(whole, tmp_path)
    assert tiles.origin.any()
    back = tiles.gaussians()
    assert_allclose(back.positions, whole.positions[back.extra["source_row"]], atol=5e-6, rtol=0)
    assert back.fingerprint == tiles.fingerprint


def test_neighbours_lie_in_one_tile(tmp_path):
    """The box of a tile is small: tiles of Gaussians in any order would each be as large as the scene."""
    tiles = tiled(scattered(2000), tmp_path)
    small = [np.prod(tile.high - tile.low) for tile in tiles.tiles[:40]]
    means = ds.read_gaussians(tmp_path / "scene.ply").means
    assert np.mean(small) < 0.05 * np.prod(means.max(0) - means.min(0))


def test_blocks_stand_where_their_transforms_put_them(tmp_path):
    whole = scattered(400, sh=16)
    moves = np.eye(4)
    moves[:3, :3] = 2 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # a quarter turn about z, twice as large
    moves[:3, 3] = [5, -3, 1]
    ds.write_gaussians(tmp_path / "a.ply", whole)
    ds.write_gaussians(tmp_path / "b.ply", whole)
    middle = {"low": [-1000, -1000, -1000], "high": [0, 1000, 1000]}
    blocks = [{"file": "a.ply", "keep": middle}, {"file": "b.ply", "transform": moves.tolist()}]
    (tmp_path / "blocks.json").write_text(json.dumps(blocks))
    tiles = cut(read_blocks(tmp_path / "blocks.json"), tmp_path / "t", 64)
    g = tiles.gaussians()
    of_a, of_b = g.extra["block"] == 0, g.extra["block"] == 1
    assert tiles.sources == ("a.ply", "b.ply")
    assert of_a.sum() == (whole.means[:, 0] < 0).sum()
    assert (g.positions[of_a][:, 0] < 0).all()
    rows = g.extra["source_row"][of_b].astype(np.int64)
    there = whole.means[rows] @ moves[:3, :3].T + moves[:3, 3]
    assert_allclose(g.positions[of_b], there, atol=1e-4)
    # A camera that moves along sees the same: shapes and colours have turned with it.
    view = look_at_view((0.0, -30.0, 3.0), width=60, height=40)
    turn = np.eye(4)
    turn[:3, :3] = moves[:3, :3] / 2
    turn[:3, 3] = moves[:3, 3] / 2
    moved = replace(view, cam_from_world=view.cam_from_world @ np.linalg.inv(turn))
    grown = replace(
        moved,
        cam_from_world=np.vstack([np.c_[moved.cam_from_world[:3, :3], 2 * moved.cam_from_world[:3, 3]], [0, 0, 0, 1]]),
    )
    block = g.subset(np.flatnonzero(of_b))
    before = ds.render(whole.subset(rows), view).rgb
    assert before.std() > 0.02
    assert_allclose(ds.render(block, grown).rgb, before, atol=4e-3)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ([], "a list of blocks"),
        ({"file": "a.ply"}, "a list of blocks"),
        ([{"file": 3}], "file: expected a text, got 3"),
        ([{"file": "a.ply", "rotate": 1}], "expected file, and maybe transform and keep, got 'rotate'"),
        ([{"file": "a.ply", "transform": [[1, 0], [0, 1]]}], "4 rows of 4"),
        ([{"file": "a.ply", "transform": np.diag([1.0, 2, 1, 1]).tolist()}], "scales axes apart"),
        ([{"file": "a.ply", "transform": np.diag([1.0, 1, -1, 1]).tolist()}], "determinant"),
        ([{"file": "a.ply", "keep": {"low": [0, 0, 0]}}], "keep: high: expected 3 numbers"),
        ([{"file": "a.ply", "keep": {"low": [0, 0, 0], "high": [1, 0, 1]}}], "low below high"),
    ],
)
def test_blocks_that_are_none(tmp_path, document, said):
    ds.write_gaussians(tmp_path / "a.ply", scattered(3))
    (tmp_path / "blocks.json").write_text(json.dumps(document))
    with malformed(said):
        read_blocks(tmp_path / "blocks.json")


def test_nothing_left_is_told(tmp_path):
    ds.write_gaussians(tmp_path / "a.ply", scattered(3))
    (source,) = sources_of(tmp_path / "a.ply")
    nowhere = Block(source, keep=Keep(np.full(3, 900.0), np.full(3, 901.0)))
    with refused("no Gaussian is left"):
        cut([nowhere], tmp_path / "t")
    assert not (tmp_path / "t").exists()


# --- damaged folders ----------------------------------------------------------------------------------


@pytest.mark.slow
@given(st.data())
def test_damaged_tiles_are_refused(tmp_path_factory, data):
    """But for a blank that became another one."""
    folder = tmp_path_factory.mktemp("damaged")
    path = tiled(scattered(60), folder, 25).path
    whole = ds.read_gaussians(path)
    file = path / data.draw(st.sampled_from(sorted(os.listdir(path))))
    content = bytearray(file.read_bytes())
    if data.draw(st.booleans()):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] ^= data.draw(st.integers(1, 255))
    else:
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    file.write_bytes(content)
    try:
        read = ds.read_gaussians(path)
    except (FormatError, InputError):
        return
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert_array_equal(getattr(read, name), getattr(whole, name))


def test_a_missing_tile_is_told(tmp_path):
    path = tiled(scattered(60), tmp_path, 25).path
    (path / "tile00001.shapes.safetensors").unlink()
    with malformed(r"tile00001.*cut the scene anew"):
        ds.read_gaussians(path)


@pytest.mark.parametrize("change", [{"tiles": []}, {"tiles": [3]}, {"version": 2}, {"near": "close"}, {"sources": 1}])
def test_manifests_that_are_none(tmp_path, change):
    from drsplat.formats.tensors import sealed

    path = tiled(scattered(20), tmp_path).path
    document = json.loads((path / TILES).read_text())
    (path / TILES).write_text(json.dumps(sealed({**document, **change})))
    with pytest.raises(FormatError):
        read_tiles(path)


# --- what a camera sees -------------------------------------------------------------------------------


@pytest.mark.slow
@given(
    seed=st.integers(0, 10**6),
    eye=st.tuples(*[st.floats(-25, 25)] * 2, st.floats(-2, 2)),
    at=st.tuples(*[st.floats(-25, 25)] * 2, st.floats(-2, 2)),
    width=st.integers(16, 90),
    focal=st.floats(10, 300),
)
def test_what_is_left_out_was_not_seen(tmp_path_factory, seed, eye, at, width, focal):
    """The weights of the tiles in front of a camera are those of the whole scene, to the bit."""
    if np.linalg.norm(np.subtract(eye, at)) < 0.1:
        return
    tiles = tiled(scattered(400, seed), tmp_path_factory.mktemp("seen"), 23)
    view = look_at_view(eye, at, width=width, height=48)
    K = np.array([[focal, 0, width / 2 + 3], [0, focal * 1.1, 20], [0, 0, 1.0]])
    view = replace(view, K=K)
    ids = (np.arange(width * 48).reshape(48, width) % 7).astype(np.int32)
    whole = view_weights(splat_arrays(tiles.gaussians()), view, ids)
    seen = Gallery(tiles).visible_splats(view)
    some = view_weights(seen.splats, view, ids)
    assert_array_equal(seen.rows[some.gaussian_ids], whole.gaussian_ids)
    assert_array_equal(some.weights, whole.weights)
    assert_array_equal(some.mask_ids, whole.mask_ids)


@pytest.mark.slow
def test_what_is_behind_is_not_loaded(tmp_path):
    tiles = tiled(scattered(3000), tmp_path)
    view = look_at_view((0.0, 0.0, 0.3), (30.0, 0.0, 0.0), width=64, height=48)
    seen = seen_tiles(tiles, view, tiles.near)
    assert 0.1 < seen.mean() < 0.7
    away = look_at_view((900.0, 0.0, 0.3), (1000.0, 0.0, 0.0), width=64, height=48)
    assert not seen_tiles(tiles, away, tiles.near).any()
    nothing = Gallery(tiles).visible_splats(away)
    assert len(view_weights(nothing.splats, away, np.zeros((48, 64), np.int32)).weights) == 0


def test_few_tiles_are_held(tmp_path):
    tiles = tiled(scattered(3000), tmp_path)
    gallery = Gallery(tiles, held_bytes=4 * 50 * 40)
    view = look_at_view((0.0, -40.0, 3.0), width=64, height=48)
    first, again = gallery.visible_splats(view), gallery.visible_splats(view)
    assert 0 < gallery._bytes() <= 4 * 50 * 40 < 40 * len(tiles)
    assert_array_equal(first.splats.means, again.splats.means)


# --- registration -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tiles(toy) -> Tiles:
    return read_tiles(toy / "scene.tiles")


def inputs(toy: Path) -> tuple[list[ds.View], ds.formats.langsplat.FeatureFolder]:
    return ds.read_views(toy / "capture"), ds.read_features(toy / "capture/language_features")


@pytest.fixture(scope="module")
def views(toy) -> list[ds.View]:
    return inputs(toy)[0]


@pytest.fixture(scope="module")
def features(toy) -> ds.formats.langsplat.FeatureFolder:
    return inputs(toy)[1]


@pytest.fixture(scope="module")
def at_once(tiles, views, features) -> ds.Registration:
    """The scene in one piece, which is what its tiles have to give, to the bit."""
    return ds.register(tiles.gaussians(), views, features)


@pytest.fixture
def parts(tmp_path) -> Path:
    return tmp_path / "parts"


def counted(*given: object, **more: object) -> tuple[ds.Registration, Work]:
    """A registration in tiles, and how much was done for it."""
    told = []
    made = register_tiles(*given, **more, tell=told.append)
    return made, told[0]


def saved(field: ds.LanguageField, path: Path) -> dict[str, bytes]:
    field.save(path)
    return {file.name: file.read_bytes() for file in sorted(path.iterdir())}


def test_masks_of_photos_leave_out_of_tiles_what_they_leave_out_of_the_whole(tmp_path, tiles, parts, views, features):
    mask = np.zeros((72, 96), np.uint8)
    mask[:, 50:] = 255
    Image.fromarray(mask).save(tmp_path / "half.png")
    Image.fromarray(0 * mask).save(tmp_path / "black.png")
    masked = [
        replace(view, mask_path=tmp_path / name)
        for view, name in zip(views[:2], ("half.png", "black.png"), strict=True)
    ]
    with pytest.warns(ds.DrSplatWarning, match="1 of 4 photos are not used"):
        made = register_tiles(tiles, masked + views[2:], features, parts=parts, threads=1)
    with pytest.warns(ds.DrSplatWarning, match="1 of 4 photos are not used"):
        whole = ds.register(tiles.gaussians(), masked + views[2:], features)
    assert len(made.masks.view_names) == 3
    assert_array_equal(made.weights.data, whole.weights.data)
    assert made.weights.nnz < ds.register(tiles.gaussians(), [views[0], *views[2:]], features).weights.nnz


@pytest.mark.slow
@pytest.mark.parametrize("launcher", [OneProcess(), Processes(2)], ids=["here", "processes"])
@pytest.mark.parametrize("code", [ds.PQ(), ds.Mixture()], ids=["pq", "mixture"])
def test_a_field_of_tiles_is_that_of_the_whole(
    tmp_path, launcher, code, monkeypatch, tiles, parts, views, features, at_once
):
    monkeypatch.setattr("drsplat.field.tiles.transposing.RUN_BYTES", 20_000)  # several runs
    made, work = counted(tiles, views, features, parts=parts, launcher=launcher, threads=1)
    assert (work.views, work.views_before, work.runs_before) == (4, 0, 0)
    assert work.runs > 1
    assert saved(made.to_field(code), tmp_path / "a.field") == saved(at_once.to_field(code), tmp_path / "b.field")
    again, work = counted(tiles, views, features, parts=parts, threads=1)
    assert (work.views, work.runs) == (0, 0)
    assert_array_equal(again.weights.data, made.weights.data)


@pytest.mark.parametrize("name", ["inliers", "trusted", "robust"])
@pytest.mark.parametrize("code", [ds.PQ(), ds.Mixture()], ids=["pq", "mixture"])
def test_features_of_tiles_are_those_of_the_whole(
    tmp_path, name, code, monkeypatch, tiles, parts, views, features, at_once
):
    """Neighbours that vote lie in other runs, and the largest Gaussians, which are spread, are a run of their own."""
    monkeypatch.setattr("drsplat.field.tiles.transposing.RUN_BYTES", 20_000)
    made = register_tiles(tiles, views, features, parts=parts, threads=1)
    monkeypatch.setattr(Aggregator, "__call__", None)  # nobody looks at all rows
    field = made.to_field(code, aggregator=name, gaussians=None, threads=1)
    monkeypatch.undo()
    whole = at_once.to_field(code, aggregator=name, gaussians=tiles.gaussians(), threads=1)
    assert saved(field, tmp_path / "a.field") == saved(whole, tmp_path / "b.field")
    before = written(tmp_path / "parts")
    assert made.to_field(code, aggregator=name).equals(field)
    assert written(tmp_path / "parts") == before  # nothing is made again


def written(folder: Path) -> dict[str, int]:
    return {str(file): file.stat().st_mtime_ns for file in folder.rglob("*.safetensors")}


def test_codes_that_are_there_are_not_made_again(monkeypatch, tiles, parts, views, features):
    monkeypatch.setattr("drsplat.field.tiles.transposing.RUN_BYTES", 20_000)
    field = register_tiles(tiles, views, features, parts=parts, threads=1).to_field(ds.Mixture())
    made = sorted((parts / "made").glob("*.mixing.safetensors"))
    before = [file.stat().st_mtime_ns for file in made]
    assert len(made) > 1
    made[0].write_bytes(b"damaged")
    again = register_tiles(tiles, views, features, parts=parts, threads=1)
    assert again.to_field(ds.Mixture()).equals(field)
    assert [file.stat().st_mtime_ns == old for file, old in zip(made, before, strict=True)] == [
        False, *[True] * (len(made) - 1)
    ]  # fmt: skip
    again.to_field(ds.Mixture(3))  # another code has files of its own
    assert len(list((parts / "made").glob("*.mixing.safetensors"))) == 2 * len(made)


@pytest.mark.slow
def test_atoms_that_cannot_be_addressed_are_left_out_of_tiles_too(monkeypatch, tiles, parts, views, features):
    monkeypatch.setattr("drsplat.field.tiles.transposing.RUN_BYTES", 20_000)
    monkeypatch.setattr("drsplat.field.codes.mixture.encoding.MAX_SCENE_ATOMS", 1)
    rng = default_rng(0)
    others = {
        name: replace(features[name], embeddings=unit_rows(rng, *features[name].embeddings.shape)) for name in features
    }
    made = register_tiles(tiles, views, others, parts=parts, threads=1)
    most = len(made.to_field(ds.Mixture()).code.atoms) - 2
    monkeypatch.setattr("drsplat.field.codes.mixture.encoding.MAX_ATOMS", most)
    whole = ds.register(tiles.gaussians(), views, others).to_field(ds.Mixture())
    assert 1 < len(whole.code.atoms) <= most
    assert made.to_field(ds.Mixture()).equals(whole)


@pytest.mark.parametrize("code", [ds.PQ(), ds.Mixture()], ids=["pq", "mixture"])
def test_other_embeddings_are_not_mixed_up_with_those_on_disk(code, tiles, parts, views, features, at_once):
    made = register_tiles(tiles, views, features, parts=parts, threads=1)
    made.to_field(code)
    other = np.roll(made.embeddings, 1, axis=0)
    swapped = [one.with_embeddings(other, one.encoder).to_field(code) for one in (made, at_once)]
    assert swapped[0].equals(swapped[1])
    fewer = [one.without(views[:1][0].name.split()).to_field(code) for one in (made, at_once)]
    assert fewer[0].equals(fewer[1])


def test_a_changed_mask_is_seen(tiles, parts, views, features):
    register_tiles(tiles, views, features, parts=parts)
    changed = {name: features[name] for name in features}
    first = next(iter(changed))
    changed[first] = replace(changed[first], mask_ids=np.maximum(changed[first].mask_ids, 0))
    made, work = counted(tiles, views, changed, parts=parts)
    assert work.views == 1
    assert work.runs_before == 0
    expected = ds.register(tiles.gaussians(), views, changed)
    assert_array_equal(made.weights.toarray(), expected.weights.toarray())


def test_a_damaged_part_is_made_again(tmp_path, tiles, parts, views, features):
    whole = register_tiles(tiles, views, features, parts=parts)
    expected = whole.weights.toarray()
    for file in [*tmp_path.glob("parts/*.columns.safetensors")][:1] + [*tmp_path.glob("parts/rows/*.rows.safetensors")][
        :1
    ]:
        file.write_bytes(file.read_bytes()[:-5])
    made, work = counted(tiles, views, features, parts=parts)
    assert (work.views, work.runs) == (1, 1)
    assert_array_equal(made.weights.toarray(), expected)


@pytest.fixture
def bucket(tmp_path, monkeypatch) -> Path:
    """The folder of an object store; what is copied from it here is beside it."""
    pytest.importorskip("fsspec", reason="needs fsspec")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    return tmp_path / "bucket"


def test_an_address_that_held_another_scene(tmp_path, bucket, tiles, views, features):
    """Of as many Gaussians in tiles of the same names."""
    whole = tiles.gaussians()
    ds.write_gaussians(tmp_path / "scene.ply", replace(whole, scales=whole.scales * np.float32(0.5)))
    second = cut(blocks_of([tmp_path / "scene.ply"]), tmp_path / "second.tiles", 37)
    for scene in (tiles, second):
        made = register_tiles(scene, views, features, parts=f"local://{bucket}", threads=1)
        expected = ds.register(scene.gaussians(), views, features)
        assert_array_equal(made.weights.toarray(), expected.weights.toarray())


def test_what_was_made_and_not_sent_is_sent(bucket, tiles, views, features):
    """Killed in between, on the machine that goes on; others need it too."""
    how = {"parts": f"local://{bucket}", "threads": 1}
    register_tiles(tiles, views, features, **how)
    there = {file.relative_to(bucket) for file in bucket.rglob("*.safetensors")}
    for name in there:
        (bucket / name).unlink()
    _, work = counted(tiles, views, features, **how)
    assert (work.views, work.runs) == (0, 0)
    assert {file.relative_to(bucket) for file in bucket.rglob("*.safetensors")} == there


def test_an_address_that_nobody_knows():
    pytest.importorskip("fsspec", reason="needs fsspec")
    with refused("nowhere"):
        Remote("nowhere://bucket").bring("a")


def _dies_once(item: Path) -> str:
    if not item.exists():
        item.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item.name


def _always_dies(item: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _fails(item: int) -> None:
    raise InputError(f"bad {item}")


@pytest.mark.slow
def test_work_of_a_killed_process_is_done_again(tmp_path):
    items = [tmp_path / str(number) for number in range(5)]
    for item in items[1:]:
        item.touch()
    assert sorted(Processes(2).results(_dies_once, items)) == ["0", "1", "2", "3", "4"]


@pytest.mark.slow
def test_work_that_kills_is_given_up():
    with pytest.raises(ds.errors.DrSplatError, match="killed 3 times"):
        list(Processes(1).results(_always_dies, [1, 2]))


@pytest.mark.slow
def test_an_error_of_a_worker_is_that_of_the_run():
    with refused("bad 1"):
        list(Processes(1).results(_fails, [1]))


# --- the command line ---------------------------------------------------------------------------------


def fields_of(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.glob("*.safetensors"))}


@pytest.mark.slow
def test_a_tiled_scene_from_the_command_line(toy, tmp_path, capsys):
    tiles, plain = tmp_path / "s.tiles", tmp_path / "s.field"
    assert answer_of(capsys, "tile", toy / "scene.ply", "-o", tiles, "--rows", "60")["num_tiles"] > 4
    features = ["--features", str(toy / "capture/language_features")]
    register = ["register", str(tiles), str(toy / "capture"), *features, "--encoder-name", "drsplat-words"]
    assert main([*register, "-o", str(plain), "--workers", "2", "--threads", "1"]) == 0
    assert main(["locate", str(plain), "red mug", "--scene", str(tiles), "--json"]) == 0
    assert not (tmp_path / "s.field.parts").exists()
    views = ds.read_views(toy / "capture")
    features = ds.read_features(toy / "capture/language_features", encoder=ds.WordEncoder.identity)
    ds.register(ds.read_gaussians(tiles), views, features).to_field(Smaller()).save(tmp_path / "t.field")
    assert fields_of(plain) == fields_of(tmp_path / "t.field")


def test_workers_are_for_tiles(toy, tmp_path, capsys):
    features = ["--features", str(toy / "capture/language_features")]
    register = ["register", str(toy / "scene.ply"), str(toy / "capture"), *features, "-o", str(tmp_path / "f")]
    assert "drsplat tile" in error_of(capsys, *register, "--workers", "2")
    register[1] = str(toy / "scene.tiles")
    assert "two ways" in error_of(capsys, *register, "--workers", "2", "--ray", "local")


@pytest.mark.slow
def test_a_killed_registration_goes_on(toy, tmp_path):
    """Killed at moments through the run; what it left is used, and the field is the same."""
    command = [sys.executable, "-m", "drsplat", "register", str(toy / "scene.tiles"), str(toy / "capture")]
    command += ["--features", str(toy / "capture/language_features"), "--threads", "1", "--output"]
    assert subprocess.run([*command, str(tmp_path / "whole.field")], check=False).returncode == 0
    for moment in np.linspace(0.3, 1.6, 5):
        run = subprocess.Popen(
            [*command, str(tmp_path / "killed.field")], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
        time.sleep(moment)
        run.kill()
        run.wait()
    if not (tmp_path / "killed.field").exists():
        assert subprocess.run([*command, str(tmp_path / "killed.field")], check=False).returncode == 0
    assert fields_of(tmp_path / "killed.field") == fields_of(tmp_path / "whole.field")
