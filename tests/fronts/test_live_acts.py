"""What each act of the live viewer changes, as its page sees it: splats, paint and the state."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from clients import Viewer, a_viewer, camera, opened, ray_to, room_viewer
from drsplat import write_gaussians
from drsplat.authoring.editing import EditFile
from drsplat.authoring.filming.looking import before
from drsplat.fronts.viewing.live import arrays
from drsplat.fronts.viewing.session import Mode, Session
from drsplat.scene.gaussians import significance
from moving_scenes import passing_red_scene
from scenes import random_gaussians
from viewing_scenes import CENTERS, EACH, THINGS

COUNT = 3 * EACH + 60


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with a_viewer() as one:
        yield one


@pytest.fixture
def furnished(room: Path) -> Iterator[Viewer]:
    with room_viewer(room) as one:
        yield one


def rows_of(viewer: Viewer) -> np.ndarray:
    """The row of the scene that each row of the arrays is of."""
    return viewer.session.drawn.ids[viewer.shared.stage.order]


def things_with(viewer: Viewer, name: str) -> list[np.ndarray]:
    """For each number of an array but 0, the rows of the scene that have it, ascending."""
    values, rows = viewer.arrays("/view/paint")[name], rows_of(viewer)
    return [np.sort(rows[values == number]) for number in range(1, int(values.max()) + 1)]


# --- what is drawn ---


def test_splats_are_those_of_the_session_the_most_significant_first(viewer):
    arrays, shown = viewer.arrays("/view/splats"), viewer.session.shown
    weight = significance(viewer.session.scene.gaussians)
    rows = rows_of(viewer)
    assert (np.diff(weight[rows]) <= 0).all()
    assert_array_equal(np.sort(rows), np.arange(COUNT))
    assert_array_equal(arrays["centers"].reshape(-1, 3), shown.centers[rows])
    assert_array_equal(arrays["covariances"].reshape(-1, 6), shown.covariances[rows].astype(np.float16))
    assert_allclose(arrays["rgb"].reshape(-1, 3) / 255, shown.rgb[rows], atol=0.5 / 255 + 1e-6)
    assert_allclose(arrays["opacity"] / 255, shown.opacities[rows], atol=0.5 / 255 + 1e-6)


def test_rows_come_in_pieces_of_which_none_is_large(viewer, monkeypatch):
    viewer.ask("red mug")
    paths = ("/view/splats", "/view/paint", "/view/colors?mode=features")
    whole = {path: viewer.get(path).content for path in paths}
    sizes = {path: len(content) // COUNT for path, content in whole.items()}
    assert sizes == {"/view/splats": 28, "/view/paint": 2, "/view/colors?mode=features": 3}
    monkeypatch.setattr("drsplat.fronts.viewing.live.arrays.PIECE_ROWS", 400)
    for path in paths:
        more = "&" if "?" in path else "?"
        parts = [viewer.get(f"{path}{more}from={begin}") for begin in range(0, COUNT, 400)]
        assert [part.headers["x-drsplat-rows"] for part in parts] == [str(COUNT)] * 3
        assert [len(part.content) for part in parts] == [sizes[path] * rows for rows in (400, 400, 160)]
        beyond = viewer.get(f"{path}{more}from={COUNT}")
        assert beyond.status_code == 422
        assert "expected a row below 960" in beyond.text


def test_paint_says_which_query_each_row_is_of(viewer):
    state = viewer.ask("red mug; tall lamp")
    assert_array_equal(things_with(viewer, "owner"), [np.arange(EACH), np.arange(2 * EACH, 3 * EACH)])
    paint = viewer.arrays("/view/paint")
    assert (paint["heat"][paint["owner"] > 0] > 127).all()
    assert (paint["heat"][paint["owner"] == 0] <= 128).all()
    assert [result["text"] for result in state["results"]] == ["red mug", "tall lamp"]
    assert "object" not in paint


def test_answers_are_painted_once_for_all_who_look(viewer, monkeypatch):
    calls: list[int] = []
    made = arrays.paint
    monkeypatch.setattr(arrays, "paint", lambda stage: calls.append(1) or made(stage))
    viewer.ask("mug")
    for _ in range(3):
        viewer.get("/view/paint")
    viewer.do("annotate", text="here", at="selection")  # which changes nothing that is painted
    viewer.get("/view/paint")
    assert len(calls) == 1
    viewer.ask("lamp")
    viewer.get("/view/paint")
    assert len(calls) == 2


def test_counters_grow_with_what_they_count(viewer):
    counts = [viewer.state()]

    def grown(act: str, **given: Any) -> set[str]:
        counts.append(viewer.do(act, **given))
        before, after = counts[-2:]
        return {name for name in ("scene", "header", "geometry", "paint") if after[name] > before[name]}

    assert grown("ask", text="red mug") == {"paint"}
    assert grown("threshold", query=0, value=0.2) == {"paint"}
    assert grown("mode", mode="heat map") == set()
    assert grown("classify", text="red mug, tall lamp") == {"paint"}
    assert grown("annotate", text="here", at="selection") == set()
    assert grown("edit", change="recolour", color="#2060ff") == {"geometry", "paint"}
    assert grown("undo") == {"geometry", "paint"}
    assert grown("clear") == {"paint"}
    assert [count["revision"] for count in counts] == list(range(1, 10))


def test_colours_that_only_the_session_knows_are_sent(viewer):
    viewer.do("classify", text="red mug, blue mug, tall lamp")
    for mode in ("features", "classes"):
        rgb = viewer.arrays("/view/colors", mode=mode)["rgb"].reshape(-1, 3)
        own = Session(viewer.session.scene, mode=Mode(mode), segmentation=viewer.session.segmentation)
        assert_allclose(rgb / 255, own.colors[rows_of(viewer)], atol=0.5 / 255 + 1e-6)
    assert viewer.session.mode is Mode.CLASSES
    answer = viewer.get("/view/colors", mode="answer")
    assert answer.status_code == 422
    assert "features or classes" in answer.json()["error"]


# --- the page ---


def test_the_page_takes_its_script_and_its_look_from_here(viewer):
    html = viewer.get("/")
    assert html.headers["content-type"] == "text/html; charset=utf-8"
    for name, kind in (("client.js", "text/javascript"), ("client.css", "text/css")):
        assert name in html.text
        part = viewer.get(f"/{name}")
        assert part.headers["content-type"] == f"{kind}; charset=utf-8"
        assert len(part.content) > 1000
    assert "http://" not in html.text.replace("http://www.w3.org", "")


# --- the header ---


def test_a_header_says_where_to_begin_and_what_can_be_done(viewer):
    header, session = viewer.header(), viewer.session
    assert header["title"] == "boxes"
    assert header["modes"] == ["answer", "heat map", "as it is", "features", "classes"]
    can = header["can"]
    assert {name for name, value in can.items() if value is True} == {"ask", "ask_picture", "edit", "photos", "open"}
    assert {".webp", ".gif"} <= set(can["film_formats"])
    view = session.scene.views[1]
    assert_allclose(header["eye"], session.shown.frame.shown(view.center), atol=1e-4)
    photo = header["photos"][1]
    assert (photo["name"], photo["width"], photo["height"]) == (view.name, view.width, view.height)
    ahead = np.array(photo["target"]) - photo["eye"]
    assert_allclose(ahead, view.cam_from_world[2, :3], atol=1e-4)
    assert photo["fov"] == pytest.approx(np.degrees(2 * np.arctan(view.height / 2 / view.K[1, 1])))
    assert header["times"] is None
    assert header["objects"] == []


def test_a_header_lists_objects_with_places_to_see_them_from(furnished):
    header, session = furnished.header(), furnished.session
    assert [one["number"] for one in header["objects"]] == [0, 1]
    objects, frame = session.scene.objects, session.shown.frame
    for one in header["objects"]:
        match = objects[one["number"]]
        assert_allclose(one["center"], frame.shown(match.center), atol=1e-4)
        assert_allclose(one["extent"], match.extent * frame.scale, atol=1e-4)
        eye = before(match, session.scene.gaussians, session.scene.views, furnished.shared.stage.up)
        assert_allclose(one["eye"], frame.shown(eye), atol=1e-4)
        assert one["num_gaussians"] == len(match)
    ids = furnished.arrays("/view/paint")["object"].astype(int) - 1
    assert_array_equal(ids, session.scene.object_ids()[rows_of(furnished)])


# --- asking ---


def test_an_answer_has_boxes_and_a_threshold(viewer):
    (result,) = viewer.ask("tall lamp")["results"]
    (match,) = result["matches"]
    session = viewer.session
    own = session.results[0].matches[0]
    assert_allclose(match["center"], session.shown.frame.shown(own.center), atol=1e-4)
    assert_allclose(match["axes"], own.axes, atol=1e-4)
    assert match["place"] == "1.20, 0.00, 0.30"
    assert match["num_gaussians"] == EACH
    assert result["summary"] == f"tall lamp: 1 match, {EACH} Gaussians"
    assert (result["num_matches"], result["exact"]) == (1, False)
    assert result["limits"][0] <= result["threshold"] == result["automatic"] <= result["limits"][1]
    assert result["accent"] == [255, 170, 30]


def test_a_threshold_moves_the_selection_and_its_own_stays(viewer):
    before = viewer.ask("red mug; tall lamp")
    after = viewer.do("threshold", query=0, value=before["results"][0]["limits"][0] - 0.01)
    assert after["selection"] > before["selection"]
    assert after["results"][0]["automatic"] == before["results"][0]["automatic"]
    assert after["results"][1] == before["results"][1]
    assert "no query 7" in viewer.refused("threshold", query=7, value=0.5)


def test_nothing_found_and_words_that_are_not_known_are_said(viewer):
    state = viewer.ask("elephant")
    assert state["message"].startswith("No match for 'elephant'. The best place has")
    (result,) = state["results"]
    assert result["doubt"].startswith("The best place has a cosine of ")
    assert "below the threshold of 0.60" in result["doubt"]
    assert result["instead"] == ["mug", "lamp"]
    assert viewer.ask(result["instead"][0])["results"][0]["instead"] == []
    assert "ask: there is no such field: txt. Did you mean 'text'?" in viewer.refused("ask", txt="mug")
    assert "no such field: zoom. There are during, present, act, text" in viewer.refused("ask", text="mug", zoom=2)
    assert state["selection"] == 0
    assert "one to 8" in viewer.refused("ask", text=";".join("abcdefghi"))
    assert viewer.state()["results"] == []  # it would be read as the answer


def test_classes_have_colours_and_counts(viewer):
    state = viewer.do("classify", text="red mug, blue mug, tall lamp")
    assert state["mode"] == "classes"
    assert [(one["name"], one["count"]) for one in state["classes"]] == [(name, EACH) for name in THINGS]
    assert len({tuple(one["color"]) for one in state["classes"]}) == 3


def test_modes_are_those_that_show_something(viewer):
    assert viewer.do("mode", mode="heat map")["mode"] == "heat map"
    assert "expected one of" in viewer.refused("mode", mode="objects")
    assert viewer.state()["mode"] == "heat map"


def test_clear_lets_go_of_everything(viewer):
    viewer.ask("red mug")
    viewer.do("click", **ray_to(viewer, CENTERS[0]))
    state = viewer.do("clear")
    assert (state["results"], state["clicked"], state["selection"], state["mode"]) == ([], None, 0, "as it is")
    assert not viewer.arrays("/view/paint")["owner"].any()


def test_a_picture_needs_an_encoder_that_sees_and_is_a_picture(viewer):
    from drsplat.fronts.serving.replies import png

    picture = png(np.zeros((4, 4, 3), np.uint8))
    answer = viewer.post("/view/ask-picture?name=x.png", picture)
    assert answer.status_code == 422
    assert "images" in answer.json()["error"]
    for junk in (b"", b"GIF89a", picture[:40], bytes(1000)):
        answer = viewer.post("/view/ask-picture?name=x.png", junk)
        assert answer.status_code == 422
        assert "image" in answer.json()["error"]


# --- pointing ---


def test_a_click_says_what_is_there_and_more_of_it_is_found(viewer):
    clicked = viewer.do("click", **ray_to(viewer, CENTERS[2]))["clicked"]
    assert clicked["name"] == clicked["words"][0]["text"] == "tall lamp"
    assert clicked["support"] == [{"view": "view.png", "mask": 2, "share": 1.0}]
    state = viewer.do("more_like_this")
    assert state["selection"] == EACH
    assert_array_equal(things_with(viewer, "owner"), [np.arange(2 * EACH, 3 * EACH)])
    state = viewer.do("click", origin=[0, 0, 50], direction=[0, 0, 1])
    assert state["clicked"] is None
    assert "Nothing with a feature" in state["message"]
    assert "direction" in viewer.refused("click", origin=[0, 0, 0], direction=[0, 0, 0])


def test_a_pixel_of_a_photo_is_a_click(furnished):
    session = furnished.session
    for number in range(2):
        view = session.scene.views[0]
        x, y, depth = view.K @ (view.cam_from_world @ np.append(session.scene.objects[number].center, 1))[:3]
        state = furnished.do("click_photo", photo=view.name, x=x / depth, y=y / depth)
        assert state["chosen"]["number"] == number
    assert "expected a pixel" in furnished.refused("click_photo", photo=view.name, x=1e6, y=0.0)
    assert "no view" in furnished.refused("click_photo", photo="../secret.png", x=1.0, y=1.0)


def test_objects_are_chosen_named_and_made_larger(furnished):
    state = furnished.do("choose", number=1)
    chosen = state["chosen"]
    assert (chosen["number"], chosen["label"], chosen["larger"]) == (1, False, False)
    assert chosen["num_gaussians"] == state["selection"] == len(furnished.session.scene.objects[1])
    assert "nothing larger" in furnished.refused("larger")
    assert "nothing smaller" in furnished.refused("smaller")
    named = furnished.do("name", text="my ball")
    assert named["chosen"]["name"] == "my ball"
    assert named["chosen"]["label"]
    assert named["header"] > state["header"]
    header = furnished.header()
    assert [one["name"] for one in header["objects"]][1] == "my ball · 1"
    assert "my ball" in header["words"]
    assert furnished.ask("my ball")["selection"] == state["selection"]
    assert "no object" in furnished.refused("choose", number=2)
    furnished.do("clear")
    assert "no object is selected" in furnished.refused("name", text="x")


def test_an_outline_selects_what_is_seen_inside_it(viewer):
    """From the side: a square about the lamp's middle in the picture, drawn at another size than the browser's."""
    seen_from = camera(viewer, eye=(0.0, -6.0, 0.0)) | {"width": 1600, "height": 1200}
    scale = 1200 / (2 * np.tan(np.radians(25)) * 6)
    x, y = 800 + scale * 1.2, 600 - scale * 0.3
    corners = [[x - 150, y - 150], [x + 150, y - 150], [x + 150, y + 150], [x - 150, y + 150]]
    state = viewer.do("lasso", polygon=corners, camera=seen_from)
    ids = viewer.session.selection
    lamp = np.arange(2 * EACH, 3 * EACH)
    assert len(np.setdiff1d(ids, lamp)) < 10  # of the haze of 60 that is everywhere
    assert len(np.intersect1d(ids, lamp)) > EACH / 4  # those that are seen, not those behind them
    assert state["selection"] == len(ids)
    assert state["results"][0]["exact"]
    assert_array_equal(things_with(viewer, "owner"), [ids])
    assert "nothing is seen" in viewer.refused("lasso", polygon=[[0, 0], [1, 0], [0, 1]], camera=seen_from)
    viewer.do("edit", change="remove")
    assert not viewer.session.edits.present[ids].any()


# --- changing ---


def test_edits_change_what_is_drawn_and_are_undone(viewer):
    viewer.ask("red mug")
    plain = viewer.shared.splats()
    state = viewer.do("edit", change="recolour", color="#2060ff")
    assert [(one["what"], one["target"], one["done"]) for one in state["edits"]] == [("recolour", "“red mug”", True)]
    assert (state["can_undo"], state["can_redo"], state["kept"]) == (True, False, False)
    rgb = viewer.arrays("/view/splats")["rgb"].reshape(-1, 3).astype(int)
    mug = np.isin(rows_of(viewer), np.arange(EACH))
    assert (rgb[mug][:, 2] >= rgb[mug][:, 0]).all()
    undone = viewer.do("undo")
    assert (undone["can_undo"], undone["can_redo"]) == (False, True)
    assert not undone["edits"][0]["done"]
    assert viewer.shared.splats() == plain
    assert "no edit to undo" in viewer.refused("undo")
    viewer.do("redo")
    assert viewer.shared.splats() != plain
    assert viewer.do("restore")["can_redo"]
    assert viewer.shared.splats() == plain


@pytest.mark.parametrize(
    ("change", "given"),
    [
        ("remove", {}),
        ("isolate", {}),
        ("recolour", {"color": "steelblue"}),
        ("palette", {"colors": ["#203040", "#d0c0a0"]}),
        ("opacity", {"number": 0.3}),
        ("move", {"by": [0, 0, 1]}),
        ("duplicate", {"by": [0, 0, 1]}),
        ("turn", {"number": 45}),
        ("scale", {"number": 1.5}),
    ],
)
def test_each_change_is_drawn(viewer, change, given):
    viewer.ask("red mug")
    before = viewer.arrays("/view/splats")
    state = viewer.do("edit", change=change, **given)
    after = viewer.arrays("/view/splats")
    assert state["edits"][0]["done"]
    assert any(before[name].shape != after[name].shape or (before[name] != after[name]).any() for name in before)
    assert len(viewer.arrays("/view/paint")["owner"]) == len(after["opacity"])
    assert len(after["opacity"]) == COUNT + (EACH if change == "duplicate" else 0)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"change": "recolour"}, "expected a color"),
        ({"change": "recolour", "color": "no colour"}, "expected a colour"),
        ({"change": "palette"}, "expected colors"),
        ({"change": "move"}, "expected by"),
        ({"change": "scale"}, "expected a number"),
        ({"change": "scale", "number": -1}, "scale|factor|expected"),
        ({"change": "opacity"}, "expected a number"),
    ],
)
def test_a_change_that_cannot_be_made_leaves_the_scene(viewer, given, reason):
    import re

    viewer.ask("red mug")
    before = viewer.shared.splats()
    assert re.search(reason, viewer.refused("edit", **given))
    assert viewer.shared.splats() == before
    assert viewer.state()["edits"] == []


def test_edits_and_annotations_are_kept_beside_the_scene(furnished, room):
    furnished.do("choose", number=0)
    state = furnished.do("edit", change="move", by=[0, 0, 0.5])
    assert state["kept"]
    furnished.do("annotate", text="the red one", at="selection")
    assert len(EditFile.beside(room / "scene.ply").read(furnished.session.scene.gaussians).edits) == 1
    with room_viewer(room) as again:
        anew = again.state()
        assert [one["what"] for one in anew["edits"]] == ["move"]
        assert [one["text"] for one in anew["annotations"]] == ["the red one"]
        assert_array_equal(*(one.arrays("/view/splats")["centers"] for one in (again, furnished)))


def test_annotations_are_at_boxes_and_at_clicks(viewer):
    assert "nothing is selected" in viewer.refused("annotate", text="x", at="selection")
    assert "click something" in viewer.refused("annotate", text="x", at="click")
    viewer.ask("tall lamp")
    (box,) = viewer.do("annotate", text="a lamp", at="selection")["annotations"]
    match = viewer.state()["results"][0]["matches"][0]
    assert_allclose(box["center"], match["center"], atol=1e-3)
    assert_allclose(box["extent"], match["extent"], atol=1e-3)
    clicked = viewer.do("click", **ray_to(viewer, CENTERS[0]))["clicked"]
    _, point = viewer.do("annotate", text="here", at="click")["annotations"]
    assert (point["text"], "extent" in point) == ("here", False)
    assert_allclose(point["center"], clicked["center"], atol=1e-4)
    assert [one["text"] for one in viewer.do("drop_annotation", number=1)["annotations"]] == ["here"]
    assert "annotation" in viewer.refused("drop_annotation", number=7)


# --- time ---


def test_a_scene_that_moves_is_drawn_and_boxed_at_its_time():
    scene = passing_red_scene()
    with a_viewer(Session(scene)) as viewer:
        times = viewer.header()["times"]
        assert (times["first"], times["last"], times["count"]) == (0.0, 1.0, len(scene.moving.times))
        first = viewer.ask("red car")
        assert first["time"] == {"at": 0.0, "during": None}
        before, rows = viewer.arrays("/view/splats")["centers"].reshape(-1, 3), rows_of(viewer)
        last = viewer.do("time", at=1.0)
        after = viewer.arrays("/view/splats")["centers"].reshape(-1, 3)
        assert_array_equal(rows_of(viewer), rows)  # the same rows, elsewhere
        frame = viewer.session.shown.frame
        assert_allclose(after, frame.shown(scene.moving.at(1.0).positions)[rows], atol=1e-4)
        assert (np.abs(after - before).max(axis=1) > 1).sum() == 100
        ways = [state["results"][0]["matches"][0]["center"] for state in (first, last)]
        assert (ways[1][1] - ways[0][1]) / frame.scale == pytest.approx(2.0, abs=0.1)
        assert viewer.do("time", at=99.0)["time"]["at"] == 1.0


def test_queries_ask_of_a_span_of_time():
    with a_viewer(Session(passing_red_scene())) as viewer:
        state = viewer.ask("red car", during=[0.0, 0.3])
        assert state["time"]["during"] == [0.0, 0.3]
        seen = {viewer.session.scene.view(one.view_name).time for one in viewer.session.results[0].matches[0].support}
        assert max(time for time in seen if time is not None) <= 0.3
        assert viewer.ask("red car")["time"]["during"] == [0.0, 0.3]
        assert viewer.do("during", span=[0, 1])["time"]["during"] is None
        assert "before its end" in viewer.refused("during", span=[0.5, 0.2])


def test_a_scene_that_stands_still_has_no_time(viewer):
    for act in ({"act": "time", "at": 0.5}, {"act": "during", "span": None}):
        assert viewer.refused(**act)
    assert viewer.state()["time"] is None


# --- a scene without a field ---


def test_a_scene_without_a_field_is_seen_outlined_and_edited_but_not_asked(tmp_path):
    write_gaussians(tmp_path / "plain.ply", replace(random_gaussians(80), opacities=np.full(80, 0.9, np.float32)))
    with a_viewer(Session(opened(tmp_path / "plain.ply"))) as viewer:
        header = viewer.header()
        assert not header["can"]["ask"]
        assert header["can"]["edit"]
        assert "no field" in header["about"]
        assert "no field" in viewer.refused("ask", text="mug")
        everything = [[-9, -9], [999, -9], [999, 999], [-9, 999]]
        seen = viewer.do("lasso", polygon=everything, camera=camera(viewer))["selection"]
        assert seen > 10
        viewer.do("edit", change="isolate")
        assert (viewer.arrays("/view/splats")["opacity"] > 0).sum() >= seen
        assert "Nothing with a feature" in viewer.do("click", origin=[0, 0, -9], direction=[0, 0, 1])["message"]
        assert viewer.do("restore")["edits"][0]["done"] is False
