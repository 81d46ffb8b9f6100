"""Several browsers before one viewer: each has its own question, all share the scene and its edits."""

import asyncio
import time
from collections.abc import Iterator

import numpy as np
import pytest

from clients import Browser, Stream, Viewer, a_viewer, error_of, ray_to
from drsplat.errors import InputError
from drsplat.fronts.viewing import painting
from drsplat.fronts.viewing.live import turns
from drsplat.fronts.viewing.session import Session
from moving_scenes import passing_red_scene
from scenes import random_gaussians
from viewing_scenes import CENTERS, EACH, THINGS


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with a_viewer() as one:
        yield one


def texts_of(browser: Viewer) -> list[str]:
    return [result["text"] for result in browser.state()["results"]]


# --- what is each browser's own ---


def test_two_browsers_have_two_questions(viewer):
    one, other = Browser(viewer), Browser(viewer)
    asked = one.ask("red mug")
    assert texts_of(other) == []
    other.ask("blue mug; tall lamp")
    assert (texts_of(one), texts_of(other)) == (["red mug"], ["blue mug", "tall lamp"])
    assert one.state()["paint"] == asked["paint"]  # nothing to be fetched again
    np.testing.assert_array_equal(np.unique(one.arrays("/view/paint")["owner"]), [0, 1])
    np.testing.assert_array_equal(np.unique(other.arrays("/view/paint")["owner"]), [0, 1, 2])
    assert Browser(viewer).state()["results"] == []  # who comes later finds nobody's question
    assert texts_of(viewer) == []  # nor does a program


def test_thresholds_clicks_modes_and_classes_are_each_browsers_own(viewer):
    one, other = Browser(viewer), Browser(viewer)
    for browser in (one, other):
        browser.ask("red mug")
    one.do("threshold", query=0, value=2.0)
    one.do("mode", mode="heat map")
    assert one.do("click", **ray_to(viewer, CENTERS[2]))["clicked"]
    one.do("classify", text="mug, lamp")
    state = other.state()
    assert (state["mode"], state["clicked"], state["classes"]) == ("answer", None, None)
    assert state["results"][0]["num_matches"] == 1
    assert one.state()["results"][0]["num_matches"] == 0
    assert "click something" in other.refused("more_like_this")


def test_a_reload_keeps_what_was_asked(viewer):
    browser = Browser(viewer)
    browser.ask("red mug")
    cookie = browser.cookie
    browser.load()
    assert browser.cookie == cookie
    assert texts_of(browser) == ["red mug"]


def test_who_starts_the_viewer_asks_for_all_who_come():
    with a_viewer() as viewer:
        viewer.shared.begin("tall lamp")
        first, second = Browser(viewer), Browser(viewer)
        first.ask("red mug")
        assert (texts_of(first), texts_of(second)) == (["red mug"], ["tall lamp"])
        assert (texts_of(Browser(viewer)), texts_of(viewer)) == (["tall lamp"], ["tall lamp"])
        assert "tall lamp: 1 match" in second.state()["message"]
        with pytest.raises(InputError, match="one to 8"):
            viewer.shared.begin(";")


def test_each_browser_stands_at_its_own_time():
    with a_viewer(Session(passing_red_scene())) as viewer:
        one, other = Browser(viewer), Browser(viewer)
        before = other.get("/view/splats").content, other.state()["geometry"]
        one.do("time", at=1.0)
        assert (one.state()["time"]["at"], other.state()["time"]["at"]) == (1.0, 0.0)
        assert one.get("/view/splats").content != before[0]
        assert (other.get("/view/splats").content, other.state()["geometry"]) == before


def test_what_was_clicked_and_found_goes_with_the_next_question(viewer):
    ray = ray_to(viewer, CENTERS[2])
    viewer.do("click", **ray)
    assert viewer.ask("red mug")["clicked"] is None
    assert viewer.do("click", **ray)["clicked"]
    viewer.refused("ask", text=" ; ")
    state = viewer.state()
    assert (state["results"], state["clicked"], state["selection"]) == ([], None, 0)


# --- what all share ---


def test_edits_and_notes_of_one_are_there_for_all(viewer):
    one, other = Browser(viewer), Browser(viewer)
    before = other.ask("tall lamp")
    one.ask("red mug")
    one.do("annotate", text="here", at="selection")
    one.do("edit", change="remove")
    state = other.state()
    assert ([edit["what"] for edit in state["edits"]], len(state["annotations"])) == (["remove"], 1)
    assert state["geometry"] > before["geometry"]
    assert len(other.arrays("/view/splats")["opacity"]) == 3 * EACH + 60
    opacity = other.arrays("/view/splats")["opacity"]
    assert (opacity == 0).sum() >= EACH
    assert ([result["text"] for result in state["results"]], state["mode"]) == (["tall lamp"], "answer")
    assert other.do("undo")["edits"][0]["done"] is False
    assert one.state()["can_redo"]


def test_a_scene_that_one_opens_is_open_for_all_and_nothing_is_asked_of_it(viewer, tmp_path):
    from drsplat import write_gaussians

    one, other = Browser(viewer), Browser(viewer)
    before = other.ask("tall lamp")
    write_gaussians(tmp_path / "a.ply", random_gaussians(50))
    answer = one.post("/view/open?name=a.ply", (tmp_path / "a.ply").read_bytes())
    assert answer.status_code == 200, answer.text
    state = other.state()
    assert state["scene"] == answer.json()["scene"] == before["scene"] + 1
    assert (state["results"], state["selection"]) == ([], 0)
    assert len(other.arrays("/view/splats")["opacity"]) == 50


def test_a_browser_hears_of_its_own_questions_and_of_all_edits(viewer):
    one, other = Browser(viewer), Browser(viewer)

    async def heard() -> None:
        async with Stream(one) as own, Stream(other) as others:
            await own.event()
            await others.event()
            asked = await asyncio.to_thread(one.do, "ask", text="red mug")
            assert (await own.event())["revision"] == asked["revision"]
            edited = await asyncio.to_thread(one.do, "edit", change="remove")
            assert (await own.event())["revision"] == (await others.event())["revision"] == edited["revision"]

    asyncio.run(heard())


# --- bounds ---


def test_what_is_of_the_scenes_size_is_made_once_for_all(viewer, monkeypatch):
    made: list[int] = []
    painted = painting.feature_colors
    monkeypatch.setattr(painting, "feature_colors", lambda *given: made.append(1) or painted(*given))
    sessions = []
    for _ in range(3):
        browser = Browser(viewer)
        browser.arrays("/view/colors", mode="features")
        sessions.append(viewer.shared.visit.session)
    assert len({id(one) for one in sessions}) == 3
    assert len({id(one.shown) for one in sessions}) == len(made) == 1
    assert [one.num_bytes for one in sessions] == [0, 0, 0]
    assert len(viewer.shared._rows) <= 4


def test_only_the_page_makes_a_visit_and_forged_cookies_make_none(viewer):
    browser = Browser(viewer)
    name = browser.cookie.partition("=")[0]
    for value in ("x", "0" * 4000, "../../a", "%00"):
        browser.cookie = f"{name}={value}"
        for path in ("/view/state", "/view/header", "/view/paint", "/view/events"):
            assert "let go" in error_of(browser.get(path), 410)
        assert "let go" in browser.refused("ask", 410, text="red mug")
    assert len(viewer.shared.visits) == 1
    assert texts_of(viewer) == []
    browser.load()
    assert value not in browser.cookie
    assert browser.state()["results"] == []


def test_a_cookie_is_only_for_the_page_and_for_one_port(viewer):
    given = Browser(viewer).load()
    assert given.startswith("drsplat-visit-8080=")
    assert "httponly" in given.lower()
    assert "samesite=strict" in given.lower()
    assert len(given.partition("=")[2].partition(";")[0]) >= 24


def test_the_oldest_of_too_many_visits_goes(viewer, monkeypatch):
    monkeypatch.setattr(turns, "MAX_VISITS", 3)
    first, second, third = (Browser(viewer) for _ in range(3))
    first.ask("red mug")  # which makes the second one the oldest
    Browser(viewer)
    assert len(viewer.shared.visits) == 3
    assert second.get("/view/state").status_code == 410
    assert texts_of(first) == ["red mug"]
    assert third.get("/view/state").status_code == 200
    cookie = second.cookie
    second.load()
    assert second.cookie != cookie


def test_visits_that_nobody_comes_back_to_go(viewer, monkeypatch):
    gone = Browser(viewer)
    start = time.monotonic()
    monkeypatch.setattr(turns.time, "monotonic", lambda: start + turns.MAX_IDLE_S + 60)
    Browser(viewer)
    assert len(viewer.shared.visits) == 1
    assert gone.get("/view/state").status_code == 410


def test_answers_of_all_browsers_have_one_bound(viewer, monkeypatch):
    browsers = [Browser(viewer) for _ in range(4)]
    browsers[0].ask("red mug")
    size = viewer.session.num_bytes
    result = viewer.session.results[0]
    arrays = (result.answer.values, result.answer.scores, result.gaussian_ids)
    assert size >= sum(array.nbytes for array in arrays) > 0
    monkeypatch.setattr(turns, "MAX_ANSWER_BYTES", 3 * size)
    for browser in browsers[1:]:
        browser.ask("red mug")
    browsers[3].state()
    assert browsers[0].get("/view/state").status_code == 410
    assert [texts_of(browser) for browser in browsers[1:]] == [["red mug"]] * 3
    monkeypatch.setattr(turns, "MAX_ANSWER_BYTES", 1)
    browsers[1].ask("red mug; tall lamp")
    assert texts_of(browsers[1]) == ["red mug", "tall lamp"]  # the one that asks keeps its own
    assert len(viewer.shared.visits) == 1


def test_the_classes_of_a_browser_hold_a_label_per_gaussian_and_no_answers(viewer):
    viewer.do("classify", text=", ".join(THINGS))
    assert viewer.session.num_bytes >= viewer.session.segmentation.labels.nbytes
    assert viewer.session.segmentation.answers == []


def test_nothing_is_kept_of_thresholds_that_were_dragged(viewer):
    browser = Browser(viewer)
    browser.ask("red mug")
    for number in range(5):
        browser.post("/view/do", {"act": "threshold", "query": number, "value": 0.5})
    assert viewer.lanes.quick._latest == {}
