"""The client before a running viewer, in a real browser: what a person does, seen in the session and in pixels."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from browsing import PANEL, a_page, colorfulness, eventually, near, needs_chromium, opened, pixels_of, settled
from clients import served
from drsplat.authoring.editing import Duplicate
from drsplat.fronts.viewing.exporting import export_page
from drsplat.fronts.viewing.session import Mode, Session
from drsplat.fronts.viewing.stage import Stage
from drsplat.query import Scene, open_scene
from drsplat.scene.labelled import Annotation

pytestmark = [needs_chromium, pytest.mark.slow]
SIZES = {"desk": (1100, 700), "hand": (390, 844)}
UP = np.array([0.0, 0, 1])


@pytest.fixture
def session(room: Path) -> Session:
    return Session(open_scene(room / "room.field", scene=room / "scene.ply", views=room / "capture"))


def wait_for(page: Any, condition: str) -> None:
    page.wait_for_function(f"() => {condition}")
    settled(page)


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_ask_remove_undo(session, size, chromium):
    with served(session) as address, a_page(chromium, *size) as page:
        opened(page, address)
        page.locator("#query").fill("red mug")
        page.locator("#ask").click()
        wait_for(page, "drsplat.state.results.length === 1 && drsplat.state.results[0].matches.length")
        left = PANEL if size[0] > 760 else 0
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.state.results[0].matches[0].center)")
        there = near(pixels_of(page, size[0]), (left + x, y), 5)
        assert (there[..., 0] - there[..., 1]).mean() > 0.2  # the red ball, in its own colour
        page.locator("#tab-edit").click()
        page.get_by_role("button", name="Remove", exact=True).click()
        wait_for(page, "drsplat.state.edits.length === 1")
        assert session.edits.listed.done == 1
        gone = near(pixels_of(page, size[0]), (left + x, y), 5)
        assert (gone[..., 0] - gone[..., 1]).mean() < 0.1
        page.get_by_role("button", name="Undo").click()
        wait_for(page, "!drsplat.state.can_undo")
        assert session.edits.listed.done == 0
        back = near(pixels_of(page, size[0]), (left + x, y), 5)
        assert_allclose(back.mean((0, 1)), there.mean((0, 1)), atol=0.05)


def test_a_scene_comes_in_pieces_and_is_whole_with_its_answer(session, chromium, monkeypatch):
    monkeypatch.setattr("drsplat.fronts.viewing.live.arrays.PIECE_ROWS", len(session.scene.gaussians) // 7)
    session.ask("red mug")
    with served(session) as address, a_page(chromium) as page:
        opened(page, address)
        wait_for(page, "drsplat.isWhole")
        assert page.evaluate("() => drsplat.splats.count") == len(session.scene.gaussians)
        owned = page.evaluate("() => [drsplat.paint.owner.length, drsplat.paint.owner.filter((one) => one).length]")
        assert owned == [len(session.scene.gaussians), len(session.results[0].gaussian_ids)]


def test_every_object_has_the_colour_that_saved_pictures_have(session, chromium):
    with served(session) as address, a_page(chromium) as page:
        opened(page, address)
        page.evaluate("() => drsplat.act({ act: 'mode', mode: 'objects' })")
        wait_for(page, "drsplat.state.mode === 'objects'")
        shown = page.evaluate("() => [[...drsplat.stage.rgba], [...drsplat.paint.object]]")
    rgba, numbers = np.array(shown[0]).reshape(-1, 4), np.array(shown[1])
    rows = session.drawn.ids[Stage.of(session, UP).order]
    assert set(numbers) == {1, 2}
    session.mode = Mode.OBJECTS
    own = session.drawn_colors[rows] * 255
    assert_allclose(rgba[numbers > 0, :3], own[numbers > 0], atol=2)  # bytes are cut off on both ways


def test_a_click_takes_the_place_of_the_query_and_can_be_named(session, chromium):
    with served(session) as address, a_page(chromium, *SIZES["desk"]) as page:
        opened(page, address)
        page.locator("#query").fill(";")
        page.locator("#ask").click()
        wait_for(page, "document.querySelector('#message').className === 'fault'")
        page.evaluate("() => { const o = drsplat.header.objects[0]; drsplat.camera.stand(o.eye, o.center); }")
        settled(page)
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.header.objects[0].center)")
        page.mouse.click(PANEL + x, y)
        wait_for(page, "drsplat.state.chosen !== null")
        assert page.locator("#message").is_hidden()  # what was said of the query is gone with it
        assert page.locator("#query").input_value() == page.evaluate("() => drsplat.state.chosen.name")
        page.get_by_label("Name of this object").fill("my ball")
        page.get_by_role("button", name="Keep").click()
        wait_for(page, "drsplat.state.chosen.name.includes('my ball')")
        assert "my ball" in session.scene.label_file.path.read_text()


def test_a_lasso_selects_what_is_inside_and_takes_a_note(session, chromium):
    with served(session) as address, a_page(chromium, *SIZES["desk"]) as page:
        opened(page, address)
        page.evaluate("() => { const o = drsplat.header.objects[0]; drsplat.camera.stand(o.eye, o.center); }")
        settled(page)
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.header.objects[0].center)")
        page.locator("#tab-edit").click()
        page.get_by_role("button", name="Box", exact=True).click()
        page.mouse.move(PANEL + x - 200, y - 200)
        page.mouse.down()
        page.mouse.move(PANEL + x, y, steps=3)
        page.mouse.move(PANEL + x + 200, y + 200, steps=3)
        page.mouse.up()
        wait_for(page, "drsplat.state.selection > 10")
        rows = session.drawn.ids[Stage.of(session, UP).order]
        selected = rows[np.array(page.evaluate("() => [...drsplat.paint.owner]")) > 0]
        inside = np.isin(selected, session.scene.objects[0].gaussian_ids)
        assert inside.mean() > 0.8
        page.get_by_text("Annotations").click()
        page.get_by_label("Text of the annotation").fill("look here")
        page.get_by_role("button", name="At the selection").click()
        wait_for(page, "drsplat.state.annotations.length === 1")
        assert [one.text for one in session.edits.annotations] == ["look here"]


def ask(page: Any, text: str) -> None:
    page.locator("#query").fill(text)
    page.locator("#ask").click()
    settled(page)


def test_two_browsers_have_their_own_questions_and_share_edits(session, chromium):
    with served(session) as address, a_page(chromium) as one, a_page(chromium) as other:
        for page in (one, other):
            opened(page, address)
        ask(one, "blue plate")
        ask(other, "red mug")
        assert [page.evaluate("() => drsplat.state.asked.join()") for page in (one, other)] == ["blue plate", "red mug"]
        other.locator("#tab-edit").click()
        assert "everyone who has this viewer open sees them" in other.locator("#shared").inner_text()
        other.get_by_role("button", name="Remove", exact=True).click()
        wait_for(one, "drsplat.state.edits.length === 1")
        assert one.locator("#query").input_value() == "blue plate"
        assert one.evaluate("() => drsplat.splats.opacity.filter((one) => one === 0).length") > 10


def test_a_new_question_takes_the_card_of_a_click_and_an_error_with_it(session, chromium):
    with served(session) as address, a_page(chromium, *SIZES["desk"]) as page:
        opened(page, address)
        page.evaluate("() => { const o = drsplat.header.objects[0]; drsplat.camera.stand(o.eye, o.center); }")
        settled(page)
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.header.objects[0].center)")
        page.mouse.click(PANEL + x, y)
        wait_for(page, "drsplat.state.clicked !== null")
        assert page.locator("#what").count() == 1
        ask(page, "blue plate")
        assert page.locator("#what").count() == 0
        ask(page, ";")
        assert page.locator("#message.fault").is_visible()
        wait_for(page, "drsplat.state.results.length === 0")  # the plate is no answer to that
        assert page.locator("#query").input_value() == ";"
        page.locator("#tab-film").click()
        assert page.locator("#message").is_hidden()


def test_no_match_offers_words_that_do_and_a_switch(session, chromium):
    with served(session) as address, a_page(chromium, *SIZES["hand"]) as page:
        opened(page, address)
        ask(page, "elephant")
        assert "The best place has a" in page.locator("#content").inner_text()
        word = page.locator(".instead button").first.inner_text()
        page.get_by_label("I know it is there").check()
        wait_for(page, "drsplat.state.present")
        page.locator(".instead button").first.click()
        wait_for(page, f"drsplat.state.asked.join() === '{word}' && drsplat.state.selection > 0")
        assert not page.get_by_label("I know it is there").is_checked()


def test_a_shared_link_keeps_question_threshold_and_camera(session, chromium):
    with served(session) as address, a_page(chromium) as one, a_page(chromium) as other:
        opened(one, address)
        ask(one, "red mug; blue plate")
        one.evaluate("() => drsplat.act({ act: 'threshold', query: 1, value: 0.875 })")
        one.evaluate("() => drsplat.camera.turn(0.5, 0.1)")
        settled(one)
        one.locator("#share").click()
        one.wait_for_function("() => location.hash.includes('cut=')")
        opened(other, one.evaluate("() => location.href"))
        shown = "() => [drsplat.state.asked, drsplat.state.results.map((one) => one.threshold)]"
        assert other.evaluate(shown) == one.evaluate(shown)
        eyes = [page.evaluate("() => drsplat.camera.eye") for page in (one, other)]
        assert_allclose(eyes[0], eyes[1], atol=2e-3)


def test_a_page_that_was_let_go_asks_again(session, chromium, monkeypatch):
    with served(session) as address, a_page(chromium) as page, a_page(chromium) as other:
        opened(page, address)
        ask(page, "red mug")
        monkeypatch.setattr("drsplat.fronts.viewing.live.turns.MAX_VISITS", 1)
        opened(other, address)
        page.evaluate("() => { void drsplat.act({ act: 'mode', mode: 'heat map' }); }")
        page.wait_for_function(
            "() => window.drsplat && drsplat.state.asked.join() === 'red mug' && drsplat.state.mode === 'answer'"
        )
        assert page.evaluate("() => performance.getEntriesByType('navigation')[0].type") == "reload"


def test_pictures_of_objects_stay_while_objects_are_chosen(session, chromium):
    with served(session) as address, a_page(chromium, *SIZES["desk"]) as page:
        opened(page, address)
        page.locator("#tab-objects").click()
        whole = "[...document.querySelectorAll('.thing img')].every((one) => one.complete && one.naturalWidth)"
        page.wait_for_function(f"() => {whole}")
        page.locator(".thing").first.click()
        wait_for(page, "drsplat.state.chosen !== null")
        assert page.locator(".thing img").count() == 2
        assert page.evaluate(f"() => {{ drsplat.render(); return {whole}; }}")  # at once, not fetched again


def test_a_file_that_is_dropped_is_opened(session, room, chromium):
    with served(session) as address, a_page(chromium) as page:
        opened(page, address)
        page.locator("#scene-file").set_input_files(room / "scene.ply")
        page.wait_for_function("() => window.drsplat && !drsplat.header.can.ask && drsplat.stage.frames > 0")
        assert not page.locator("#prompt").is_visible()
        assert page.evaluate("() => drsplat.splats.count") == len(session.scene.gaussians)


def test_labels_of_one_place_do_not_cover_each_other(session, chromium):
    for word in ("one", "two", "three"):
        session.edits.annotate(Annotation.at(word, (0.0, 0.0, 0.6)))
    with served(session) as address, a_page(chromium, *SIZES["desk"]) as page:
        opened(page, address)
        page.evaluate("() => { const n = drsplat.state.annotations[0]; drsplat.camera.stand(n.eye, n.center); }")
        settled(page)
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.state.annotations[0].center)")
        column = "([x, y]) => document.querySelector('#labels').getContext('2d').getImageData(x, 0, 1, y).data.join()"
        alpha = np.array(page.evaluate(column, [x - 12, y]).split(","), int)[3::4] > 200
        assert np.count_nonzero(np.diff(alpha.astype(int)) == 1) == 3  # three plates, with room between


def test_key_frames_make_a_path_that_is_saved(session, chromium):
    with served(session) as address, a_page(chromium) as page:
        opened(page, address)
        page.keyboard.press("k")
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("k")
        page.locator("#tab-film").click()
        assert "2 key frames" in page.locator("#content").inner_text()
        page.get_by_text("Save or load").click()
        with page.expect_download() as download:
            page.get_by_role("button", name="Save the path").click()
        assert "keyframes" in Path(download.value.path()).read_text().replace("_", "")


def is_noted(pixels: np.ndarray) -> bool:
    """Whether the colour of annotations is there."""
    return bool((np.abs(pixels - np.array([255, 224, 130]) / 255).max(axis=-1) < 0.06).any())


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_page_lists_objects_and_draws_annotations(session, size, chromium, tmp_path):
    session.ask("red mug")
    session.edit(Duplicate((0.0, 0.0, 1.0)))
    session.edits.annotate(Annotation.at("here", (0.0, 0.0, 0.6)))
    export_page(tmp_path / "page.html", session.scene, ["blue plate"], up=UP)
    with a_page(chromium, *size) as page:
        opened(page, (tmp_path / "page.html").as_uri())
        left = PANEL if size[0] > 760 else 0
        page.evaluate(
            "() => { const note = drsplat.state.annotations[0]; drsplat.camera.stand(note.eye, note.center); }"
        )
        settled(page)
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.state.annotations[0].center)")
        assert is_noted(near(pixels_of(page, size[0]), (left + x, y), 20))
        page.locator("#tab-objects").click()
        thing = page.locator(".thing").first
        assert thing.locator("img").get_attribute("src").startswith("data:image/jpeg;base64,")
        thing.click()
        eventually(lambda: page.locator(".thing").first.get_attribute("aria-pressed") == "true")
        target = page.evaluate("() => drsplat.header.objects[0].center")
        eventually(lambda: np.allclose(page.evaluate("() => drsplat.camera.target"), target, atol=1e-3))
        settled(page)
        x, y, depth = page.evaluate("() => drsplat.camera.project(drsplat.header.objects[0].center)")
        assert depth > 0
        assert colorfulness(near(pixels_of(page, size[0]), (left + x, y), 8)).mean() > 0.3  # in its own colour
        page.locator(".thing").first.click()
        eventually(lambda: page.locator(".thing").first.get_attribute("aria-pressed") == "false")
        box = page.locator(".thing").first.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size[0]


def test_a_page_has_what_photos_agree_less_on_behind_more(session, chromium, tmp_path):
    field = session.scene.field
    sure = field.objects.sure.copy()
    sure[field.objects.thing(0)] = 0.01
    doubted = Scene(field.with_objects(replace(field.objects, sure=sure)), session.scene.gaussians, session.scene.views)
    export_page(tmp_path / "page.html", doubted, ["blue plate"], up=UP)
    with a_page(chromium, *SIZES["desk"]) as page:
        opened(page, (tmp_path / "page.html").as_uri())
        page.locator("#tab-objects").click()
        hidden = page.get_by_role("button", name="object 0")
        assert page.get_by_role("button", name="object 1").is_visible()
        assert not hidden.is_visible()
        page.get_by_text("1 more, that photos agree less on").click()
        hidden.click()
        wait_for(page, "drsplat.state.chosen !== null && drsplat.state.chosen.number === 0")
