"""A scene in tiles that stays on disk: the answers, boxes and pictures of the same scene in memory, to the bit."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import drsplat as ds
from cities import ROWS, write_city
from command_line import answer_of
from drsplat.errors import DrSplatWarning, FormatError, InputError, MismatchError
from drsplat.field.tiles.cutting import cut
from drsplat.formats.sources import blocks_of
from drsplat.formats.tiles import Tiles, read_tiles
from drsplat.query import Scene, open_scene
from drsplat.query.places import nearest_gaussian
from drsplat.query.regions import region
from drsplat.query.relations import gap, related
from drsplat.query.seen import seen_of_tiles
from drsplat.query.sheets import attribute_row, object_picture
from drsplat.scene.parted import AnyGaussians, middle
from scenes import look_at_view
from toy_capture import THINGS

WORDS = list(THINGS)
SURFACES = [(x, y - 0.3, z) for x, y, z in THINGS.values()]  # the balls are hollow


@pytest.fixture(scope="module")
def city(tmp_path_factory) -> Path:
    return write_city(tmp_path_factory.mktemp("city"))


def opened(folder: Path) -> Scene:
    return open_scene(folder, views=folder / "capture")


@pytest.fixture(scope="module")
def both(city) -> tuple[Scene, Scene]:
    """The scene in tiles, and the one in memory."""
    return opened(city / "tiled"), opened(city / "whole")


@pytest.fixture(autouse=True)
def nothing_reads_all() -> Iterator[None]:
    """No query reads a scene in tiles as a whole."""
    with patch.object(Tiles, "gaussians", side_effect=AssertionError("the whole scene was read")):
        yield


def assert_same(one: list[ds.Match], other: list[ds.Match]) -> None:
    assert len(one) == len(other)
    for first, second in zip(one, other, strict=True):
        for name in ("center", "axes", "extent", "gaussian_ids"):
            assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
        assert (first.score, first.support, first.object_id) == (second.score, second.support, second.object_id)


def test_rows_of_tiles_are_those_of_the_whole(both):
    tiled, whole = (scene.rows for scene in both)
    rows = np.random.default_rng(0).permutation(len(whole))[:70]
    for name in ("means", "quats", "scales", "opacities"):
        assert_array_equal(getattr(tiled.shapes_of(rows), name), getattr(whole, name)[rows])
        assert_array_equal(getattr(tiled.subset(rows), name), getattr(whole, name)[rows])
    assert_array_equal(tiled.subset(rows).sh, whole.sh[rows])
    assert_array_equal(tiled.opacities_of(rows), whole.opacities[rows])
    assert (len(tiled), tiled.fingerprint, tiled.near) == (len(whole), whole.fingerprint, whole.near)
    assert len(tiled.subset(rows[:0])) == len(tiled.shapes_of(rows[:0])) == 0


def test_every_kind_of_query_finds_the_same(both):
    tiled, whole = both
    red, blue = SURFACES
    vector = whole.encoder.encode_texts(["red mug"])[0].astype(np.float32)
    click = ("photo_0.png", 30.0, 42.0)
    queries = [
        *map(ds.Query, WORDS), ds.Query("mug, not blue"), ds.Query("plate", top_share=0.3),
        ds.Query("mug", threshold=0.2),
        ds.Query("red mug", relevancy=True, negatives=("thing",)), ds.Query(vector=vector), ds.Query(point=red),
        ds.Query(point=blue, objects="never"), ds.Query(click=click), ds.Query(click=click, objects="never"),
    ]  # fmt: skip
    for query in queries:
        answers = tiled.ask(query), whole.ask(query)
        assert_array_equal(answers[0].values, answers[1].values)
        assert answers[0].threshold == answers[1].threshold
        for box in ("upright", "free"):
            found = [scene.locate(answer, box=box) for scene, answer in zip(both, answers, strict=True)]
            assert_same(*found)
    assert any(len(whole.locate(query)) for query in queries)


def test_objects_labels_and_classes_are_the_same(both):
    tiled, whole = both
    assert_same(tiled.objects, whole.objects)
    assert_array_equal(tiled.segment(WORDS).labels, whole.segment(WORDS).labels)
    assert_array_equal(tiled.object_ids(), whole.object_ids())
    assert_array_equal(np.stack(tiled.box), np.stack(whole.box))


def test_places_regions_and_relations_are_the_same(both):
    tiled, whole = both
    place = SURFACES[0]
    click = ("photo_0.png", 30.0, 42.0)
    assert tiled.nearest(place) == whole.nearest(place)
    assert tiled.what_is(place, WORDS) == whole.what_is(place, WORDS)
    assert tiled.what_is(click, WORDS) == whole.what_is(click, WORDS)
    assert_array_equal(tiled.point_at(click), whole.point_at(click))
    parts = [region(scene, place, 0.5, WORDS) for scene in both]
    assert [part._replace(center=None) for part in parts[0]] == [part._replace(center=None) for part in parts[1]]
    assert_array_equal([part.center for part in parts[0]], [part.center for part in parts[1]])
    one, other = whole.objects
    assert gap(tiled.rows, one, other) == gap(whole.rows, one, other)
    for relation in ("on", "in", "next_to", "above"):
        assert_same(*(related(scene.rows, relation, whole.objects, one, up=whole.up) for scene in both))


@pytest.mark.parametrize("place", [(40.0, 0.0, 0.0), (0.0, np.nan, 0.0), (1e200, 0.0, 0.0)])
def test_where_nothing_is_the_same_error_says_so(both, place):
    said = []
    for scene in both:
        with pytest.raises(InputError) as error:
            scene.nearest(place)
        said.append(str(error.value))
    assert said[0] == said[1]


def nearest_or_error(rows: AnyGaussians, some: np.ndarray, point: np.ndarray) -> int | str:
    try:
        return nearest_gaussian(rows, some, point)
    except InputError as error:
        return str(error)


def test_the_nearest_of_many_is_that_of_the_whole_wherever_one_asks(both):
    """64 candidates of 300 lie in several tiles, and tiles are taken by their distance."""
    tiled, whole = (scene.rows for scene in both)
    some = np.arange(0, len(whole), 2, dtype=np.uint32)
    for point in np.random.default_rng(1).uniform(-1, 1, (40, 3)):
        assert nearest_or_error(tiled, some, point) == nearest_or_error(whole, some, point)
    assert_array_equal(middle(tiled, (0.1, 0.7), some), middle(whole, (0.1, 0.7), some))


def test_a_place_reads_only_tiles_near_it(both):
    rows = read_tiles(both[0].tiles.path).parted()
    counted = []
    with patch.object(
        Tiles, "shapes", autospec=True, side_effect=lambda tiles, tile: counted.append(tile) or _shapes(tiles, tile)
    ):
        nearest_gaussian(rows, np.arange(len(rows), dtype=np.uint32), SURFACES[0])
    assert 0 < len(counted) < len(both[0].tiles.tiles) - 2


_shapes = Tiles.shapes


def test_pictures_are_the_same(both):
    tiled, whole = both
    match = whole.locate("red mug")[0]
    for view in whole.views:
        assert_array_equal(tiled.picture(view), whole.picture(view))
        assert_array_equal(tiled.picture(view, match.gaussian_ids), whole.picture(view, match.gaussian_ids))
        assert_array_equal(
            tiled.picture(view, match.gaussian_ids, photo=True), whole.picture(view, match.gaussian_ids, photo=True)
        )
    assert tiled.best_view(match.gaussian_ids).name == whole.best_view(match.gaussian_ids).name
    assert_array_equal(object_picture(tiled, match), object_picture(whole, match))
    assert_array_equal(attribute_row(tiled, match, ["red"]), attribute_row(whole, match, ["red"]))


def test_without_evidence_a_near_view_that_shows_it_is_taken(both):
    tiled, whole = both
    bare = Scene(replace(tiled.field, evidence=None, objects=None, growth=None), tiled.tiles, tiled.views)
    away = [look_at_view((x, -30.0, 0.0), (x, -60.0, 0.0), width=60, height=40) for x in range(9)]
    bare.views = (*away, *whole.views)
    shown = [view.name for view in whole.views]
    assert bare.best_view(whole.locate("red mug")[0].gaussian_ids).name in shown


def test_a_picture_of_a_part_reads_only_tiles_in_sight(both):
    """A camera close to the red ball, which looks away from the blue one."""
    tiled, whole = both
    view = look_at_view((-0.2, -0.2, 0.0), (-2.0, 0.0, 0.0), width=60, height=40)
    seen = tiled.seen(view)
    assert 0 < len(seen.gaussians) < len(whole.rows) - ROWS
    assert_array_equal(tiled.picture(view), whole.picture(view))
    ids = np.arange(0, len(whole.rows), 3)
    assert_array_equal(seen.rows[seen.local(ids)], np.intersect1d(seen.rows, ids))


def test_a_view_of_too_much_thins_far_tiles_out_and_says_so(both):
    tiles, view = both[0].tiles, both[0].views[0]
    seen = seen_of_tiles(tiles, view, 150)
    assert (len(seen.gaussians) + seen.num_left_out, both[0].seen(view).num_left_out) == (300, 0)
    assert 100 < len(seen.gaussians) <= 150
    assert_array_equal(seen.rows, np.unique(seen.rows))
    nearest = min(tiles.tiles, key=lambda tile: float(np.linalg.norm((tile.low + tile.high) / 2 - view.center)))
    assert np.isin(np.arange(nearest.first, nearest.first + nearest.num_rows), seen.rows).all()
    few = partial(seen_of_tiles, most=150)
    with (
        patch("drsplat.query.seen.seen_of_tiles", few),
        pytest.warns(DrSplatWarning, match="may see 300 Gaussians.*look from nearer"),
    ):
        both[0].picture(view)


def test_a_field_alone_and_tiles_of_another_scene_say_what_is_wrong(city, tmp_path):
    with pytest.raises(InputError, match="opened without its Gaussians"):
        _ = open_scene(city / "tiled/city.field").rows
    ds.write_gaussians(tmp_path / "half.ply", ds.read_gaussians(city / "whole/scene.ply").subset(np.arange(150)))
    cut(blocks_of([tmp_path / "half.ply"]), tmp_path / "half.tiles", ROWS)
    with pytest.raises(MismatchError, match="this field belongs to"):
        open_scene(city / "tiled/city.field", scene=tmp_path / "half.tiles")


@pytest.mark.parametrize("damage", ["missing", "cut short", "of another cut", "a flipped bit"])
def test_a_bad_tile_is_named_when_a_query_meets_it(city, tmp_path, damage):
    folder = Path(shutil.copytree(city / "tiled", tmp_path / "tiled"))
    for tile in sorted((folder / "city.tiles").glob("*.shapes.safetensors")):
        content = bytearray(tile.read_bytes())
        if damage == "missing":
            tile.unlink()
        elif damage == "cut short":
            tile.write_bytes(content[:-100])
        elif damage == "a flipped bit":
            content[-3] ^= 8
            tile.write_bytes(content)
    if damage == "of another cut":
        shapes = sorted((folder / "city.tiles").glob("*.shapes.safetensors"))
        for one, other in zip(shapes[0::2], shapes[1::2], strict=False):
            first, second = one.read_bytes(), other.read_bytes()
            one.write_bytes(second)
            other.write_bytes(first)
    scene = opened(folder)
    assert len(scene.ask("red mug").gaussian_ids)  # the field answers without the tiles
    with pytest.raises(
        FormatError, match=r"city.tiles/tile0000\d.*Restore the folder from a copy, or cut the scene anew"
    ):
        scene.locate("red mug")


def test_the_command_line_prints_the_same(city, capsys):
    printed = []
    for name, scene in (("tiled", "city.tiles"), ("whole", "scene.ply")):
        folder = city / name
        printed.append(answer_of(capsys, "locate", folder / "city.field", "red mug", "--scene", folder / scene))
    assert printed[0]["matches"] == printed[1]["matches"]
