"""Scenes of surfels (2DGS): files without a third scale, or with the mark, are read, said, and written as they came."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import drsplat as ds
from command_line import answer_of
from drsplat.authoring.exporting import export
from drsplat.field.tiles.cutting import cut
from drsplat.formats.gaussian_ply import write_gaussians
from drsplat.formats.known import parse_gaussians
from drsplat.formats.scenes import read_gaussians
from drsplat.formats.sog_writing import sog_bytes
from drsplat.formats.sources import Block, sources_of
from drsplat.formats.tiles import read_tiles
from drsplat.scene.gaussians import SURFEL_THICKNESS, Gaussians
from drsplat.scene.labelled import LabelledScene
from drsplat.scene.merging import coarser
from scene_files import commented, compressed_ply_bytes, ply_bytes, ply_columns, random_gaussians, sog_files, zip_bytes
from scenes import look_at_view

MARK = "SplatRenderMode: 2dgs"


def scene(count: int = 40, degree: int = 1) -> Gaussians:
    return random_gaussians(np.random.default_rng(0), count, degree)


def surfel_ply(order: str = "<", *comments: str) -> bytes:
    """As 2DGS writes it: the columns of 3DGS without the third scale."""
    columns = {name: column for name, column in ply_columns(scene()).items() if name != "scale_2"}
    return commented(ply_bytes(columns, order), *comments)


def assert_flat(read: Gaussians) -> None:
    assert read.surfels
    assert not read.antialiased
    assert_array_equal(read.scales[:, 2], np.full(len(read), SURFEL_THICKNESS))


@pytest.mark.parametrize("order", ["<", ">", "a"])
@pytest.mark.parametrize("comments", [(), (MARK,), ("SplatRenderMode: mip",)])
def test_a_file_without_a_third_scale_is_of_surfels(order, comments):
    """What the columns say outranks a comment."""
    read, own = parse_gaussians(memoryview(surfel_ply(order, *comments))), scene()
    assert_flat(read)
    assert_array_equal(read.means, own.means)
    assert_allclose(read.scales[:, :2], own.scales[:, :2], rtol=1e-6)
    assert_allclose(read.opacities, own.opacities, rtol=1e-5)
    assert_allclose(read.quats, own.quats, atol=1e-6)
    assert_array_equal(read.sh, own.sh)


@pytest.mark.parametrize("write", [lambda g: ply_bytes(ply_columns(g)), compressed_ply_bytes])
@pytest.mark.parametrize(
    ("comments", "expected"), [((), False), ((MARK.upper(),), True), ((MARK, "antialiased 0"), False)]
)
def test_the_last_mark_decides_where_there_is_a_third_scale(write, comments, expected):
    read = parse_gaussians(memoryview(commented(write(scene()), *comments)))
    assert read.surfels == expected


@pytest.mark.parametrize("missing", ["scale_1", "rot_3", "opacity"])
def test_a_file_that_lacks_more_is_none(missing):
    columns = {name: column for name, column in ply_columns(scene()).items() if name not in ("scale_2", missing)}
    with pytest.raises(ds.errors.FormatError, match=f"and no .*{missing}.*no 3DGS PLY"):
        parse_gaussians(memoryview(ply_bytes(columns)))


def test_it_is_written_as_it_came(tmp_path):
    """Without the column, as 2DGS reads it, and with the mark; read back to the bit."""
    (tmp_path / "a.ply").write_bytes(surfel_ply())
    first = read_gaussians(tmp_path / "a.ply")
    write_gaussians(tmp_path / "b.ply", first)
    head = (tmp_path / "b.ply").read_bytes().split(b"end_header")[0]
    assert b"comment SplatRenderMode: 2dgs\n" in head
    assert b"scale_1" in head
    assert b"scale_2" not in head
    second = read_gaussians(tmp_path / "b.ply")
    write_gaussians(tmp_path / "c.ply", second)
    third = read_gaussians(tmp_path / "c.ply")
    assert_flat(third)
    assert third.fingerprint == first.fingerprint
    assert_array_equal(third.scales, second.scales)


def test_other_scenes_are_written_as_before(tmp_path):
    write_gaussians(tmp_path / "plain.ply", scene())
    head = (tmp_path / "plain.ply").read_bytes().split(b"end_header")[0]
    assert b"scale_2" in head
    assert b"comment" not in head


def test_sog_has_it_as_its_model():
    flat = scene(300).flattened()
    data = sog_bytes(LabelledScene(flat))
    start = data.index(b'{"version"')
    assert json.JSONDecoder().raw_decode(data[start:].decode("latin-1"))[0]["model"] == "2dgs"
    assert_flat(parse_gaussians(memoryview(data)))
    files = sog_files(scene())
    files["meta.json"] = json.dumps(json.loads(files["meta.json"]) | {"model": "2dgs"}).encode()
    assert_flat(parse_gaussians(memoryview(zip_bytes(files))))


def test_tiles_and_parts_are_of_surfels(tmp_path):
    (tmp_path / "a.ply").write_bytes(surfel_ply())
    cut([Block(source) for source in sources_of(tmp_path / "a.ply")], tmp_path / "tiles", 7)
    assert_flat(read_tiles(tmp_path / "tiles").gaussians())
    assert_flat(scene().flattened().subset(np.arange(3)))


def test_what_is_merged_is_of_surfels_no_more():
    assert not coarser(scene().flattened(), 10).gaussians.surfels


@pytest.mark.parametrize(("name", "said"), [("a.ply", False), ("a.sog", False), ("a.glb", False), ("a.spz", True)])
def test_formats_that_cannot_say_so_are_told(name, said, tmp_path):
    lacks = export(tmp_path / name, scene().flattened()).lacks
    assert bool(lacks) == said
    assert all("surfels" in sentence for sentence in lacks)
    assert read_gaussians(tmp_path / name).surfels != said


def test_inspect_says_so(tmp_path, capsys):
    (tmp_path / "a.ply").write_bytes(surfel_ply())
    write_gaussians(tmp_path / "b.ply", scene())
    assert [answer_of(capsys, "inspect", tmp_path / name)["surfels"] for name in ("a.ply", "b.ply")] == [True, False]


def test_a_surfel_is_drawn_as_the_limit_of_flat_gaussians():
    view = look_at_view((0, -6, 1), width=64, height=48)
    flat = scene().flattened()
    thin = replace(flat, scales=np.column_stack([flat.scales[:, :2], np.full(len(flat), np.float32(1e-4))]))
    pictures = [ds.render(one, view).rgb for one in (flat, thin, scene())]
    assert np.isfinite(pictures[0]).all()
    assert_allclose(pictures[0], pictures[1], atol=1e-3)
    assert np.abs(pictures[0] - pictures[2]).max() > 0.02


def test_rows_that_are_none_are_counted():
    columns = {name: column.copy() for name, column in ply_columns(scene()).items() if name != "scale_2"}
    columns["scale_0"][5] = np.nan
    with pytest.raises(ds.errors.FormatError, match=r"1 of 40 rows have scales .* the first is row 5"):
        parse_gaussians(memoryview(ply_bytes(columns)))


def test_a_claimed_count_is_refused():
    lying = surfel_ply().replace(b"element vertex 40", b"element vertex %d" % 10**9)
    with pytest.raises(ds.errors.FormatError):
        parse_gaussians(memoryview(lying))
