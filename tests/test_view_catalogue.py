"""Many scenes in the viewer: what is pressed, and in a real browser."""

import re
import shutil
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from browsing import a_browser, a_page, eventually, needs_chromium
from catalogued import boxes_of, write_scene
from command_line import Capture, error_of
from drsplat import read_gaussians
from test_catalogue import WORDS

pytest.importorskip("lancedb", reason="the extra drsplat[catalogue] is not installed")
pytest.importorskip("viser", reason="the extra drsplat[viewer] is not installed")

from drsplat.catalogue import Catalogue
from drsplat.viewing.catalogue_page import CataloguePage

CAMERA = SimpleNamespace(position=(0.0, 0.0, 1.0), look_at=(0.0, 0.0, 0.0), up_direction=None)
PRESS = SimpleNamespace(
    client=SimpleNamespace(camera=CAMERA, atomic=nullcontext, flush=lambda: None), client_id=7,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("many")
    catalogue = Catalogue.open(made / "flats.catalogue")
    for number, (name, words) in enumerate(WORDS.items()):
        catalogue.add(write_scene(made / name, words, moved=10.0 * number))
    return made


@pytest.fixture
def page(folder: Path) -> Iterator[CataloguePage]:
    made = CataloguePage(Catalogue.open(folder / "flats.catalogue"), port=8960)
    yield made
    made.stop()


def asked(page: CataloguePage, text: str) -> list[str]:
    """The labels of the buttons that are shown."""
    page.ask(text)
    assert page.actions.settled(60.0)
    return [button.label for _, button in page._rows if button.visible]


def opened(page: CataloguePage, number: int) -> Any:
    page._do("open", lambda: page._open(PRESS, number))
    assert page.actions.settled(60.0)
    assert page.panel is not None
    assert page.panel.actions.settled(60.0)
    return page.panel


def test_answers_have_thumbnails(page: CataloguePage) -> None:
    labels = asked(page, "mug")
    assert [label.rpartition(" · ")[2] for label in labels] == ["kitchen", "o'hara"]
    pictures = [image.image for image, _ in page._rows if image.visible]
    assert [picture.shape for picture in pictures] == [(180, 240, 3)] * 2
    assert asked(page, "elephant") == []
    assert "0 matches" in page.told.content
    asked(page, "point, not")
    assert "expected words and their exclusions" in page.told.content


def test_a_press_opens_the_scene_at_the_object(page: CataloguePage, folder: Path) -> None:
    asked(page, "mug")
    panel = opened(page, 1)
    session = panel.session
    assert session.scene.name == "o'hara"
    np.testing.assert_array_equal(session.selection, session.scene.objects[0].gaussian_ids)
    assert opened(page, 1) is panel  # it is there already
    other = opened(page, 0)
    assert (other is not panel, other.session.scene.name) == (True, "kitchen")
    assert sum(node.startswith("/scene") for node in page.server.scene._handle_from_node_name) == 1


def test_a_scene_that_changed_or_went_is_told(page: CataloguePage, folder: Path) -> None:
    gaussians = read_gaussians(folder / "kitchen/scene.ply")
    shutil.copytree(folder / "kitchen/a.field", folder / "before")
    asked(page, "red mug")
    boxes_of(("red bowl", "red rug", "red sofa"), gaussians).save(folder / "kitchen/a.field", overwrite=True)
    try:
        opened(page, 0)
        assert "has changed since" in page.told.content
        (folder / "kitchen").rename(folder / "gone")
        page._opened = ("", "")
        page._do("open", lambda: page._open(PRESS, 0))
        assert page.actions.settled(60.0)
        assert "where nothing is any more" in page.told.content
    finally:
        (folder / "gone").rename(folder / "kitchen")
        shutil.rmtree(folder / "kitchen/a.field")
        (folder / "before").rename(folder / "kitchen/a.field")


def test_the_command_line(folder: Path, capsys: Capture) -> None:
    assert "expected a scene, or --catalogue" in error_of(capsys, "view")
    assert "expected a scene, or --catalogue" in error_of(capsys, "view", folder, "--catalogue", folder)
    said = error_of(capsys, "view", "--catalogue", folder / "flats.catalogue", "--up", "+z")
    assert "--up is of one scene" in said
    assert "no catalogue is here" in error_of(capsys, "view", "--catalogue", folder / "none")


@needs_chromium
@pytest.mark.slow
def test_in_a_browser(folder: Path) -> None:
    """Typed, and pressed: the scene appears, its object is selected, and the camera stands before it."""
    made = CataloguePage(Catalogue.open(folder / "flats.catalogue"), port=8970)
    try:
        with a_browser() as browser, a_page(browser) as page:
            page.goto(made.served.address)
            box = page.locator("textarea").first
            box.fill("white lamp")
            box.press("End")
            box.press("Enter")
            button = page.get_by_role("button", name=re.compile("o'hara")).first
            button.wait_for()
            assert page.locator("img").count() >= 1
            button.click()
            eventually(lambda: made.panel is not None and len(made.panel.session.results) == 1)
            assert made.panel is not None
            window = made.panel.window
            client = next(iter(made.server.get_clients().values()))
            target = made.entries[0].center
            eventually(
                lambda: bool(
                    np.linalg.norm(window.session.shown.frame.world(np.array(client.camera.look_at)) - target) < 0.05
                )
            )
            page.get_by_text("object 2").first.wait_for()
    finally:
        made.stop()
