"""`drsplat view --export`, and the file that it writes."""

import base64
import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drsplat import write_gaussians
from drsplat.cli import main
from drsplat.errors import pip_install
from drsplat.formats.spz import parse_spz
from drsplat.fronts.viewing.client import PAGE_POLICY, filled
from drsplat.fronts.viewing.exporting import export_page
from drsplat.fronts.viewing.session import Session
from drsplat.scene.gaussians import significance
from page_files import read_page
from viewing_scenes import EACH, THINGS, boxes_scene


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scene = boxes_scene()
    scene.field.save(tmp_path / "boxes.field")
    write_gaussians(tmp_path / "boxes.ply", scene.gaussians)
    return tmp_path


def export(folder: Path, *more: str) -> int:
    return main(["view", str(folder), "--export", str(folder / "page.html"), *more])


def test_a_page_says_from_where_left_and_right_are_meant_and_what_matches_instead(tmp_path):
    scene = boxes_scene()
    export_page(tmp_path / "page.html", scene, ["red mug left of the blue mug", "elephant"])
    sides, nothing = read_page(tmp_path / "page.html")[0]["answers"]
    assert sides["doubt"] == f"left and right are those of the photo {scene.ask(sides['text']).seen_from}"
    assert "below the threshold of 0.60." in nothing["doubt"]
    assert nothing["instead"] == ["mug", "lamp"]
    assert sides["instead"] == []


def test_a_page_holds_the_scene_and_its_answers(folder):
    assert export(folder, "--ask", "tall lamp; elephant", "--words", ",".join(THINGS)) == 0
    header, arrays = read_page(folder / "page.html")
    assert_array_equal(np.flatnonzero(arrays["owner0"]), np.arange(2 * EACH, 3 * EACH))
    assert [len(answer["matches"]) for answer in header["answers"]] == [1, 0]
    assert header["search"]["vocabulary"] == list(THINGS)
    things = arrays["things"]
    assert set(things[: 3 * EACH]) == {1}  # of no object
    assert set(things[3 * EACH :]) == {0}  # without a feature


def test_a_query_cannot_end_the_script_that_it_is_in(folder):
    assert export(folder, "--ask", "</script><script>alert(1)</script> mug") == 0
    header, _ = read_page(folder / "page.html")
    assert header["answers"][0]["text"].startswith("</script>")
    assert "alert(1)</script>" not in (folder / "page.html").read_text(encoding="utf-8")


def test_a_page_needs_no_network(folder):
    export(folder, "--ask", "mug")
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert f'content="{PAGE_POLICY}"' in text  # a browser then asks no host, whatever a script tries
    assert PAGE_POLICY.startswith("default-src 'none'")
    assert "http" not in PAGE_POLICY
    assert "connect-src" not in PAGE_POLICY
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)\s*=(?!.data:)|https?://|@import", text)


def test_the_scene_in_a_page_is_a_file_that_others_read(folder):
    export(folder, "--ask", "mug")
    header, _ = read_page(folder / "page.html")
    found = re.search(r'id="scene" data-name="scene.spz">(.*?)</script>', (folder / "page.html").read_text("utf-8"))
    inside, scene = parse_spz(memoryview(base64.b64decode(found[1]))), boxes_scene()
    weight = significance(scene.gaussians)
    order = np.argsort(-weight, kind="stable")
    assert_allclose(inside.means, scene.gaussians.means[order], atol=1e-5)
    assert len(inside) == len(scene.gaussians)
    assert header["frame"]["scale"] == Session(scene).shown.frame.scale


def test_a_page_opens_before_its_first_match(folder):
    export(folder, "--ask", "elephant; tall lamp")
    header, _ = read_page(folder / "page.html")
    (match,) = header["answers"][1]["matches"]
    assert header["target"] == match["center"]
    assert header["eye"] == match["eye"]


@pytest.mark.parametrize(
    ("more", "said"),
    [(["--ask", "mug", "--up", "up"], "expected one of"), (["--ask", "mug", "--known", "..."], "has no word")],
)
def test_what_is_missing_is_said(folder, capsys, more, said):
    assert export(folder, *more) == 1
    assert said in capsys.readouterr().err
    assert not (folder / "page.html").exists()


def test_a_field_alone_is_not_enough(folder, capsys):
    page = ["--export", str(folder / "page.html"), "--ask", "mug"]
    assert main(["view", str(folder / "boxes.field"), *page]) == 1
    assert "--scene" in capsys.readouterr().err
    scene = ["--scene", str(folder / "boxes.ply")]
    assert main(["view", str(folder / "boxes.field"), *scene, *page]) == 0


def test_a_scene_without_a_field_becomes_a_page_without_answers(folder, capsys):
    page = ["--export", str(folder / "plain.html"), "--json"]
    assert main(["view", str(folder / "boxes.ply"), *page]) == 0
    assert json.loads(capsys.readouterr().out)["num_shown"] == 3 * EACH + 60
    header, _ = read_page(folder / "plain.html")
    assert header["answers"] == header["words"] == []
    assert main(["view", str(folder / "boxes.ply"), *page, "--overwrite", "--ask", "mug"]) == 1
    assert "no field" in capsys.readouterr().err


@pytest.mark.parametrize("ask", ["\x1b[2J mug", "\u202emug", "x" * 100_000])
def test_any_text_can_be_asked_for_on_a_page(folder, ask):
    assert export(folder, "--ask", ask) == 0
    header, _ = read_page(folder / "page.html")
    assert header["answers"][0]["text"].isprintable()
    assert len(header["answers"][0]["text"]) <= 200


def test_a_name_that_is_no_text_is_no_obstacle(folder):
    odd = folder.parent / "odd\udcff<b>"
    folder.rename(odd)
    assert main(["view", str(odd), "--export", str(odd / "page.html"), "--ask", "mug"]) == 0
    text = (odd / "page.html").read_text(encoding="utf-8")
    assert "<b>" not in text.split("<style>")[0]


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_listening_viewer_says_where_as_one_json_object_at_once(folder, end):
    pytest.importorskip("uvicorn", reason="the extra drsplat[viewer] is not installed")
    pytest.importorskip("prometheus_client", reason="the extra drsplat[viewer] is not installed")
    command = [sys.executable, "-m", "drsplat", "view", str(folder), "--port", "8981", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as started:
        told = json.loads(started.stdout.readline())
        assert told["address"].startswith("http://127.0.0.1:")
        state = f"{told['address']}/view/state"
        with urllib.request.urlopen(state, timeout=60) as answer:
            assert json.load(answer)["results"] == []
        started.send_signal(end)
        rest = started.stdout.read()
    assert "{" not in rest
    assert started.returncode == 0


@pytest.mark.parametrize("package", ["fastapi", "uvicorn", "prometheus_client"])
def test_without_the_extra_a_line_says_what_to_install(package, folder):
    """In a process of its own, where nothing of it has been imported yet."""
    code = f"import sys; sys.modules[{package!r}] = None; from drsplat.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", code, "view", str(folder)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 1
    named = done.stderr.removeprefix("drsplat: error: ").partition(" not installed")[0].split(" and ")
    assert package in named
    assert pip_install("viewer") in done.stderr


@pytest.mark.parametrize(
    ("options", "code"), [(["--port", "99999999999"], 2), (["--host", "300.1.1.1"], 1), (["--host", "a" * 300], 1)]
)
def test_where_it_cannot_listen_is_said(folder, capsys, options, code):
    pytest.importorskip("uvicorn", reason="the extra drsplat[viewer] is not installed")
    pytest.importorskip("prometheus_client", reason="the extra drsplat[viewer] is not installed")
    assert main(["view", str(folder), *options]) == code
    assert re.search("listen|port", capsys.readouterr().err)


def test_one_gaussian_makes_a_page(folder):
    assert export(folder, "--ask", "mug", "--max-gaussians", "1") == 0


def test_a_page_is_not_overwritten_unasked(folder, capsys):
    assert export(folder, "--ask", "mug") == 0
    assert export(folder, "--ask", "lamp") == 1
    assert "--overwrite" in capsys.readouterr().err
    assert export(folder, "--ask", "lamp", "--overwrite") == 0


def test_a_budget_is_kept_and_told(folder, capsys):
    assert export(folder, "--ask", "mug", "--max-gaussians", "100", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["num_shown"] == 100
    assert answer["num_left_out"] == 3 * EACH + 60 - 100
    header, _ = read_page(folder / "page.html")
    assert "100 most significant" in header["about"]


def test_what_is_filled_in_is_not_filled_again():
    assert filled("@A@ @B@", {"A": "@B@", "B": "x@A@"}) == "@B@ x@A@"
