"""A scene in tiles in the viewer: parts that make the whole, answers and clicks of all of it, and what is refused."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from browsing import a_page, needs_chromium
from cities import write_city
from clients import Viewer, served
from drsplat.authoring.filming.looking import Standpoints, beside
from drsplat.formats.tiles import Tiles
from drsplat.fronts.viewing.bare import is_bare, open_bare
from drsplat.fronts.viewing.live.arrays import tile_paint, tile_splats
from drsplat.fronts.viewing.results import heat, owners
from drsplat.fronts.viewing.saving import picture_of
from drsplat.fronts.viewing.session import Mode, Session
from drsplat.fronts.viewing.shown import shown_part
from drsplat.fronts.viewing.tiled import TiledSession, session_of
from drsplat.query import Scene, open_scene
from refusing import malformed, refused
from scenes import look_at_view
from toy_capture import THINGS

SURFACES = [np.array([x, y - 0.3, z]) for x, y, z in THINGS.values()]
PARTS = list(range(18))  # of nine tiles


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_city(tmp_path_factory.mktemp("city"))


@pytest.fixture(autouse=True)
def nothing_reads_all() -> Iterator[None]:
    with patch.object(Tiles, "gaussians", side_effect=AssertionError("the whole scene was read")):
        yield


def opened(folder: Path) -> Scene:
    return open_scene(folder, views=folder / "capture", threads=1)


@pytest.fixture
def tiled(city: Path) -> TiledSession:
    session = session_of(opened(city / "tiled"), 200)
    assert isinstance(session, TiledSession)
    return session


@pytest.fixture
def whole(city: Path) -> Session:
    return Session(opened(city / "whole"))


@pytest.fixture
def viewer(tiled: TiledSession) -> Iterator[Viewer]:
    viewer = Viewer(tiled)
    yield viewer
    viewer.close()


def test_a_city_is_open_before_a_tile_is_read(city):
    with patch.object(Tiles, "_read", side_effect=AssertionError("a tile was read")):
        viewer = Viewer(session_of(opened(city / "tiled"), 200))
        header = viewer.header()
        assert viewer.get("/view/state").json()["mode"] == "as it is"
        viewer.close()
    assert sum(tile["rows"] for tile in header["tiles"]["tiles"]) == 300
    assert sum(tile["coarse"] for tile in header["tiles"]["tiles"]) <= 0.25 * 200 + 9
    assert (header["tiles"]["budget"], header["can"]["edit"]) == (200, False)
    assert "features" not in header["modes"]


def test_parts_are_the_whole_each_gaussian_once(viewer, whole):
    session = viewer.session
    assert isinstance(session, TiledSession)
    rows = np.concatenate([session.rows_of(part) for part in PARTS])
    assert_array_equal(np.sort(rows), np.arange(300))
    arrays = viewer.arrays("/view/tiles", parts=",".join(map(str, PARTS)))
    centers, covariances, rgb, opacities = shown_part(whole.scene.gaussians.subset(rows), session.shown.frame)
    assert_array_equal(arrays["centers"].reshape(-1, 3), centers)
    assert_array_equal(arrays["covariances"].reshape(-1, 6), covariances.astype(np.float16))
    assert_array_equal(arrays["rgb"].reshape(-1, 3), (rgb * 255 + 0.5).astype(np.uint8))
    assert_array_equal(arrays["opacity"], (opacities * 255 + 0.5).astype(np.uint8))


def test_the_coarse_part_of_a_tile_has_what_is_most_significant(tiled):
    from drsplat.scene.gaussians import significance

    for number, tile in enumerate(tiled.tiles.tiles):
        weight = significance(tiled.tiles.tile(tile))
        coarse = tiled.rows_of(2 * number) - tile.first
        assert len(coarse) == tiled.num_coarse(tile)
        assert weight[coarse].min() >= np.delete(weight, coarse).max()


def test_answers_paint_parts_as_they_paint_the_whole(viewer, whole):
    session = viewer.session
    assert isinstance(session, TiledSession)
    viewer.ask("red mug; blue plate")
    whole.ask("red mug; blue plate")
    for part in PARTS:  # each by itself: heat does not depend on what is asked beside it
        arrays = viewer.arrays("/view/tiles-paint", parts=part)
        rows = session.rows_of(part)
        assert_array_equal(arrays["owner"], (owners(whole.results, 300) + 1)[rows])
        assert_array_equal(arrays["heat"], (heat(whole.results, 300) * 255 + 0.5).astype(np.uint8)[rows])
        assert_array_equal(arrays["object"], whole.objects_at()[rows] + 1)


@pytest.mark.parametrize("mode", [Mode.SCENE, Mode.ANSWER, Mode.HEAT, Mode.OBJECTS, Mode.CLASSES])
def test_pictures_have_the_colours_of_the_whole(tiled, whole, mode):
    view = whole.scene.views[0]
    for session in (tiled, whole):
        session.ask("red mug")
        session.classify(["red mug", "blue plate"])
        session.mode = mode
    assert_array_equal(picture_of(tiled, view), picture_of(whole, view))


def test_classes_come_with_their_colours(viewer):
    viewer.do("classify", text="red mug, blue plate")
    rgb = viewer.arrays("/view/tiles-paint", parts="0,1,16,17")["rgb"].reshape(-1, 3)
    assert len(np.unique(rgb, axis=0)) == 2


@pytest.mark.parametrize("eye", [(0.0, -4.0, 1.0), (3.0, -3.0, 1.5), (-3.0, 0.0, 0.1), (0.3, 3.0, -1.0)])
def test_a_click_meets_what_it_meets_in_the_whole(tiled, whole, eye):
    for target in (*SURFACES, np.array([0.0, 0.0, 5.0])):
        this = [
            session.click(session.shown.frame.shown(np.array(eye)), target - eye) for session in (tiled, whole)
        ]  # fmt: skip
        assert (this[0] is None) == (this[1] is None)
        if this[0] is not None and this[1] is not None:
            assert this[0].gaussian_id == this[1].gaussian_id
            assert_array_equal(tiled.results[0].gaussian_ids, whole.results[0].gaussian_ids)


@pytest.mark.parametrize("length", [1e-307, 5e-324, 1e300])
def test_a_ray_of_any_length_goes_the_same_way(tiled, whole, length):
    for session in (tiled, whole):
        origin = session.shown.frame.shown(np.array([-0.7, -4.0, 0.0]))
        this = [session.click(origin, np.array([0.0, size, 0.0])) for size in (1.0, length)]
        assert this[0] is not None
        assert this[1] is not None
        assert this[0].gaussian_id == this[1].gaussian_id


def test_what_is_outlined_is_selected_as_in_the_whole(tiled, whole):
    view, outline = (
        look_at_view((0.0, -4.0, 1.0), width=96, height=72),
        np.array([[0, 0], [48, 0], [48, 72], [0, 72.0]]),
    )
    for session in (tiled, whole):
        session.lasso(view, outline)
    assert_array_equal(tiled.results[0].gaussian_ids, whole.results[0].gaussian_ids)
    assert_array_equal(tiled.results[0].matches[0].center, whole.results[0].matches[0].center)


def test_annotations_are_kept_and_edits_refused(viewer):
    viewer.ask("red mug")
    state = viewer.do("annotate", text="here", at="selection")
    assert [one["text"] for one in state["annotations"]] == ["here"]
    for act in ({"act": "edit", "change": "remove"}, {"act": "undo"}, {"act": "restore"}):
        reply = viewer.post("/view/do", act)
        assert (reply.status_code, "a scene in tiles is not edited" in reply.text) == (422, True), reply.text
    for path, body in (("/view/save", {"what": "scene"}), ("/view/page", {})):
        reply = viewer.post(path, body)
        assert (reply.status_code, "drsplat export --tiles3d" in reply.text) == (422, True), reply.text


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ("", "expected whole numbers"), ("1,x", "expected whole numbers"), ("-1", "expected whole numbers"),
        ("18", "expected numbers below 18"), ("1,1", "different numbers"), (",".join("0" * 70), "1 to 64 different"),
    ],
)  # fmt: skip
def test_parts_that_are_not_there_are_refused(viewer, parts, said):
    for path in ("/view/tiles", "/view/tiles-paint"):
        reply = viewer.get(path, parts=parts)
        assert (reply.status_code, said in reply.text) == (422, True), reply.text


def test_a_scene_in_memory_has_no_parts(whole):
    viewer = Viewer(whole)
    assert viewer.header()["tiles"] is None
    assert "not in tiles" in viewer.get("/view/tiles", parts="0").text
    viewer.close()


def test_a_damaged_tile_is_said_and_the_others_come(city, tmp_path):
    folder = Path(shutil.copytree(city / "tiled", tmp_path / "tiled"))
    viewer = Viewer(session_of(opened(folder), 200))
    (folder / "city.tiles/tile00003.colours.safetensors").unlink()
    reply = viewer.get("/view/tiles", parts="6")
    assert "tile00003" in reply.text
    assert str(tmp_path) not in reply.text
    assert len(viewer.arrays("/view/tiles", parts="4")["opacity"])
    with malformed("tile00003"):
        tile_splats(viewer.shared.stage, [6])
    assert len(json.loads(tile_paint(viewer.shared.stage, [6]).layout))  # answers need no colours
    viewer.close()


def test_tiles_without_a_field_can_be_looked_at(city):
    path = city / "tiled/city.tiles"
    assert is_bare(path)
    session = session_of(open_bare(path), 300)
    assert isinstance(session, TiledSession)
    assert session.modes == (Mode.SCENE,)
    assert len(session.part(0)) == session.num_coarse(session.tiles.tiles[0])
    with refused("nothing can be asked"):
        session.ask("mug")


def test_many_cameras_as_arrays_give_the_same_place(whole):
    views = whole.scene.views
    for center in SURFACES:
        stands = Standpoints.of(views), views
        places = [beside(center, 0.4, given, np.array([0, 0, 1.0])) for given in stands]
        assert_array_equal(*places)


HERE = "() => [drsplat.splats.count, drsplat.tiles.numWhole, Array.from(drsplat.paint.owner).filter((x) => x).length]"
DONE = "() => window.drsplat && drsplat.splats && drsplat.isWhole && !drsplat.tiles.running"


@needs_chromium
def test_the_client_holds_what_the_camera_is_near_to(city, chromium):
    """With room for 200 of 300 Gaussians: all tiles coarsely, and wholly those of the ball in front."""
    session = session_of(opened(city / "tiled"), 200)
    with served(session) as address, a_page(chromium) as page:
        page.goto(address)
        page.wait_for_function(DONE)
        held: dict[str, set[int]] = {}
        for name, (x, y, z) in THINGS.items():
            frame = session.shown.frame
            eye, target = (frame.shown(np.array([x, y - away, z])).tolist() for away in (1.0, 0.0))
            page.evaluate("([eye, target]) => drsplat.camera.stand(eye, target)", [eye, target])
            page.wait_for_function(DONE)
            count, whole, _ = page.evaluate(HERE)
            assert count <= 200
            assert whole > 0
            held[name] = {
                part // 2 for part in page.evaluate("() => Array.from(drsplat.tiles.parts.keys())") if part % 2
            }
        assert held["red mug"] != held["blue plate"]
        page.evaluate("() => drsplat.act({act: 'ask', text: 'red mug'})")
        page.wait_for_function("() => drsplat.state.results.length === 1 && drsplat.paint.owner.some((x) => x)")
        count, _, found = page.evaluate(HERE)
        assert 0 < found < count
        assert "Answers are of all" in page.text_content("#rows")
