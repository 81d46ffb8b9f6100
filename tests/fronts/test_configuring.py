"""--config and --print-config: every option of every verb can be set, and the command line always wins."""

import argparse
import json
import os
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from command_line import error_of, text_of
from drsplat.cli import VERBS, make_parser
from drsplat.errors import InputError
from drsplat.fronts.commands.configuring import MAX_FILE_BYTES, options_of, place
from drsplat.fronts.commands.declaring import words
from drsplat.fronts.commands.parsing import VerbParser

TEXTS = ["a", "1", "1.50", "007", "x y", 'q"\\', "größer", "--scene=evil", "-k5", "2026-01-01", "true"]
OTHERS = ["1", "2", "0", "0.5", "8", "auto", "scene", "64x48", "1,2,3", "large", "every:2", "-0.25", "all"]
NO_SETTINGS = ("config", "print_config", "command", "parser", "flags")


@cache
def verb_parser(verb: str) -> VerbParser:
    return parser_of(make_parser([verb]), verb)


def parser_of(parser: argparse.ArgumentParser, verb: str) -> VerbParser:
    choices = next(action.choices for action in parser._actions if action.choices)
    assert isinstance(choices, dict)
    return choices[verb]


def parsed(verb: str, argv: list[str]) -> dict[str, Any]:
    arguments = vars(make_parser([verb]).parse_args([verb, *argv]))
    return {name: value for name, value in arguments.items() if name not in NO_SETTINGS}


def allowed(option: argparse.Action) -> list[str]:
    """Texts that an option takes as one of its values."""
    if option.choices is not None:
        return [str(choice) for choice in option.choices]
    if option.type in (None, words):
        return TEXTS

    def takes(text: str) -> bool:
        try:
            option.type(text)
        except (argparse.ArgumentTypeError, ValueError):
            return False
        return True

    return [text for text in OTHERS if takes(text)]


def uses(option: argparse.Action) -> st.SearchStrategy[list[str]]:
    """The values of one use of an option."""
    if option.nargs == 0:
        return st.just([])
    if option.dest == "axis":  # one letter, or three numbers
        return st.sampled_from([["x"], ["-z"], ["0", "1", "0.5"]])
    value = st.sampled_from(allowed(option))
    if option.nargs is None:
        return value.map(lambda text: [text])
    least, most = {"?": (0, 1), "*": (0, 3), "+": (1, 3)}.get(str(option.nargs)) or (option.nargs, option.nargs)
    return st.lists(value, min_size=int(least), max_size=int(most))


def spellings(option: argparse.Action, texts: list[str]) -> list[list[str]]:
    """All ways of giving an option on the line; values that look like options need "=" or to be attached."""
    ways: list[list[str]] = []
    for flag in option.option_strings:
        if not any(text.startswith("-") for text in texts):
            ways.append([flag, *texts])
        if len(texts) == 1 and flag.startswith("--"):
            ways.append([f"{flag}={texts[0]}"])
        elif len(texts) == 1 and option.nargs in (None, "?") and not texts[0].startswith("="):
            ways.append([f"{flag}{texts[0]}"])
    return ways


def needed(parser: VerbParser, *without: argparse.Action) -> list[str]:
    """What a verb cannot do without: its positional arguments, then its required options but some."""
    argv = []
    for action in parser._actions:
        if not action.option_strings and action.nargs in (None, "+"):
            argv.append(allowed(action)[0])
    for action in parser.options:
        if action.required and action not in without:
            argv += [f"{action.option_strings[0]}={allowed(action)[0]}"]
    return argv


def toml(option: argparse.Action, texts: list[str]) -> str:
    if option.nargs == 0 or (option.nargs == "?" and not texts):
        return "true"
    return json.dumps(texts[0] if option.nargs in (None, "?") else texts, ensure_ascii=False)


def written(folder: Path, verb: str, lines: list[str]) -> str:
    path = folder / "options.toml"
    path.write_text("\n".join([f"[{verb}]", *lines]), encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("configuring")


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
@given(data=st.data())
def test_the_line_wins_in_every_spelling(verb, folder, data):
    parser = verb_parser(verb)
    key, option = data.draw(st.sampled_from(sorted(options_of(parser.options).items())))
    ways = spellings(option, data.draw(uses(option)))
    if not ways:
        return
    line = [*needed(parser, option), *data.draw(st.sampled_from(ways))]
    rival_key, rival = data.draw(st.sampled_from(sorted({key: option, **rivals(parser, option)}.items())))
    file = written(folder, verb, [f"{rival_key} = {toml(rival, data.draw(uses(rival)))}"])
    assert parsed(verb, [*line, "--config", file]) == parsed(verb, line)
    assert parsed(verb, ["--config", file, *line]) == parsed(verb, line)


def test_attached_short_options_win(folder):
    file = written(folder, "register", ['output = "keep.field"', "topk = 40"])
    line = ["scene.ply", "capture", "--features", "f", "-omine.field", "-k5", "--config", file]
    arguments = parsed("register", line)
    assert (arguments["output"], arguments["topk"]) == ("mine.field", 5)


def rivals(parser: VerbParser, option: argparse.Action) -> dict[str, argparse.Action]:
    """The options that exclude one, or share its place."""
    others = {key: other for key, other in options_of(parser.options).items() if other is not option}
    excluded = parser.rivals(option)
    return {key: other for key, other in others.items() if place(other) == place(option) or other in excluded}


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
@given(data=st.data())
def test_every_option_can_be_set_in_a_file(verb, folder, data):
    parser = verb_parser(verb)
    key, option = data.draw(st.sampled_from(sorted(options_of(parser.options).items())))
    texts = data.draw(uses(option))
    ways = spellings(option, texts)
    if not ways:
        return
    base = needed(parser, option)
    file = written(folder, verb, [f"{key.replace('-', '_')} = {toml(option, texts)}"])
    assert parsed(verb, [*base, "--config", file]) == parsed(verb, [*base, *ways[0]])


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
@given(data=st.data())
def test_what_is_printed_can_be_read_again(verb, folder, data):
    parser = verb_parser(verb)
    line: list[str] = []
    chosen: list[argparse.Action] = []
    for option in data.draw(st.lists(st.sampled_from(list(options_of(parser.options).values())), max_size=6)):
        excluded = {*chosen} & {*parser.rivals(option)}
        ways = spellings(option, data.draw(uses(option)))
        if ways and (option in chosen or not excluded):
            line += data.draw(st.sampled_from(ways))
            chosen.append(option)
    base = needed(parser)
    whole = make_parser([verb])
    whole.parse_args([verb, *base, *line])
    try:
        text = parser_of(whole, verb).configuration
    except InputError:
        assume(verb != "edit")  # whose changes can return to an option; see below
        raise
    positional = base[: len(base) - sum(option.required for option in parser.options)]
    path = folder / "printed.toml"
    path.write_text(text, encoding="utf-8")
    assert parsed(verb, [*positional, "--config", str(path)]) == parsed(verb, [*base, *line])


@pytest.mark.parametrize("verb", VERBS)
def test_defaults_stand_in_comments_and_can_be_taken(verb, folder):
    parser = verb_parser(verb)
    base = needed(parser)
    whole = make_parser([verb])
    whole.parse_args([verb, *base])
    text = parser_of(whole, verb).configuration
    assert "SUPPRESS" not in text
    path = folder / "defaults.toml"
    path.write_text(re.sub("^# ", "", text, flags=re.MULTILINE), encoding="utf-8")
    assert parsed(verb, [*base, "--config", str(path)]) == parsed(verb, base)


def test_a_printed_file_begins_with_its_verb(capsys):
    assert text_of(capsys, "demo", "--print-config").startswith('[demo]\n# output-dir = "drsplat-demo"')
    assert text_of(capsys, "demo", "-ox", "--print-config").startswith('[demo]\noutput-dir = "x"\n# overwrite = false')


def test_changes_of_an_edit_are_kept_in_order(tmp_path, capsys):
    line = ["s.ply", "--everything", "--move", "1", "0", "0", "--move", "0", "1", "0", "--turn", "5", "--fill"]
    printed = text_of(capsys, "edit", *line, "--print-config")
    (tmp_path / "e.toml").write_text(printed)
    again = parsed("edit", ["s.ply", "--config", str(tmp_path / "e.toml")])["changes"]
    assert again == parsed("edit", line)["changes"]
    assert [name for name, _ in again] == ["move", "move", "turn", "fill"]
    assert "each option once" in error_of(
        capsys, "edit", *line, "--turn", "6", "--move", "1", "1", "1", "--print-config"
    )


DEEP = {
    "brackets": "[inspect]\nimages = " + "[" * 3000 + "]" * 3000,
    "open brackets": "images = " + "[" * 30_000,
    "dotted": "a." * 10_000 + "b = 1",
    "tables": "[" + "a." * 10_000 + "b]",
    "digits": "[inspect]\nmax-side = " + "9" * 10_000,
    "digits in a list": "[inspect]\nimages = [" + "9" * 10_000 + "]",
    "digits for a flag": "[inspect]\nverify = " + "9" * 4_000,
    "long": "# " + "x" * MAX_FILE_BYTES,
    "surrogate": 'images = "\\ud800"',
    "nul": '[inspect]\nimages = "a\\u0000b"',
    "nan": "[inspect]\nmax-side = nan",
    "date": "[inspect]\nimages = 2020-01-01",
    "table": "[inspect.images]\na = 1",
    "screen": '["ins\\u001b]0;x\\u0007pect"]\n[inspect]\n"\\u001b[2Jx" = 1',
    "config": '[inspect]\nconfig = "x"',
}


@pytest.mark.slow
@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP.keys())
def test_a_hostile_file_is_one_error(text, tmp_path, capsys):
    (tmp_path / "c.toml").write_text(text)
    error = error_of(capsys, "inspect", tmp_path / "none", "--config", tmp_path / "c.toml")
    assert len(error) < 500
    assert "sys." not in error
    assert "\x1b" not in error


def test_values_of_a_file_are_checked_as_those_of_the_line(tmp_path, capsys):
    def fault(text: str) -> str:
        (tmp_path / "c.toml").write_text(text)
        verb = text[1:].partition("]")[0]
        return error_of(capsys, verb, tmp_path / "none", "--config", tmp_path / "c.toml")

    assert "c.toml: background: expected black, grey" in fault('[render]\nbackground = "gray"')
    assert "did you mean grey?" in fault('[render]\nbackground = "gray"')
    assert "c.toml: during: expected 2 values: START END" in fault("[locate]\nduring = 1")
    assert "c.toml: fps: expected a finite number, got 'nan'" in fault("[render]\nfps = nan")
    assert "all and path exclude each other" in fault('[render]\npath = "orbit"\nall = true').replace(
        "path and all", "all and path"
    )


def test_only_regular_files_are_read(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), Path("/dev/null"), tmp_path):
        error = error_of(capsys, "doctor", "--config", path)
        assert error == f"drsplat: error: {path}: expected a file, this is a folder, a pipe or a device\n"


def test_an_option_is_no_option_after_two_dashes(tmp_path, capsys):
    assert parsed("select", ["f", "--", "--config=x"])["text"] == "--config=x"
    error_of(capsys, "inspect", "--", "--log", code=1)
    assert not list(tmp_path.iterdir())
