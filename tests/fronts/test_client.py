"""The client that pages and the viewer share: built from what lies in web/, readable, and a picture like ours."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

from browsing import PANEL, a_page, colorfulness, eventually, near, needs_chromium, opened, pixels_of, settled
from drsplat import open_scene, read_gaussians
from drsplat.authoring.filming.looking import looking_at
from drsplat.drawing.rendering import render
from drsplat.fronts.viewing.client import client_file
from drsplat.fronts.viewing.exporting import export_page
from drsplat.fronts.viewing.session import Session
from drsplat.query.objects import objects_of
from glb_files import Read
from viewing_scenes import THINGS, boxes_scene

WEB = Path(__file__).resolve().parents[2] / "web"
SIZE = (1000, 620)
UP = np.array([0.0, 0, 1])
CARD = "WebGL2RenderingContext.prototype.getExtension = () => null;"  # nobody then says that a processor draws


def test_the_client_was_built_from_the_sources_that_are_here():
    names = sorted(path.relative_to(WEB).as_posix() for path in (WEB / "src").rglob("*") if path.is_file())
    digest = hashlib.sha256()
    for name in (*names, "build.mjs", "package.json"):
        digest.update(f"{name}\n".encode() + (WEB / name).read_bytes())
    assert f"sources: {digest.hexdigest()}" in client_file("client.js"), "run: npm run build --prefix web"


def luminance(color: str) -> float:
    parts = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


def contrast(one: str, other: str) -> float:
    """WCAG 2.2, contrast ratio."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("look", [":root", ':root[data-look="light"]'])
def test_what_is_read_has_contrast_enough(look):
    """WCAG 2.2 AA: 4.5 for text, 3 for the borders of what is typed into."""
    rule = re.search(re.escape(look) + r" \{(.*?)\}", client_file("client.css"))
    colors = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", rule[1]))
    for ground in ("paper", "raised"):
        for ink in ("ink", "faint", "fault"):
            assert contrast(colors[ink], colors[ground]) >= 4.5, (ink, ground)
        for line in ("edge", "mark"):
            assert contrast(colors[line], colors[ground]) >= 3, (line, ground)
    assert contrast(colors["on-mark"], colors["mark"]) >= 4.5


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    page = tmp_path_factory.mktemp("page") / "page.html"
    export_page(page, boxes_scene(), ["red mug", "tall lamp", "elephant"], words=THINGS, title="A <room>", up=UP)
    return page


@needs_chromium
@pytest.mark.parametrize("drawer", ["processor", "card"])
def test_the_client_draws_what_the_renderer_draws(exported, chromium, drawer):
    """Of the same camera and the same background, but for 8 bits, SPZ's precision and the sort's 65,536 depths."""
    scene = boxes_scene()
    frame, size = Session(scene).shown.frame, (SIZE[0] - PANEL, SIZE[1])
    eye, target = np.array([1.5, -4.0, 2.0]), np.array([0.0, 0.0, 0.3])
    view = looking_at(eye, target, UP, size, 55.0)
    with a_page(chromium, *SIZE) as page:
        if drawer == "card":
            page.add_init_script(
                CARD + "const own = WebGL2RenderingContext.prototype.getParameter; "
                "WebGL2RenderingContext.prototype.getParameter = function (what) {"
                " return what === 7937 ? 'a card' : own.call(this, what); };"
            )
        opened(page, exported.as_uri())
        assert page.evaluate("() => drsplat.stage.drawer") == drawer
        page.evaluate("() => drsplat.act({ act: 'clear' })")
        place = [frame.shown(one).tolist() for one in (eye, target)]
        page.evaluate("(at) => { drsplat.stage.background = [0, 0, 0]; drsplat.camera.stand(...at); }", place)
        page.add_style_tag(content="#tools, #labels { display: none !important; }")
        settled(page)
        drawn = pixels_of(page, SIZE[0])[:, PANEL:]
    gaussians = scene.gaussians
    flat = type(gaussians)(gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh[:, :1])
    own = np.clip(render(flat, view).rgb, 0, 1)
    error = np.abs(drawn - own)
    assert own.max() > 0.5
    psnr = -10 * np.log10((error**2).mean())
    assert psnr > 48, psnr  # 50.2 of both ways of drawing


@needs_chromium
def test_a_page_gives_its_scene_as_glb_with_named_objects(room, tmp_path, chromium):
    """Read by the specifications alone, and by our own reader."""
    scene = open_scene(room / "room.field", scene=room / "scene.ply")
    gaussians = scene.gaussians
    scene.label(objects_of(scene.field).thing(1), "plate </script> 😀")
    export_page(tmp_path / "page.html", scene, ["red mug"], up=UP)
    with a_page(chromium, *SIZE) as page:
        opened(page, (tmp_path / "page.html").as_uri())
        with page.expect_download() as download:
            page.evaluate("() => document.getElementById('take-glb').click()")
        download.value.save_as(tmp_path / "scene.glb")
    file = Read.of((tmp_path / "scene.glb").read_bytes())
    table = file.table(0)
    assert table["number"] == list(range(len(scene.objects)))
    assert table["name"][1] == "plate </script> 😀"
    assert table["num_gaussians"] == [len(match) for match in scene.objects]
    for match, center, extent in zip(scene.objects, table["center"], table["extent"], strict=True):
        assert_allclose(center, match.center, atol=1e-3)
        assert_allclose(extent, match.extent, atol=1e-3)
    read = read_gaussians(tmp_path / "scene.glb")
    nearest = cKDTree(read.means).query(gaussians.means)[1]  # a page has rows in order of significance
    assert_allclose(read.means[nearest], gaussians.means, atol=1e-4)
    assert_allclose(read.opacities[nearest], gaussians.opacities, atol=1 / 255)
    assert_array_equal(read.extra["object_id"][nearest], scene.object_ids())


@pytest.mark.slow
@needs_chromium
def test_a_picture_with_little_room_has_what_looks_most_significant_there(exported, chromium):
    """Of what a camera does not see nothing is drawn, so that there is room for all that it does see."""
    room = "(share) => { Object.defineProperty(drsplat.stage, 'limit', { configurable: true, get: () => share }); }"
    with a_page(chromium, *SIZE) as page:
        opened(page, exported.as_uri())
        page.evaluate("() => drsplat.act({ act: 'clear' })")
        page.add_style_tag(content="#tools, #labels { display: none !important; }")
        pictures = {}
        for rows in (960, 480, 100):
            page.evaluate(room, rows)
            page.evaluate("() => drsplat.camera.nearer(1)")
            settled(page)
            pictures[rows] = pixels_of(page, SIZE[0])[:, PANEL:]
    seen = pictures[960]
    assert np.ptp(seen) > 0.3
    assert_array_equal(pictures[480], seen)  # this camera is before one of three things
    error = ((pictures[100] - seen) ** 2).mean()
    assert 0 < error < 0.02


@needs_chromium
def test_a_page_asks_nobody_names_itself_and_tells_what_is_there(exported, chromium):
    with a_page(chromium, *SIZE) as page:
        requests: list[str] = []
        page.on("request", lambda request: requests.append(request.url))
        opened(page, exported.as_uri())
        assert page.title() == "A <room>"
        assert page.locator("h1").inner_text() == "A <room>"
        assert page.locator("#query").input_value() == "red mug"
        page.locator("#query").fill("elephant")
        page.locator("#ask").click()
        eventually(lambda: "No match for “elephant”. The best place" in page.locator("#content").inner_text())
        settled(page)
        nothing = pixels_of(page, SIZE[0])[:600, PANEL:]
        page.locator("#colours").select_option("as it is")
        settled(page)
        assert_array_equal(nothing[:500], pixels_of(page, SIZE[0])[:500, PANEL:])  # nothing is dimmed
        page.locator("#query").fill("quagga")
        page.locator("#ask").click()
        eventually(lambda: "does not know “quagga”" in page.locator("#message").inner_text())
        page.locator("#query").fill("tall lamp")
        page.locator("#ask").click()
        eventually(lambda: page.locator("#message").is_hidden())  # what was said goes with the next act
        outside = [url for url in requests if not url.startswith(("file:", "blob:", "data:"))]
        assert outside == []


@needs_chromium
def test_an_answer_keeps_its_colours_and_the_rest_is_dimmed(exported, chromium):
    with a_page(chromium, *SIZE) as page:
        opened(page, exported.as_uri())
        at = "() => drsplat.camera.project(drsplat.state.results[0].matches[0].center)"
        x, y, depth = page.evaluate(at)
        assert depth > 0
        assert (x, y) == pytest.approx(((SIZE[0] - PANEL) / 2, SIZE[1] / 2), abs=2)  # opened at its first match
        asked = near(pixels_of(page, SIZE[0]), (PANEL + x, y))
        page.locator("#colours").select_option("as it is")
        settled(page)
        plain = near(pixels_of(page, SIZE[0]), (PANEL + x, y))
        assert_allclose(asked.mean((0, 1)), plain.mean((0, 1)), atol=0.03)
        page.locator("#query").fill("tall lamp")
        page.locator("#ask").click()
        eventually(lambda: page.evaluate("() => drsplat.state.results[0].text") == "tall lamp")
        page.evaluate(
            "() => { drsplat.camera.fly(null); drsplat.camera.stand(drsplat.header.eye, drsplat.header.target); }"
        )
        settled(page)
        rest = near(pixels_of(page, SIZE[0]), (PANEL + x, y))
        assert colorfulness(rest).mean() < 0.5 * colorfulness(plain).mean()
        assert rest.mean() > 0.05  # dimmed, not black


@needs_chromium
def test_a_click_says_what_is_there(exported, chromium):
    with a_page(chromium, *SIZE) as page:
        opened(page, exported.as_uri())
        x, y, _ = page.evaluate("() => drsplat.camera.project(drsplat.state.results[0].matches[0].center)")
        page.mouse.click(PANEL + x, y)
        eventually(lambda: "red mug" in page.locator("#what b").inner_text())
        assert "match of: red mug" in page.locator("#what").inner_text()
