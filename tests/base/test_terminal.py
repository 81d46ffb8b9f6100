"""What reaches a terminal: nothing that it obeys, and nothing cut."""

import ast
import io
import itertools
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import drsplat
from command_line import answer_of, error_of, text_of
from drsplat import errors
from drsplat.base.progress import Meter
from drsplat.base.terminal import counted, plain, plain_json, quoted
from drsplat.cli import main, make_parser, spelled
from drsplat.fronts.commands.tables import show_facts, show_table

EVIL = "\x1b[2J\x1b]0;pwned\x07\x9b31m\u202e\ud800"
NAMES = [f"20240212_00401{n}_of_the_long_walk_through_the_house.jpg" for n in range(3)]


@given(st.text(st.characters(exclude_categories=())))
def test_plain_text_has_nothing_that_a_terminal_obeys(text):
    said = plain(text)
    said.encode()
    assert all(letter.isprintable() or letter in "\t\n" or ord(letter) > 0x9F for letter in said)
    assert "\x1b" not in said
    assert plain(said) == said


def test_what_is_harmless_stays():
    assert plain("größer, 赤い, \U0001f34e\n\tnext") == "größer, 赤い, \U0001f34e\n\tnext"
    assert plain("\x1b[2J\u202e") == "\\x1b[2J\\u202e"
    assert plain_json({"a\x07": ["\x1b", Path("x\x1b"), 3]}) == {"a\\x07": ["\\x1b", "x\\x1b", 3]}
    assert quoted("9" * 5000) == f"'{'9' * 60}...'"


def test_hostile_names_in_files_and_errors(tmp_path, capsys):
    words = tmp_path / "words.json"
    words.write_text(json.dumps({EVIL[:-1]: [1.0, 0.0], "vase": [0.0, 1.0]}))  # no half surrogate: no JSON
    said = text_of(capsys, "inspect", words)
    assert "\\x1b[2J" in said
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f]", said)
    assert answer_of(capsys, "inspect", words)["texts"][0].startswith("\x1b")
    assert "\x1b" not in error_of(capsys, "inspect", tmp_path / "\x1b[2Jnowhere")
    assert "\x1b" not in error_of(capsys, "inspect", "x", "--\x1b[2J", code=2)


def test_hostile_names_in_progress(monkeypatch, capsys):
    for name in ("PATIENCE_S", "LINE_EVERY_S"):
        monkeypatch.setattr(f"drsplat.base.progress.{name}", -1.0)
    with Meter("embedding photos", 10) as meter:
        meter.update(1, "\x1b[2J.jpg")
        meter.update(5, "b.jpg")
    first, second = capsys.readouterr().err.splitlines()
    assert "\\x1b[2J.jpg" in first
    assert re.fullmatch(r"embedding photos: 5/10, b\.jpg, [\d.]+/s, \d+ s left", second)


@pytest.mark.parametrize("columns", [60, 80])
def test_a_bar_shows_count_rate_and_time(columns, monkeypatch, capsys):
    monkeypatch.setattr("drsplat.base.progress.PATIENCE_S", -1.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    seconds = itertools.count(step=3)
    monkeypatch.setattr("drsplat.base.progress.time", SimpleNamespace(monotonic=lambda: float(next(seconds))))
    with Meter("embedding patches", 123_456) as meter:
        for done in (30_000, 30_001):
            meter.update(done, f"[/red]{NAMES[0]}")
    lines = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", capsys.readouterr().err).replace("\r", "\n").splitlines()
    drawn = [line.rstrip() for line in lines if "embedding patches" in line]
    assert drawn
    for line in drawn:
        assert re.search(r"3000[01]/123456  [\d.]+/s  \d+ (s|min|h) left", line)
        assert len(line) <= columns
    assert "30001/" in drawn[-1]
    assert columns < 80 or "[/red]" in drawn[-1]


@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("columns", [20, 80])
def test_tables_cut_nothing(columns, terminal, monkeypatch):
    printed = io.StringIO()
    monkeypatch.setattr(printed, "isatty", lambda: terminal, raising=False)
    monkeypatch.setattr(sys, "stdout", printed)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "dumb")
    rows = [(str(n), "-1.25 0.33 12.75", name) for n, name in enumerate(NAMES)]
    show_table(f"found in {NAMES[0]}", ("thing", "centre", "seen in"), rows)
    lines = printed.getvalue().splitlines()
    for row in rows:
        assert any(all(cell in line for cell in row) for line in lines)
    show_facts("embedded", {"photos": ", ".join(NAMES)})
    assert "".join(NAMES) in re.sub(r"[\s,]", "", printed.getvalue())
    assert "…" not in printed.getvalue()


def test_photos_of_a_thing_have_their_line(edited_room, tmp_path, capsys):
    """And a scene's folder is enough to ask."""
    said = text_of(capsys, "locate", edited_room, "red mug")
    assert re.search(r"^match 0 is supported by photo_\d.png, photo_\d.png, photo_\d.png$", said, re.MULTILINE)
    answer = answer_of(capsys, "locate", edited_room, "red mug")
    assert (answer["field"], answer["num_matches"]) == (str(edited_room), 1)
    assert answer_of(capsys, "select", edited_room, "red mug", "--save", tmp_path / "found.ply")["num_selected"]
    both = answer_of(capsys, "segment", edited_room, "--classes", "red mug,blue plate")
    assert [one["num_gaussians"] for one in both["classes"]] == [150, 150]


FLAGS = {"overwrite": "--overwrite", "images": "--images", "encoder": "--encoder", "field": ""}


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("x exists already: pass overwrite=True to replace it", "x exists already: pass --overwrite to replace it"),
        ("read them with images=FOLDER, or not", "read them with --images FOLDER, or not"),
        ("pass encoder=NAME (its folder)", "pass --encoder NAME (its folder)"),
        ("images: there is no folder", "--images: there is no folder"),
        ("field: rows=12, sampling=Sampling(3)", "field: rows=12, sampling=Sampling(3)"),
        ("one of field=FIELD, encoder=X,Y,Z and images=N", "one of FIELD, --encoder X,Y,Z and --images N"),
    ],
)  # fmt: skip
def test_arguments_are_spelled_as_flags(said, shown):
    assert spelled(said, FLAGS) == shown


def test_no_message_of_the_library_names_a_flag():
    """Flags are the command line's words; others read these messages too."""
    source = Path(sys.modules["drsplat"].__file__ or "").parent
    own = source / "fronts/commands", source / "cli.py"
    files = [path for path in source.rglob("*.py") if not any(path.is_relative_to(place) for place in own)]
    assert len(files) > 150
    theirs = "filter-nan|upgrade|force-reinstall|depth|load-config|output-dir exports|save_ply|camera-type|ply-color"
    flag = re.compile(rf"\"[^\"]*(?<![\w-])--(?!{theirs})[a-z][a-z-]+")
    for path in files:
        lines = (line for line in path.read_text().splitlines() if "drsplat " not in line)
        assert not [line for line in lines if flag.search(line)], path


NOT_OF_THE_LINE = {"sampling"}
"""Names in messages of calls that no verb makes."""


def messages() -> Iterator[tuple[str, str]]:
    """Every text that is raised as an error of drsplat or warned of, where it stands; values in it are an X."""
    source = Path(sys.modules["drsplat"].__file__ or "").parent
    for path in sorted(source.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = getattr(getattr(node, "func", None), "id", getattr(getattr(node, "func", None), "attr", ""))
            if isinstance(node, ast.Call) and (called in vars(errors) or called == "warn") and node.args:
                yield f"{path.name}:{node.lineno}", text_in(node.args[0])


def text_in(node: ast.AST) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(text_in(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return "X"
    return " ".join(text_in(part) for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr))


def test_every_argument_in_a_message_has_words_of_the_command_line():
    """Whatever the library asks for in Python's words, an option of some verb has the same name."""
    parser = make_parser()
    verbs = next(action.choices for action in parser._actions if action.choices)
    assert isinstance(verbs, dict)
    flags = {name: flag for verb in verbs.values() for name, flag in sorted(verb.flags.items()) if flag}
    python = re.compile(r"(?<![\w-])([a-z_]+)=(?=[\w'\"\[(])|\b([a-z]+_[a-z_]+)\(|\b(?:True|False)\b")
    functions = {name for name in drsplat.__all__ if "_" in name.strip("_")}
    texts = list(messages())
    assert len(texts) > 300
    for place, text in texts:
        shown = spelled(text, flags)
        left = [match[0] for match in python.finditer(shown) if match[1] not in NOT_OF_THE_LINE]
        assert not left, (place, shown)
        assert not functions & set(re.findall(r"\w+", shown)), (place, shown)


@pytest.mark.parametrize(
    ("output", "options", "words"),
    [("capture", "", "--overwrite"), ("n", "--max-gaussians 1", "--max-gaussians: expected at least 4, got 1")],
)
def test_errors_of_the_command_line_speak_its_words(output, options, words, room, capsys):
    line = f"train {room}/capture --iterations 1 -o {room}/{output} {options}"
    assert main(line.split()) == 1
    said = capsys.readouterr().err
    assert words in said
    assert "overwrite=" not in said


def test_what_looks_like_markup_is_shown_as_it_is(capsys, tmp_path):
    names = ["[/red]", "[bold]vase", ":warning: cup"]
    show_table("words", names, [names])
    show_facts("words", {"texts": ", ".join(names)})
    said = capsys.readouterr().out
    assert all(said.count(name) == 3 for name in names)
    words = tmp_path / "words.json"
    words.write_text(json.dumps({name: [1.0, at + 1.0] for at, name in enumerate(names)}))
    assert all(name in text_of(capsys, "inspect", words) for name in names)


def test_plurals():
    said = [counted(1, "Gaussian"), counted(2, "scene"), counted(1200, "entry", "entries")]
    assert said == ["1 Gaussian", "2 scenes", "1,200 entries"]
