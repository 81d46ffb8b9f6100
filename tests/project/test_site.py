"""The site is built with every warning an error, and a link that leads nowhere is found."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from scripts import check_links, make_gallery

from browsing import SLOW, eventually, needs_chromium
from viewing_scenes import boxes_scene

ROOT = Path(__file__).resolve().parents[2]

CONTRAST = (ROOT / "tests/support/contrast.js").read_text(encoding="utf-8").partition("\n")[2]


def test_a_dead_link_is_found(tmp_path):
    (tmp_path / "deeper").mkdir()
    (tmp_path / "index.html").write_text(
        '<a href="deeper/a.html#here"></a><a href="deeper/a.html#gone"></a><img src="no.png"><a href="https://x.org">'
    )
    (tmp_path / "deeper/a.html").write_text('<h1 id="here"></h1><a href="../index.html"></a><a href="#here"></a>')
    assert check_links.dead(tmp_path) == ["index.html: deeper/a.html#gone", "index.html: no.png"]
    assert check_links.main(str(tmp_path)) == 1


def one_page(folder: Path) -> Path:
    """A gallery of one small scene, in the place of the demo's."""
    folder.mkdir()
    told = make_gallery.entry("demo", boxes_scene(), ["red mug"], folder)
    (folder / make_gallery.LIST).write_text(make_gallery.as_text([told]))
    return folder


def built(gallery: Path, site: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)]
    told = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "DRSPLAT_GALLERY": str(gallery)}
    return subprocess.run(command, cwd=ROOT, env=told, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for name in ("mkdocs", "mkdocstrings", "fastapi", "mcp"):
        pytest.importorskip(name, reason="needs drsplat[docs]")
    folder = tmp_path_factory.mktemp("built")
    done = built(one_page(folder / "gallery"), folder / "site")
    assert done.returncode == 0, done.stderr
    return folder / "site"


@pytest.mark.slow
def test_the_site_is_built_and_its_links_lead_somewhere(site):
    assert check_links.dead(site) == []
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html")}
    assert {"index.html", "404.html", "reference/http.html", "reference/mcp.html", "gallery/demo.html"} <= pages
    assert (site / "gallery/demo.jpg").exists()
    assert 'href="gallery/demo.html"' in (site / "gallery.html").read_text()
    assert "load_field" in (site / "reference/python.html").read_text()
    assert "--vocabulary" in (site / "reference/command_line.html").read_text()


OTHERS = """torch transformers sentencepiece open_clip pycolmap pi_heif av ray fsspec rerun pxr shtab
beartype clang_format faiss gsply hypothesis mypy pytest xdist ruff httpx cv2 schemathesis cupy"""
"""What other extras install."""
ONLY_DOCS = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {OTHERS.split()}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
sys.path.insert(0, "scripts")
import site_pages
for make in ("examples", "benchmarks", "python_names", "command_line", "http", "mcp", "numbers"):
    assert len(getattr(site_pages, make)()) > 200, make
"""


@pytest.mark.slow
def test_pages_are_made_with_the_extra_of_the_site_alone():
    for name in ("mkdocs", "fastapi", "mcp"):
        pytest.importorskip(name, reason="needs drsplat[docs]")
    done = subprocess.run([sys.executable, "-c", ONLY_DOCS], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_there_is_no_site_without_a_gallery(tmp_path):
    pytest.importorskip("mkdocs", reason="needs drsplat[docs]")
    done = built(tmp_path, tmp_path / "site")
    assert done.returncode != 0
    assert "has no page of the demo: run scripts/site" in done.stderr


@pytest.mark.slow
def test_the_front_page_has_the_numbers_of_the_evaluation(site):
    page = (site / "index.html").read_text()
    shown = re.findall(r"<b>([\d ]+%)[^<]*</b>", page)
    sentence = (ROOT / "docs/evaluation.md").read_text().partition("- Asked for a word")[2].partition("- ")[0]
    assert shown[:2] == re.findall(r"\d+ %", sentence)


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(site):
    for path in site.rglob("*.html"):
        text = path.read_text()
        assert re.findall(r"<(?:script|img|iframe|source)[^>]+(?:src|srcset)=[\"']?(?:https?:)?//[^>]*>", text) == []
        assert (
            re.findall(r"<link[^>]+rel=[\"']?(?:stylesheet|icon|preconnect)[^>]+href=[\"']?https?://[^>]*>", text) == []
        )


@pytest.mark.slow
def test_links_are_shown_with_a_card(site):
    page = (site / "tasks.html").read_text()
    names = re.search(r'property="?og:image"? content="?([^">\s]+)', page)
    assert names
    with Image.open(site / names[1]) as card:
        assert card.size == (1200, 630)
    assert "og:title" in page
    assert "summary_large_image" in page


def test_the_film_is_short_small_and_has_a_still():
    film = ROOT / "docs/images/tour.webp"
    assert film.stat().st_size < 1.5e6
    with Image.open(film) as pictures, Image.open(ROOT / "docs/images/tour.jpg") as still:
        assert pictures.size == still.size
        lasts = 0
        for number in range(pictures.n_frames):
            pictures.seek(number)
            pictures.load()
            lasts += pictures.info["duration"]
    assert lasts == pytest.approx(10_000, rel=0.01)


# --- in a browser, opened from a folder ---


@contextmanager
def opened(browser: Any, page: Path, **settings: Any) -> Iterator[Any]:
    """A page of the site; whatever asks another host, or for what is not there, fails the test."""
    context = browser.new_context(**settings)
    one, asked, missing = context.new_page(), [], []
    one.on("request", lambda request: asked.append(request.url))
    one.on("requestfailed", lambda request: missing.append(request.url))
    one.set_default_timeout(SLOW)
    one.goto(page.as_uri())
    yield one
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
    assert missing == []
    context.close()


@pytest.mark.slow
@needs_chromium
def test_the_search_works_in_a_folder(chromium, site):
    for name in ("index.html", "tutorials/from_a_phone.html"):
        with opened(chromium, site / name) as page:
            page.wait_for_function("window.__index")  # else what is typed is not looked for
            page.click("input.md-search__input")
            page.keyboard.type("threshold")
            eventually(lambda page=page: page.locator(".md-search-result__item").count() > 3)
            page.locator(".md-search-result__item a").first.click()
            page.wait_for_url("**/tasks.html*")


@pytest.mark.slow
@needs_chromium
def test_the_demo_starts_when_it_is_asked_for(chromium, site):
    with opened(chromium, site / "index.html") as page:
        assert page.locator("iframe[src]").count() == 0
        page.click(".live button")
        page.frame_locator(".live iframe").locator("canvas").first.wait_for()


@pytest.mark.slow
@needs_chromium
def test_who_wants_no_motion_sees_a_still(chromium, site):
    for motion, name in (("reduce", "tour.jpg"), ("no-preference", "tour.webp")):
        with opened(chromium, site / "index.html", reduced_motion=motion) as page:
            assert page.evaluate("document.querySelector('.hero img').currentSrc").endswith(name)


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_differ_from_what_is_behind_them(chromium, site, scheme):
    for name in ("index", "overview", "evaluation", "api", "reference/python", "examples", "404"):
        with opened(chromium, site / f"{name}.html", color_scheme=scheme) as page:
            found = page.evaluate(CONTRAST)
            assert found["count"] > 20
            assert found["faults"] == [], name


@needs_chromium
def test_faint_texts_are_found(chromium, tmp_path):
    (tmp_path / "a.html").write_text(
        '<body style="background:#fff"><p style="color:#777">a<p style="color:#767676">b'
        '<p style="color:#949494;font-size:24px">c<p style="color:#959595;font-size:24px">d'
        '<div style="background:#000"><p style="color:rgba(255,255,255,.3)">e</div>'
    )
    with opened(chromium, tmp_path / "a.html") as page:
        found = page.evaluate(CONTRAST)
    assert found["count"] == 5
    assert [fault[-2] for fault in found["faults"]] == ["a", "d", "e"]  # 4.48, 2.99 and 2.6 to 1


@pytest.mark.slow
@needs_chromium
def test_it_is_read_on_a_phone(chromium, site):
    for name in ("index", "overview", "evaluation", "gallery", "formats", "404"):
        with opened(chromium, site / f"{name}.html", viewport={"width": 390, "height": 844}) as page:
            assert page.evaluate("document.documentElement.scrollWidth") <= 390, name
