"""3D Tiles: levels of detail of a scene on the Earth, checked against its own numbers."""

import ast
import json
import struct
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drsplat.field.tiles.cutting import cut
from drsplat.formats import tiles3d_writing
from drsplat.formats.georeference import Georeference
from drsplat.formats.glb_writing import write_glb
from drsplat.formats.known import parse_gaussians
from drsplat.formats.sources import Block, sources_of
from drsplat.formats.tiles3d_writing import write_tiles3d
from drsplat.formats.usd_writing import write_usd
from drsplat.scene.gaussians import Gaussians, rotation_matrices
from drsplat.scene.geodesy import geocentric
from drsplat.scene.labelled import LabelledScene, Thing
from glb_files import Read
from refusing import refused
from scene_files import random_gaussians

COUNT, ROWS = 300, 40
NORTH_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # of a PLY, whose y is down


def labelled(count: int = COUNT, degree: int = 1) -> LabelledScene:
    gaussians = random_gaussians(np.random.default_rng(0), count, degree)
    names = ("<b>🦊</b>", "a/b\nc")
    things = tuple(Thing(name, 0.5, np.zeros(3), np.eye(3), np.ones(3)) for name in names)
    return LabelledScene(gaussians, things=things, object_of=(np.sign(gaussians.means[:, 0]) // 1).astype(np.int32))


def document_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "tileset.json").read_text())


def tiles_of(tile: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield tile
    for child in tile.get("children", []):
        yield from tiles_of(child)


def content_of(path: Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def gaussians_of(path: Path) -> Gaussians:
    """Return a tile's Gaussians in the axes of a PLY, counted from the middle of the tileset, from its SPZ stream."""
    document, binary = content_of(path)
    view = document["bufferViews"][0]
    spz = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    gaussians = parse_gaussians(memoryview(spz), ".spz")
    offset = np.array(document["nodes"][0]["matrix"][12:15]) * [1, -1, -1]
    return replace(gaussians, means=(gaussians.positions + offset).astype(np.float32), origin=np.zeros(3))


def test_leaves_are_the_scene_and_parents_are_coarser(tmp_path):
    scene = labelled()
    write_tiles3d(tmp_path / "out", scene, rows=ROWS)
    root = document_of(tmp_path / "out")["root"]
    tiles = list(tiles_of(root))
    leaves = [tile for tile in tiles if "children" not in tile]
    assert len(leaves) == -(-COUNT // ROWS)
    means = np.concatenate([gaussians_of(tmp_path / "out" / leaf["content"]["uri"]).means for leaf in leaves])
    own = scene.gaussians.means
    middle = (own.min(0) + own.max(0)) / 2
    order, expected = np.lexsort(means.T.round(3)), own - middle
    assert_allclose(means[order], expected[np.lexsort(expected.T.round(3))], atol=2e-3)
    for tile in tiles:
        assert len(gaussians_of(tmp_path / "out" / tile["content"]["uri"])) <= ROWS
        assert (tile["geometricError"] == 0) == ("children" not in tile)
        for child in tile.get("children", []):
            assert child["geometricError"] < tile["geometricError"]


def test_boxes_hold_what_is_in_them(tmp_path):
    write_tiles3d(tmp_path / "out", labelled(), rows=ROWS)
    for tile in tiles_of(document_of(tmp_path / "out")["root"]):
        box = np.array(tile["boundingVolume"]["box"]).reshape(4, 3)
        half = np.abs(box[1:]).sum(0)
        for part in tiles_of(tile):
            means = gaussians_of(tmp_path / "out" / part["content"]["uri"]).means @ NORTH_UP.T
            assert (np.abs(means - box[0]) <= half + 1e-3).all()


def test_the_root_lies_on_the_earth(tmp_path):
    """A point of the world, through the tileset's matrix, is where the georeference says that it is."""
    scene = labelled()
    place = Georeference(8.5, 47.4, 400.0, NORTH_UP, 2.5)
    write_tiles3d(tmp_path / "out", scene, georeference=place, rows=ROWS)
    document = document_of(tmp_path / "out")
    matrix = np.array(document["root"]["transform"]).reshape(4, 4).T
    own = scene.gaussians.means.astype(np.float64)
    middle = (own.min(0) + own.max(0)) / 2
    points = np.array([[0, 0, 0], [1, -2, 3.0]])
    local = (points - middle) * 2.5 @ NORTH_UP.T
    earth = local @ matrix[:3, :3].T + matrix[:3, 3]
    assert_allclose(earth, geocentric(place.positions(points)), atol=1e-5)
    assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    leaf = next(tile for tile in tiles_of(document["root"]) if "children" not in tile)
    sizes = gaussians_of(tmp_path / "out" / leaf["content"]["uri"]).scales.max()
    assert sizes == pytest.approx(2.5 * scene.gaussians.scales.max(), rel=0.5)


def test_each_tile_has_the_objects_that_are_in_it(tmp_path):
    """Also where its Gaussians are merged of others, as those of different objects never are."""
    scene = labelled()
    write_tiles3d(tmp_path / "out", scene, rows=ROWS)
    middle = (scene.gaussians.means[:, 0].min() + scene.gaussians.means[:, 0].max()) / 2
    for tile in tiles_of(document_of(tmp_path / "out")["root"]):
        path = tmp_path / "out" / tile["content"]["uri"]
        x, read = gaussians_of(path).means[:, 0] + middle, Read.of(path.read_bytes())
        has_objects = "_FEATURE_ID_0" in read.primitive["attributes"]
        names = read.object_names() if has_objects else [None] * len(x)
        for name, where in zip(names, x, strict=True):
            assert abs(where) < 1e-2 or name == (scene.things[1].name if where > 0 else None)


def test_everything_stands_alike(tmp_path):
    """A GLB, OpenUSD and a tileset of one scene have the same heading, whatever is up in it."""
    pytest.importorskip("pxr")
    scene = replace(labelled(), up=(0.8, 0.0, 0.6))
    write_glb(tmp_path / "a.glb", scene)
    write_usd(tmp_path / "a.usda", scene)
    write_tiles3d(tmp_path / "out", scene, rows=ROWS)
    x, y, z, w = Read.of((tmp_path / "a.glb").read_bytes()).document["nodes"][0]["rotation"]
    glb = rotation_matrices(np.array([[w, x, y, z]]))[0]
    text = (tmp_path / "a.usda").read_text()
    matrix = text[text.index("matrix4d xformOp:transform = ") :].split("\n")[0].split("= ")[1]
    rows = np.array(ast.literal_eval(matrix))  # which rows of points are multiplied by
    tileset = np.array(document_of(tmp_path / "out")["root"]["transform"]).reshape(4, 4).T[:3, :3]
    z_up_from_y_up = NORTH_UP @ np.diag([1, -1, -1])
    assert_allclose(rows[:3, :3].T, glb, atol=1e-9)
    assert_allclose(tileset, z_up_from_y_up @ glb @ NORTH_UP.T, atol=1e-9)
    assert_allclose(glb @ scene.up, [0, 1, 0], atol=1e-12)


def test_a_folder_of_tiles_is_written_tile_by_tile(tmp_path):
    import drsplat as ds

    ds.write_gaussians(tmp_path / "scene.ply", labelled().gaussians)
    tiles = cut([Block(source) for source in sources_of(tmp_path / "scene.ply")], tmp_path / "city.tiles", ROWS)
    write_tiles3d(tmp_path / "out", tiles)
    tree = list(tiles_of(document_of(tmp_path / "out")["root"]))
    leaves = [tile for tile in tree if "children" not in tile]
    assert len(leaves) == len(tiles.tiles)
    assert sum(len(gaussians_of(tmp_path / "out" / leaf["content"]["uri"])) for leaf in leaves) == COUNT


def test_tiles_wait_on_disk(tmp_path, monkeypatch):
    alive = weakref.WeakSet()
    numbers = []
    written = tiles3d_writing._Writer._written

    def counted(self, gaussians, *rest):
        alive.add(gaussians)
        numbers.append(len(alive))
        return written(self, gaussians, *rest)

    monkeypatch.setattr(tiles3d_writing._Writer, "_written", counted)
    write_tiles3d(tmp_path / "out", labelled(), rows=10)
    assert len(numbers) > 30
    assert max(numbers) == 1
    names = {tile["content"]["uri"] for tile in tiles_of(document_of(tmp_path / "out")["root"])}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"tileset.json", *names}


@pytest.mark.parametrize("count", [1, ROWS, ROWS + 1])
def test_small_scenes_have_a_tree(count, tmp_path):
    write_tiles3d(tmp_path / "out", LabelledScene(labelled(count, 0).gaussians), rows=ROWS)
    assert len(list(tiles_of(document_of(tmp_path / "out")["root"]))) == (1 if count <= ROWS else 3)


def test_what_cannot_be_written_is_refused(tmp_path):
    scene = labelled(3)
    with refused("no Gaussians to write"):
        write_tiles3d(tmp_path / "out", LabelledScene(scene.gaussians.subset(np.zeros(0, int))))
    write_tiles3d(tmp_path / "out", scene)
    with refused("exists already"):
        write_tiles3d(tmp_path / "out", scene)
    write_tiles3d(tmp_path / "out", scene, overwrite=True)
    scene.gaussians.means[1] = np.nan
    with refused("row 1"):
        write_tiles3d(tmp_path / "nan", scene)
    assert not (tmp_path / "nan").exists()


@pytest.mark.oracle
def test_py3dtiles_reads_the_tileset(tmp_path):
    """It knows 1.0 and 1.1: as many tiles, and each box within that of the tile above."""
    tilesets = pytest.importorskip("py3dtiles.tileset")
    write_tiles3d(tmp_path / "out", labelled(), rows=ROWS)
    own = document_of(tmp_path / "out")
    tileset = tilesets.TileSet.from_file(tmp_path / "out" / "tileset.json")
    waiting, count = [tileset.root_tile], 0
    while waiting:
        tile = waiting.pop()
        corners = tile.bounding_volume.get_corners()
        count += 1
        for child in tile.children:
            inner = child.bounding_volume.get_corners()
            assert (np.min(inner, axis=0) >= np.min(corners, axis=0) - 1e-6).all()
            assert (np.max(inner, axis=0) <= np.max(corners, axis=0) + 1e-6).all()
        waiting += tile.children
    assert count == len(list(tiles_of(own["root"])))
