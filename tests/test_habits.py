"""What people expect of any command: a version, help that fits, options in files, a log, completion, exit codes."""

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from command_line import Capture, error_of, text_of
from drsplat import cli
from drsplat.cli import VERBS, main, make_parser
from drsplat.commands.configuring import configuration, configured, verb_of
from drsplat.kernels import available_isas
from toy_capture import write_toy_capture

SETTINGS = (Path(__file__).resolve().parent.parent / "docs/settings.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_toy_capture(tmp_path_factory.mktemp("habits"))
    (folder / "drsplat.toml").write_text(
        'threads = 1\noverwrite = true\n[register]\nfeatures = "capture/language_features"\n'
        'output = "made.field"\nencoder_name = "drsplat-words"\n'
    )
    return folder


def test_version_says_build_and_instruction_set(capsys: Capture) -> None:
    lines = text_of(capsys, "--version").splitlines()
    assert re.fullmatch(r"drsplat \d+\.\d+\.\d+\S*", lines[0])
    assert re.fullmatch(r"native code by (GCC|Clang) \d.*, \w+ of " + ", ".join(available_isas()), lines[2])


@pytest.mark.parametrize("verb", [*VERBS, ""])
def test_help_fits_in_80_columns(verb: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = text_of(capsys, *([verb] if verb else []), "--help")
    assert [line for line in text.splitlines() if len(line) > 80] == []
    commands = re.findall(r"^  (drsplat (?:.*\\\n)*.*)", text, re.MULTILINE)
    examples = getattr(sys.modules.get(f"drsplat.commands.{verb}"), "EXAMPLES", "")
    assert [" ".join(command.replace("\\\n", " ").split()) for command in commands] == [
        " ".join(command.replace("\\\n", " ").split())
        for command in re.findall(r"^  (drsplat (?:.*\\\n)*.*)", examples, re.MULTILINE)
    ]


def test_options_come_from_a_file_and_those_given_count(
    room: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(room)
    assert main(["register", "scene.ply", "capture", "--config", "drsplat.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["field"] == "made.field"
    assert main(["register", "scene.ply", "capture", "--config", "drsplat.toml", "--output=other.field"]) == 0
    assert (room / "other.field").is_dir()


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[register]\nlevle = 1", "register has no option 'levle'"),
        ("register = 1", "expected a table"),
        ("[register]\noverwrite = 1", "expected true or false"),
        ("[register]\nlevel = [1, 2]", "expected one value"),
        ("[register]\nlevel = 2026-01-01", "expected a text or a number"),
        ("[register", "expected TOML"),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused(room: Path, text: str, fault: str, capsys: Capture) -> None:
    (room / "bad.toml").write_text(text)
    assert fault in error_of(capsys, "register", "a.ply", "b", "--features", "c", "--config", str(room / "bad.toml"))
    assert "No such file" in error_of(capsys, "doctor", "--config", str(room / "none.toml"))


@pytest.mark.parametrize(
    "argv",
    [
        ["locate", "a b.field", 'red "mug"\n', "--exclude", "x", "--exclude=\\y", "--threads", "2"],
        ["remove", "a.field", "--scene", "s.ply", "--views", "one", "2", "--json"],
        ["train", "capture", "--output-dir", "model", "--save-at", "7", "8", "--overwrite"],
    ],
)
def test_what_is_printed_can_be_read_again(argv: list[str], tmp_path: Path, capsys: Capture) -> None:
    positional = [text for text in argv[1:3] if not text.startswith("-")][: 2 if argv[0] == "locate" else 1]
    (tmp_path / "printed.toml").write_text(text_of(capsys, *argv, "--print-config"))
    again = configured([argv[0], *positional, "--config", str(tmp_path / "printed.toml")], make_parser())
    assert values(again) == values(argv)


def values(argv: list[str]) -> dict[str, object]:
    parsed = vars(make_parser().parse_args(argv))
    return {name: value for name, value in parsed.items() if name not in ("config", "command", "flags")}


def test_defaults_stand_in_comments() -> None:
    text = configuration(["demo"], make_parser())
    assert text.startswith('[demo]\n# output-dir = "drsplat-demo"')


def test_every_verb_has_the_habits() -> None:
    for name in VERBS:
        verb = verb_of(make_parser(), [name])
        assert verb is not None
        assert {"--config", "--print-config", "--log", "--json"} <= set(flags_of(verb))


def flags_of(verb: argparse.ArgumentParser) -> Iterator[str]:
    return (flag for action in verb._actions for flag in action.option_strings)


def test_the_log_has_what_was_said(tmp_path: Path, capsys: Capture) -> None:
    log = tmp_path / "said.log"
    for _ in range(2):
        assert main(["inspect", str(tmp_path / "nothing"), "--log", str(log)]) == 1
    lines = log.read_text().splitlines()
    assert len(lines) == 4
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\S+ drsplat inspect .*", lines[0])
    assert "drsplat: error: " in lines[1]
    assert capsys.readouterr().err.count("drsplat: error") == 2
    assert main(["doctor", "--log", str(tmp_path / "no/folder")]) == 1


def test_without_a_terminal_nothing_is_coloured(room: Path) -> None:
    for environment in ({}, {"NO_COLOR": "1", "FORCE_COLOR": "1"}):
        done = subprocess.run(
            [sys.executable, "-m", "drsplat", "inspect", "scene.ply"], cwd=room, env={**os.environ, **environment},
            capture_output=True, check=True,
        )  # fmt: skip
        assert b"\x1b[3" not in done.stdout
        assert b"\x1b" not in done.stderr


def test_completion_knows_verbs_and_options(capsys: Capture) -> None:
    pytest.importorskip("shtab", reason="the extra drsplat[completion] is not installed")
    script = text_of(capsys, "--print-completion", "bash")
    assert all(verb in script for verb in VERBS)
    assert "--vocabulary" in script
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


def test_the_documented_exit_codes_are_the_ones() -> None:
    table = SETTINGS.partition("## Exit codes")[2].partition("\n## ")[0]
    documented = [int(code) for code in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)]
    assert documented == [0, cli.FAILED, cli.MISUSED, cli.INTERRUPTED, cli.PIPE_CLOSED]
