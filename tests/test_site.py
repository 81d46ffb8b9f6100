"""The site is built with every warning an error, and a link that leads nowhere is found."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from viewing_scenes import boxes_scene

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))
import check_links  # noqa: E402
import make_gallery  # noqa: E402


def test_a_dead_link_is_found(tmp_path: Path) -> None:
    (tmp_path / "deeper").mkdir()
    (tmp_path / "index.html").write_text(
        '<a href="deeper/a.html#here"></a><a href="deeper/a.html#gone"></a><img src="no.png"><a href="https://x.org">'
    )
    (tmp_path / "deeper/a.html").write_text('<h1 id="here"></h1><a href="../index.html"></a><a href="#here"></a>')
    assert check_links.dead(tmp_path) == ["index.html: deeper/a.html#gone", "index.html: no.png"]
    assert check_links.main(str(tmp_path)) == 1


def one_page(folder: Path) -> Path:
    """A gallery of one small scene."""
    folder.mkdir()
    told = make_gallery.entry("boxes", boxes_scene(), ["red mug"], folder)
    (folder / make_gallery.LIST).write_text(make_gallery.as_text([told]))
    return folder


def test_the_site_is_built_and_its_links_lead_somewhere(tmp_path: Path) -> None:
    for name in ("mkdocs", "mkdocstrings", "fastapi", "mcp"):
        pytest.importorskip(name, reason="needs drsplat[docs,serve,mcp]")
    gallery = one_page(tmp_path / "gallery")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    told = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "DRSPLAT_GALLERY": str(gallery)}
    done = subprocess.run(command, cwd=ROOT, env=told, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert check_links.dead(tmp_path / "site") == []
    pages = {path.relative_to(tmp_path / "site").as_posix() for path in (tmp_path / "site").rglob("*.html")}
    assert {"index.html", "reference/http.html", "reference/mcp.html", "reference/command_line.html"} <= pages
    assert "gallery/boxes.html" in pages
    assert (tmp_path / "site/gallery/boxes.jpg").exists()
    assert 'href="gallery/boxes.html"' in (tmp_path / "site/gallery.html").read_text()
    assert "load_field" in (tmp_path / "site/reference/python.html").read_text()
    assert "--vocabulary" in (tmp_path / "site/reference/command_line.html").read_text()
