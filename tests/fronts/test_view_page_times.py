"""A page of a scene that moves: what it holds, how much at most, and time in a real browser, on desk and phone."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from browsing import PANEL, a_page, eventually, near, needs_chromium, opened, pixels_of, settled
from drsplat import Scene, export_page
from drsplat.authoring.editing import Edit, Everything, Move
from drsplat.errors import InputError
from drsplat.fronts.viewing import page as pages
from drsplat.fronts.viewing.page import boxes_of, times_of_page
from drsplat.fronts.viewing.session import Session
from drsplat.scene.moving import Moving
from moving_scenes import passing_red_scene
from page_files import read_page

UP = np.array([0.0, 0, 1])
CAR = np.arange(100)
SIZES = {"desk": (1000, 700), "hand": (390, 844)}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return passing_red_scene()


@pytest.fixture(scope="module")
def exported(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("page") / "page.html"
    export_page(page, scene, ["red car", "white vase"], up=UP)
    return page


def test_a_page_has_what_moves_at_all_times(exported, scene):
    header, arrays = read_page(exported)
    clock = header["clock"]
    assert clock["at"] == scene.moving.times.tolist()
    assert clock["count"] == len(CAR)
    assert "100 of them move, at 6 times." in header["about"]
    places = np.cumsum(arrays["places"].reshape(6, 100, 3), axis=0, dtype=np.uint16)
    frame = Session(scene).shown.frame
    for number, time in enumerate(clock["at"]):
        there = frame.world(np.array(clock["low"]) + np.array(clock["step"]) * places[number])
        assert_allclose(there, scene.moving.at(time).means[CAR], atol=1e-3)
    turns = np.cumsum(arrays["turns"].view(np.uint16).reshape(6, 600), axis=0, dtype=np.uint16).view(np.float16)
    assert (turns == turns[0]).all()
    fades = np.cumsum(arrays["fades"].reshape(6, 100), axis=0, dtype=np.uint8)
    assert (fades == fades[0]).all()
    owners = arrays["owner0"]  # in the same order as all else
    assert owners[:100].any()
    assert not owners[100:].any()


def test_boxes_go_along(exported, scene):
    header, _ = read_page(exported)
    (car,), (vase,) = (answer["matches"] for answer in header["answers"])
    assert vase["boxes"] == []
    centers = Session(scene).shown.frame.world(np.array(car["boxes"])[:, :3])
    assert_allclose(np.diff(centers[:, 1]), 0.4, atol=1e-3)
    assert sum(bool(one["boxes"]) for one in header["objects"]) == 1


def test_what_stands_still_has_no_times(scene, tmp_path):
    export_page(tmp_path / "page.html", scene.at(0.5), ["red car"], up=UP)
    header, arrays = read_page(tmp_path / "page.html")
    assert header["clock"] is None
    assert "places" not in arrays
    assert times_of_page(Session(scene.at(0.5))) is None
    assert boxes_of(Session(scene.at(0.5)), None, scene.objects) == [[], [], []]


def test_a_large_film_is_thinned_or_refused(scene, monkeypatch, tmp_path):
    monkeypatch.setattr(pages, "MIN_TIMES", 3)
    monkeypatch.setattr(pages, "MAX_MOVED_PLACES", 399)
    found = times_of_page(Session(scene))
    assert found.times.tolist() == pytest.approx([0, 0.4, 1])
    assert found.summary == "100 of them move, at 3 of 6 times."
    monkeypatch.setattr(pages, "MAX_MOVED_PLACES", 250)
    with pytest.raises(InputError, match=r"100 of the 300 Gaussians shown move.*room for 83 at 3 times.*max_gaussians"):
        export_page(tmp_path / "page.html", scene, ["red car"], up=UP)
    assert not list(tmp_path.iterdir())


def test_edits_move_along(scene):
    session = Session(scene)
    before = times_of_page(session)
    session.edits.add(Edit(Everything(), Move((0.0, 0.0, 1.0))))
    after = times_of_page(session)
    assert after.low - before.low == pytest.approx([0, 0, session.shown.frame.scale], abs=1e-3)
    assert_allclose(after.step, before.step, rtol=1e-3)


def test_what_comes_and_goes_moves(scene):
    """What fades stays where it is; what cannot be seen at a time may be anywhere then."""
    moving = scene.moving

    class Fading:
        def at(self, time: float) -> Any:
            still = moving.at(0.0)
            opacities, means = still.opacities.copy(), still.means.copy()
            opacities[:10], opacities[10:20] = (1 - time) * 0.9, 0.9 if time == 0 else 0
            means[10:20] += np.float32(1e6 * time)
            return replace(still, opacities=opacities, means=means)

    film = Moving(moving.canonical, moving.times, Fading())
    found = times_of_page(Session(Scene(scene.field, film, scene.views)))
    assert sorted(found.order[: found.opacities.shape[1]]) == list(range(20))
    assert np.abs(found.step).max() < 1e-2
    assert found.opacities[-1].max() == 0


# --- in a browser ---


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_time_is_pulled_and_plays(exported, scene, size, chromium):
    """The red car is where it is at the first time, then at the last, halfway between two, and then moves by itself."""
    frame = Session(scene).shown.frame

    def redness(page: Any, y: float) -> float:
        settled(page)
        x, y, _ = page.evaluate("(at) => drsplat.camera.project(at)", frame.shown(np.array([0.0, y, 0.2])).tolist())
        left = 0 if size[0] < 760 else PANEL
        part = near(pixels_of(page, size[0]), (left + x, y), 5)
        return float((part[..., 0] - part[..., 1]).max(initial=0))

    with a_page(chromium, *size) as page:
        opened(page, exported.as_uri())
        page.locator("#tab-film").click()
        look = [frame.shown(np.array(place)).tolist() for place in ((5.0, 0, 1.5), (0.0, 0, 0))]
        page.evaluate("(at) => drsplat.camera.stand(...at)", look)
        eventually(lambda: redness(page, -1) > 0.3 > redness(page, 1))
        page.locator("#time").fill("1000")
        eventually(lambda: redness(page, 1) > 0.3 > redness(page, -1))
        assert page.locator("#now").inner_text() == "1"
        page.locator("#time").fill("500")
        eventually(lambda: redness(page, 0) > 0.3 > redness(page, 1))
        center = page.evaluate("() => drsplat.header.answers[0].matches[0].center")
        assert abs(frame.world(np.array(center))[1]) < 0.05
        page.evaluate(
            "() => { const c = drsplat.camera, [x, y] = c.project(drsplat.header.answers[0].matches[0].center);"
            " void drsplat.act({ act: 'click', origin: c.eye, direction: c.ray(x, y) }); }"
        )
        eventually(lambda: page.evaluate("() => drsplat.state.chosen !== null"))
        page.locator("#run").click()
        times: set[str] = set()
        eventually(lambda: times.add(page.locator("#now").inner_text()) or len(times) > 3)
        assert page.evaluate("() => drsplat.moves.isRunning")
        page.locator("#run").click()
        assert not page.evaluate("() => drsplat.moves.isRunning")
        page.evaluate("() => drsplat.film.at(1)")  # a film goes from the first time to the last
        assert page.locator("#now").inner_text() == "1"
