"""Scenes whose opacities are of splats before they are widened: the mark is read, kept, written, and obeyed."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from command_line import answer_of, text_of
from drsplat.authoring.editing.edits import Edit, edited
from drsplat.authoring.editing.replacement import Replace
from drsplat.authoring.editing.targets import Rows
from drsplat.errors import DrSplatWarning
from drsplat.field.evidence.columns import StillScenery
from drsplat.field.tiles.cutting import cut
from drsplat.field.tiles.seeing import Gallery
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.known import parse_gaussians
from drsplat.formats.moving_scenes import read_motion, read_ply_sequence, write_motion, write_ply_sequence
from drsplat.formats.scenes import read_gaussians
from drsplat.formats.sources import blocks_of
from drsplat.formats.tiles import read_tiles
from drsplat.fronts.viewing.bare import open_bare
from drsplat.fronts.viewing.session import Session
from drsplat.fronts.viewing.shown import moved_shown, shown_of
from drsplat.fronts.viewing.stage import Stage
from drsplat.kernels import splat_arrays, view_weights
from drsplat.scene.gaussians import Gaussians, concatenated
from drsplat.scene.moving import Frames, Moving
from drsplat.scene.similarity import similarity_of
from refusing import malformed, refused
from scene_files import commented, compressed_ply_bytes, ply_bytes, ply_columns, sog_files, spz_bytes, zip_bytes
from scenes import look_at_view, random_gaussians

MIP = b"comment SplatRenderMode: mip"


def marked(count: int = 40, seed: int = 0) -> Gaussians:
    return replace(random_gaussians(count, seed), antialiased=True)


# --- the mark in files ---


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ((), False),
        (("SplatRenderMode: mip",), True),
        (("SplatRenderMode: default",), False),
        (("SplatRenderMode: 2dgs",), False),
        (("SplatRenderMode: banana",), False),
        (("antialiased 1",), True),
        (("antialiased 0",), False),
        (("  SPLATRENDERMODE:   MIP ",), True),
        (("Exported from Brush", "SplatRenderMode: mip", "SH degree: 3"), True),
        (("antialiased 1", "SplatRenderMode: default"), False),
        (("SplatRenderMode: default", "antialiased 1"), True),
        (("not antialiased 1", "we love SplatRenderMode: mip"), False),
    ],
)
@pytest.mark.parametrize("kind", ["ply", "compressed"])
def test_the_last_comment_that_says_so_decides(kind, comments, expected):
    scene = random_gaussians(8)
    content = ply_bytes(ply_columns(scene)) if kind == "ply" else compressed_ply_bytes(scene)
    assert parse_gaussians(memoryview(commented(content, *comments))).antialiased == expected


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("flags", [0, 1])
def test_spz_says_it_with_a_bit(version, flags):
    pytest.importorskip("zstandard")
    assert parse_gaussians(memoryview(spz_bytes(random_gaussians(8), version, flags))).antialiased == bool(flags)


@pytest.mark.parametrize(("model", "expected"), [(None, False), ("antialiased", True), ("2dgs", False), (1, False)])
def test_sog_says_it_as_its_model(model, expected):
    files = sog_files(random_gaussians(8))
    meta = json.loads(files["meta.json"]) | ({} if model is None else {"model": model})
    files["meta.json"] = json.dumps(meta).encode()
    assert parse_gaussians(memoryview(zip_bytes(files))).antialiased == expected


@pytest.mark.parametrize("is_edited", [False, True])
def test_a_written_ply_says_it_as_brush_does_and_only_where_it_is_so(tmp_path, is_edited):
    for scene, name in ((marked(), "mip.ply"), (random_gaussians(40), "plain.ply")):
        write_gaussians(tmp_path / name, scene, is_edited=is_edited)
        back = read_gaussians(tmp_path / name)
        assert (back.antialiased, back.fingerprint) == (scene.antialiased, scene.fingerprint)
    mip, plain = ((tmp_path / name).read_bytes() for name in ("mip.ply", "plain.ply"))
    assert mip.replace(MIP + b"\n", b"") == plain
    assert mip.split(b"\n")[2] == b"element vertex 40"  # where viewers of 3DGS look for the count


# --- who they are ---


def test_only_antialiased_scenes_have_another_fingerprint():
    scene = random_gaussians(40)
    positions = hashlib.blake2b(scene.means.tobytes(), digest_size=12).hexdigest()
    assert scene.fingerprint == f"40-{positions}"
    assert marked().fingerprint != scene.fingerprint


def test_columns_that_are_kept_of_one_kind_are_not_taken_for_the_other():
    view = look_at_view((0, -6, 1), width=32, height=24)
    assert StillScenery(random_gaussians(40)).digest(view) != StillScenery(marked()).digest(view)


def test_parts_and_sums_of_parts_keep_it():
    scene = marked()
    assert scene.subset(np.arange(5)).antialiased
    assert scene.localized().antialiased
    assert concatenated([scene, marked(seed=1)]).antialiased
    assert similarity_of(np.diag([2.0, 2.0, 2.0, 1.0])).moved(scene).antialiased
    assert splat_arrays(scene).subset(np.arange(5)).antialiased
    with refused("1 of 2 parts are drawn antialiased"):
        concatenated([scene, random_gaussians(3)])


# --- tiles ---


def test_tiles_keep_it_and_are_seen_as_the_whole(tmp_path):
    write_gaussians(tmp_path / "scene.ply", marked(2000))
    tiles = cut(blocks_of([tmp_path / "scene.ply"]), tmp_path / "tiles", rows=300)
    whole, view = read_gaussians(tmp_path / "tiles"), look_at_view((0, -6, 1), width=96, height=64)
    assert read_tiles(tmp_path / "tiles").antialiased
    assert whole.antialiased
    assert whole.fingerprint == tiles.fingerprint
    assert Gallery(tiles).digest(view) == StillScenery(whole).digest(view)
    seen, masks = Gallery(tiles).visible_splats(view), np.zeros((64, 96), np.int32)
    weights = view_weights(splat_arrays(whole), view, masks)
    assert_array_equal(view_weights(seen.splats, view, masks).weights, weights.weights)
    plain = view_weights(splat_arrays(replace(whole, antialiased=False)), view, masks)
    assert weights.weights.sum() < plain.weights.sum()


def test_manifests_of_other_tiles_are_as_they_were(tmp_path):
    write_gaussians(tmp_path / "scene.ply", random_gaussians(40))
    cut(blocks_of([tmp_path / "scene.ply"]), tmp_path / "tiles")
    assert "antialiased" not in json.loads((tmp_path / "tiles" / "tiles.json").read_text())


@pytest.mark.parametrize("rows", [10, 1000])
def test_blocks_of_both_kinds_make_no_tiles(tmp_path, rows):
    write_gaussians(tmp_path / "a.ply", marked(20))
    write_gaussians(tmp_path / "b.ply", replace(random_gaussians(20, 1), means=random_gaussians(20, 1).means + 90))
    with refused("are drawn antialiased"):
        cut(blocks_of([tmp_path / "a.ply", tmp_path / "b.ply"]), tmp_path / "tiles", rows)
    assert not (tmp_path / "tiles").exists()


# --- scenes that move ---


def film(scene: Gaussians) -> Moving:
    times = np.array([0.0, 1.0])
    return Moving(scene, times, Frames(times, lambda number: replace(scene, means=scene.means + np.float32(number))))


def test_films_keep_it_at_all_times(tmp_path):
    write_motion(tmp_path / "film.motion", film(marked()))
    write_ply_sequence(tmp_path / "frames", film(marked()))
    for moving in (read_motion(tmp_path / "film.motion"), read_ply_sequence(tmp_path / "frames")):
        assert moving.canonical.antialiased
        assert all(moving.at(time).antialiased for time in (0.0, 0.5, 1.0))


def test_frames_of_both_kinds_are_refused(tmp_path):
    write_ply_sequence(tmp_path / "frames", film(marked()))
    last = tmp_path / "frames" / "frame0001.ply"
    last.write_bytes(last.read_bytes().replace(MIP, MIP.replace(b"mip", b"default")))
    with malformed("antialiased False"):
        read_ply_sequence(tmp_path / "frames").at(1.0)


# --- edits ---


def replaced(scene: Gaussians, other: Gaussians) -> Gaussians:
    change = Replace("other.ply", other.fingerprint, np.eye(4))
    return edited(scene, [Edit(Rows.of(np.arange(3)), change)], read=lambda _: other)


def test_edits_keep_it_and_tell_of_what_was_trained_otherwise(recwarn):
    assert replaced(marked(), marked(seed=1)).antialiased
    assert not recwarn.list
    with pytest.warns(DrSplatWarning, match="too solid or too faint from afar"):
        assert replaced(marked(), random_gaussians(5)).antialiased
    with pytest.warns(DrSplatWarning, match="comes was trained to be drawn antialiased"):
        assert not replaced(random_gaussians(5), marked()).antialiased


# --- what people are told ---


@pytest.mark.parametrize("antialiased", [True, False])
def test_inspect_says_it(tmp_path, capsys, antialiased):
    path = tmp_path / "scene.ply"
    write_gaussians(path, replace(random_gaussians(40), antialiased=antialiased))
    assert answer_of(capsys, "inspect", path)["antialiased"] is antialiased
    line = next(line for line in text_of(capsys, "inspect", path).splitlines() if line.startswith("antialiased"))
    assert line.split()[1] == ("yes" if antialiased else "no")


def test_a_page_to_send_dims_what_it_shows(tmp_path):
    first = shown_of(marked(), 20)
    assert first.antialiased
    assert moved_shown(first, marked()).antialiased
    for gaussians, said in ((marked(), True), (random_gaussians(40), False)):
        write_gaussians(tmp_path / "scene.ply", gaussians, overwrite=True)
        stage = Stage.of(Session(open_bare(tmp_path / "scene.ply")))
        assert stage.look_document()["antialiased"] is said
