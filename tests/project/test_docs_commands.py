"""Every command of README and docs/ runs on the demo's folder, or a reason that can be checked says why not."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scripts import docs_commands
from scripts.docs_blocks import MAX_WIDTH, PAGES, ROOT, Block, Piece, blocks, commands, pieces
from scripts.docs_commands import Place
from scripts.docs_not_run import INSTALL, NOT_RUN, reason

import drsplat as ds
from drsplat.cli import VERBS, main, make_parser
from drsplat.fronts.commands.parsing import UsageError
from toy_capture import THINGS

LANGUAGES = {"bash", "python", "text", "json", "toml", "js", "bibtex"}
ALL = [piece for page in PAGES for piece in pieces(page)]
MAX_WORDS = 900

every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@every_page
def test_blocks_say_their_language_and_fit_a_page(page):
    """A block without a language would not be run."""
    for block in blocks(page):
        assert block.language in LANGUAGES, f"{name_of(page)}:{block.line}"
        wide = [line for line in block.text.splitlines() if len(line) > MAX_WIDTH]
        assert not wide or name_of(page) == "README.md", f"{name_of(page)}:{block.line}: {wide}"


def test_nothing_is_passed_over():
    """Each line of a shell block is part of a command or a comment."""
    for page in PAGES:
        lines = [line for block in blocks(page) if block.language == "bash" for line in block.text.splitlines()]
        run = "\n".join(piece.text for piece in pieces(page) if piece.language == "bash")
        assert [
            one for one in lines if one.strip() and not one.startswith("#") and one.split(" && ")[0] not in run
        ] == []


def test_a_block_is_cut_into_commands():
    text = 'pip install . && drsplat demo\ndrsplat ask "a\n b" \\\n    --top 1  # two lines\n\n# nothing\ncat a |\n  wc'
    cut = list(commands(Block("page.md", 10, "bash", text)))
    assert [(piece.line, piece.words) for piece in cut] == [
        (10, ["pip", "install", "."]),
        (10, ["drsplat", "demo"]),
        (11, ["drsplat", "ask", "a\n b", "--top", "1"]),
        (16, ["cat", "a", "|", "wc"]),
    ]
    with pytest.raises(ValueError, match="does not end"):
        list(commands(Block("page.md", 1, "bash", 'echo "')))


def test_each_reason_names_a_command():
    """A row whose command has gone, or that is no reason any more, is an error."""
    for (page, begin), why in NOT_RUN.items():
        assert [one for one in ALL if (one.page, one.text.startswith(begin)) == (page, True)], (page, begin)
        assert why.text


@pytest.mark.parametrize("piece", [one for one in ALL if reason(one)], ids=lambda one: one.place)
def test_a_command_that_is_not_run_has_a_reason_that_holds(piece):
    why = reason(piece)
    if "python -m" not in piece.text:  # whose options are compared with its help by the slow test
        assert why.check(piece) == ""


def test_a_reason_that_does_not_hold_is_an_error():
    assert "nosuch" in INSTALL.check(Piece("page.md", 1, "bash", 'pip install ".[serve,nosuch]"'))
    hours = reason(Piece("page.md", 1, "bash", "python -m world --nosuch 1"))
    assert "--nosuch" in hours.check(Piece("page.md", 1, "bash", "python -m world --nosuch 1"))


def test_options_of_every_command_exist():
    """Also of those that are not run, and of those in the text around the blocks, which may leave out the rest."""
    parser = make_parser()
    whole = [one.words for one in ALL if one.language == "bash" and one.text.startswith("drsplat ")]
    parts = []
    for page in PAGES:
        plain = re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        named = [one for one in re.findall(r"`(drsplat [^`\n]+)`", plain) if one.split()[1] in VERBS]
        parts += [Piece("", 0, "bash", one).words for one in named if not re.search(r"[A-Z]{3}|\.\.\.|--help", one)]
    assert min(len(whole), len(parts)) > 70
    for words in (*whole, *parts):
        if words[1].startswith("--") or "--help" in words:
            continue
        given = words[1 : next((k for k, word in enumerate(words) if word in ("|", ">")), None)]
        try:
            parser.parse_args(given)
        except UsageError as error:
            if words not in parts or not re.search(r"arguments are required|expected a value", str(error)):
                raise


def test_the_tour_has_every_verb():
    """Beside README, whose first command is the demo."""
    shown = {
        one.words[1] for one in ALL if one.page in ("docs/tour.md", "README.md") and one.text.startswith("drsplat ")
    }
    assert shown >= set(VERBS)


def how_to_pages() -> list[Path]:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    part = text.partition("How to:")[2].partition("Reference:")[0]
    return [path for name in re.findall(r": (\S+\.md)", part) if (path := ROOT / "docs" / name).exists()]


@pytest.mark.parametrize("page", how_to_pages(), ids=lambda page: page.name)
def test_how_to_pages_are_short_with_a_picture_and_a_command(page):
    """What was measured, and how, is a page of its own."""
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    assert len(prose.split()) <= MAX_WORDS
    assert "![" in text
    assert any(not reason(piece) for piece in pieces(page))


def after_tour(place: Place) -> None:
    field, encoder = ds.load_field("scene.field"), ds.load_encoder(docs_commands.CLIP, "cpu")
    assert field.encoder == encoder.identity
    assert field.encoder.weights
    argv = "register scene.ply capture --features capture/language_features --output other.field"
    assert main([*argv.split(), "--encoder-name", "ViT-B-16/laion2b_s34b_b88k"]) == 1  # another's than the record's
    assert not (place.folder / "other.field").exists()


def after_without_a_model(place: Place) -> None:
    assert "things are like it" in place.said
    assert "1 match of 'my table'" in place.said
    table, rest, whole = (len(ds.read_gaussians(name)) for name in (
        "table.ply", "room_without_table.ply", "drsplat-demo/scene.compressed.ply"))  # fmt: skip
    assert table + rest == whole
    room = ds.open_scene("drsplat-demo")
    assert room.locate("brown table")[0].object_id == 2  # not the floor, for instance
    assert table >= room.objects[2].gaussian_ids.size  # and its loose border


def after_scene_and_features(place: Place) -> None:
    assert_allclose(place.names["matches"][0].center, THINGS["red mug"], atol=0.1)
    mug = len(np.load("mug_ids.npy"))
    assert len(ds.read_gaussians("without_mug.ply")) == len(ds.read_gaussians("scene.ply")) - mug


def after_api(place: Place) -> None:
    assert len(place.names["matches"]) == 1
    assert_allclose(place.names["matches"][0].center, THINGS["red mug"], atol=0.1)


def after_catalogue(place: Place) -> None:
    assert "1 match for “red vase”" in place.said
    assert [entry.scene for entry in place.names["catalogue"].ask("red vase")][:1] == ["kitchen"]


def after_tasks(place: Place) -> None:
    assert "No match for 'laptop'" in place.said
    assert "of 'blue candle'" in place.said


def after_splat_per_object(place: Place) -> None:
    """Each object is a splat of its own, by its number."""
    room = ds.open_scene("drsplat-demo")
    for number, match in enumerate(room.objects):
        part = ds.read_gaussians(f"parts/object_{number:04d}.ply")
        assert_allclose(part.positions, room.gaussians.positions[match.gaussian_ids], atol=1e-5)


def after_capture(place: Place) -> None:
    """Named places gave metres, and the red vase is as far from the cup as in the room."""
    record = (place.folder / "capture/capture.json").read_text(encoding="utf-8")
    assert '"unit": "m"' in record
    assert '"scale_from": "known distance"' in record


RESULTS: dict[str, tuple[tuple[str, ...], Callable[[Place], None] | None]] = {
    "docs/tour.md": (("mug_ids.npy", "found.ply", "classes.ply", "out/results.json", "mug.webp"), after_tour),
    "docs/tasks.md": (("vase.ply", "vase_ids.npy", "duck.ply", "duck.png", "classes.ply", "classes.png"), after_tasks),
    "docs/films.md": (("vase.webp", "walk.webp", "swing.gif", "row.png"), None),
    "docs/splat_per_object.md": (("objects.jpg", "parts/objects.json", "thing.spz"), after_splat_per_object),
    "docs/catalogue.md": (("vases.jpg",), after_catalogue),
    "docs/api.md": (("found.ply", "answer.glb", "mug.webp"), after_api),
    "docs/capture.md": (("capture/sparse/0/images.bin",), after_capture),
    "docs/scan.md": (("room/index.html", "room/scene.field/field.json"), None),
    "docs/tutorials/from_a_phone.md": (("room/index.html", "objects.jpg", "room.html"), None),
    "docs/tutorials/scene_and_features.md": (("found.ply", "teatime_report/results.json"), after_scene_and_features),
    "docs/tutorials/without_a_model.md": (("objects.jpg", "table.ply", "before_after.png"), after_without_a_model),
}
"""Files that a page's commands leave, and what else has to hold of what they found: not exit codes alone."""


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if pieces(page)], ids=name_of)
def test_every_command_of_a_page_runs(page, household_story, household_folder):
    for name in ("transformers", "fastapi", "mcp"):
        pytest.importorskip(name, reason="needs drsplat[models,serve,mcp]")
    with docs_commands.placed(name_of(page), household_folder) as place:
        outcomes = docs_commands.run_page(page, place)
        bad = [one for one in outcomes if one.state == "failed"]
        assert not bad, docs_commands.table(bad)
        files, check = RESULTS.get(name_of(page), ((), None))
        if all(one.state == "run" or not one.piece.text.startswith("drsplat") for one in outcomes):
            for file in files:
                assert (place.folder / file).stat().st_size > 0, file
            if check:
                check(place)
