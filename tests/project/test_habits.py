"""What people expect of any command: a version, help that fits, options in files, a log, completion, exit codes."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import shtab

from command_line import answer_of, error_of, text_of
from drsplat import cli
from drsplat.cli import VERBS, main, make_parser
from drsplat.fronts.commands.parsing import VerbParser
from drsplat.kernels import available_isas
from toy_capture import write_toy_capture

SETTINGS = (Path(__file__).resolve().parents[2] / "docs/settings.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_toy_capture(tmp_path_factory.mktemp("habits"))
    (folder / "drsplat.toml").write_text(
        'threads = 1\noverwrite = true\n[register]\nfeatures = "capture/language_features"\n'
        'output = "made.field"\nencoder_name = "drsplat-words"\n'
    )
    return folder


def test_version_says_build_and_instruction_set(capsys):
    lines = text_of(capsys, "--version").splitlines()
    assert re.fullmatch(r"drsplat \d+\.\d+\.\d+\S*", lines[0])
    assert re.fullmatch(r"native code by (GCC|Clang) \d.*, \w+ of " + ", ".join(available_isas()), lines[2])


def commands_in(text: str) -> list[str]:
    commands = re.findall(r"^  (drsplat (?:.*\\\n)*.*)", text, re.MULTILINE)
    return [" ".join(command.replace("\\\n", " ").split()) for command in commands]


@pytest.mark.parametrize("verb", VERBS)
def test_help_is_short_fits_in_80_columns_and_tells_of_the_rest(verb, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    short, long = (text_of(capsys, verb, flag) for flag in ("--help", "--help-all"))
    for text in (short, long):
        assert [line for line in text.splitlines() if len(line) > 80 or "None" in line] == []
        assert re.findall(r"\w+-\n", text) == []  # names with hyphens, which people copy, stay whole
        assert re.findall(r"\\\n +[^-\s].*", text) == []  # and values beside their options
    examples = commands_in(sys.modules[f"drsplat.fronts.commands.{verb}"].EXAMPLES)
    assert (commands_in(short), commands_in(long)) == (examples[:3], examples)
    assert len(short.splitlines()) <= 50
    parser = verb_parser(verb)
    flags = {option.option_strings[0]: option for option in parser.options}
    assert {"--config", "--print-config", "--log", "--json"} <= {*flags}
    shown, all_of_them = (
        {flag for flag in flags if re.search(rf"^  {flag}(?![\w-])", text, re.MULTILINE)} for text in (short, long)
    )
    assert all_of_them == {*flags}
    assert parser.daily <= {option.dest for option in parser.options}
    assert shown == {flag for flag, option in flags.items() if option.dest in parser.daily}
    assert {flag for flag, option in flags.items() if option.required} <= shown
    assert f"{len(flags) - len(shown) - 2} more options: drsplat {verb} --help-all" in short  # but these two


def test_help_lists_the_verbs_in_groups(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    text = text_of(capsys, "--help")
    assert [line for line in text.splitlines() if len(line) > 80] == []
    for title, verbs in cli.GROUPS.items():
        block = text.partition(f"\n{title}:\n")[2].partition("\n\n")[0]
        assert re.findall(r"^  (\w+)", block, re.MULTILINE) == list(verbs)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("lokate room", "there is no verb 'lokate'; did you mean locate?"),
        ("Register", "there is no verb 'Register'; did you mean register?"),
        (
            "frobnicate",
            "there is no verb 'frobnicate':\n  make a scene: scan, capture, train, photograph, tile, motion\n",
        ),
        ("--config a.toml locate room", "expected a verb first, then its options: drsplat VERB --config"),
        ("locate room mug --treshold 0.5", "there is no option '--treshold'; did you mean --threshold?"),
        ("locate room mug --thresh=0.5", "there is no option '--thresh'; did you mean --threshold?"),
        ("locate room mug -threshold 0.5", "there is no option '-threshold'; did you mean --threshold?"),
        ("train room --output_dri x", "there is no option '--output_dri'; did you mean --output-dir?"),
        ("locate room mug --zzz", "there is no option '--zzz'\n"),
        ("register a b --code mixtrue", "--code: expected auto, pq or mixture, got 'mixtrue'; did you mean mixture?"),
        ("locate room red vase", "unexpected 'vase': several words need quotes: \"red vase\""),
        ("when room mug on wooden table", "unexpected 'table': several words need quotes: \"wooden table\""),
        ("inspect a b", "unexpected 'b': expected only PATH"),
        ("doctor extra", "unexpected 'extra': expected no arguments but options"),
        ("register a", "the following arguments are required: CAPTURE, --features, --output/-o"),
        ("", "expected a verb, and none was given; a first one to try is drsplat demo:\n  make a scene: scan, capture"),
        ("locate room mug --threshold", "argument --threshold: expected a value: T|auto"),
        ("edit room --move 1 2", "argument --move: expected 3 values: X Y Z"),
        ("locate room mug --threshold nan", "expected a number such as 0.5, or auto, got 'nan'"),
    ],
)
def test_a_slip_of_the_fingers_is_named(line, fault, capsys):
    assert fault in error_of(capsys, *line.split(), code=2)


def test_options_come_from_a_file_and_those_given_count(room, monkeypatch, capsys):
    monkeypatch.chdir(room)
    assert main(["register", "scene.ply", "capture", "--config", "drsplat.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["field"] == "made.field"
    assert main(["register", "scene.ply", "capture", "--config", "drsplat.toml", "--output=other.field"]) == 0
    assert (room / "other.field").is_dir()


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[register]\nlevle = 1", "register has no option 'levle'; did you mean level?"),
        ("[register]\nqqq = 1", "register has no option 'qqq'; it has features, output"),
        ("register = 1", "expected a table"),
        ("[register]\noverwrite = 1", "expected true or false"),
        ("[register]\nlevel = [1, 2]", "expected one value"),
        ("[register]\nlevel = 2026-01-01", "expected a text or a number"),
        ("[register", "expected TOML"),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused(room, text, fault, capsys):
    (room / "bad.toml").write_text(text)
    assert fault in error_of(capsys, "register", "a.ply", "b", "--features", "c", "--config", str(room / "bad.toml"))
    error = error_of(capsys, "doctor", "--config", str(room / "none.toml"))
    assert error.endswith("none.toml: No such file or directory\n")
    assert "Errno" not in error


def verb_parser(verb: str) -> VerbParser:
    parser = make_parser([verb])._subparsers._group_actions[0].choices[verb]
    assert isinstance(parser, VerbParser)
    return parser


def test_the_log_has_what_was_said(tmp_path, capsys):
    log = tmp_path / "said.log"
    for _ in range(2):
        assert main(["inspect", str(tmp_path / "nothing"), "--log", str(log)]) == 1
    lines = log.read_text().splitlines()
    assert len(lines) == 4
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\S+ drsplat inspect .*", lines[0])
    assert "drsplat: error: " in lines[1]
    assert capsys.readouterr().err.count("drsplat: error") == 2
    assert main(["doctor", "--log", str(tmp_path / "no/folder")]) == 1


def test_the_last_log_counts_and_cannot_be_forged(tmp_path, capsys):
    first, last = (tmp_path / f"{name}.log" for name in ("first", "last"))
    forged = "no\n2026 forged \x1b[2J"
    error_of(capsys, "inspect", forged, "--log", first, f"--log={last}", "--", "--log=x", code=2)
    assert [path.name for path in tmp_path.iterdir()] == ["last.log"]
    assert "\x1b" not in last.read_text()
    begin, *rest = last.read_text().splitlines()
    assert begin.endswith(f"drsplat inspect 'no\\n2026 forged \\x1b[2J' --log {first} --log={last} -- --log=x")
    assert all(re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", line) for line in rest)


def test_a_log_is_no_pipe(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    assert "expected a file, this is a pipe" in error_of(capsys, "doctor", "--log", tmp_path / "pipe")


@pytest.mark.slow
def test_without_a_terminal_nothing_is_coloured(room):
    for environment in ({}, {"NO_COLOR": "1", "FORCE_COLOR": "1"}):
        done = subprocess.run(
            [sys.executable, "-m", "drsplat", "inspect", "scene.ply"], cwd=room, env={**os.environ, **environment},
            capture_output=True, check=True,
        )  # fmt: skip
        assert b"\x1b[3" not in done.stdout
        assert b"\x1b" not in done.stderr


def test_completion_knows_verbs_and_options(capsys):
    script = text_of(capsys, "--print-completion", "bash")
    assert all(verb in script for verb in VERBS)
    assert "--vocabulary" in script
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_completes_verbs_options_and_choices(tmp_path, capsys):
    (tmp_path / "drsplat.fish").write_text(text_of(capsys, "--print-completion", "fish"))

    def completed(line: str) -> set[str]:
        command = ["fish", "--no-config", "-c", f"source drsplat.fish; complete -C '{line}'"]
        done = subprocess.run(command, cwd=tmp_path, env={**os.environ, "HOME": str(tmp_path)}, text=True,
                              capture_output=True, check=True)  # fmt: skip
        return {text.split("\t")[0] for text in done.stdout.splitlines()}

    assert completed("drsplat lo") == {"locate"}
    assert completed("drsplat locate --thr") == {"--threads", "--threshold"}
    assert completed("drsplat locate --box ") >= {"upright", "free"}


def test_a_shell_that_shtab_does_not_know_is_named(monkeypatch, capsys):
    assert "expected bash, zsh, tcsh, fish, got 'ksh'" in error_of(capsys, "--print-completion", "ksh", code=2)
    monkeypatch.setattr(shtab, "SUPPORTED_SHELLS", ["bash"])
    assert 'pip install -U "shtab>=1.9.3"' in error_of(capsys, "--print-completion", "fish")


STOPPED = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have started the tests without one
from drsplat import {module} as module
from drsplat.cli import main
whole, done = module.{name}, []
def stopping(*given, **options):
    if len(done) == 2:
        os.kill(os.getpid(), signal.SIGINT)
    done.append(1)
    return whole(*given, **options)
module.{name} = stopping
sys.exit(main(sys.argv[1:]))
"""


def stopped(module: str, name: str, *argv: object) -> str:
    """Run a command that is sent Ctrl-C in the third call of a function; return what it says on stderr."""
    package, _, last = module.rpartition(".")
    script = STOPPED.replace("from drsplat import {module}", f"from drsplat.{package} import {last}").format(name=name)
    done = subprocess.run([sys.executable, "-c", script, *map(str, argv)], capture_output=True, text=True, check=False)
    assert done.returncode == 130
    return done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]])
def test_ctrl_c_in_embed_says_how_to_go_on_and_it_does(room, tmp_path, overwrite, capsys):
    argv = ["embed", room / "capture", "--segmenter", "graph", "--encoder", "drsplat-mini", "-o", tmp_path / "made"]
    if overwrite:
        answer_of(capsys, *argv)
    said = stopped("photos.embedding.embed", "_store", *argv, *overwrite)
    again = "again, without --overwrite, to" if overwrite else "again to"
    assert said.endswith(f"are kept in {tmp_path / 'made'}: give the same command {again} go on\n")
    answer = answer_of(capsys, *argv)  # both photos that were finished, none that is older
    assert (answer["num_photos"], answer["num_photos_reused"]) == (4, 2)


def test_ctrl_c_in_register_says_how_to_go_on(room, tmp_path):
    argv = ["register", room / "scene.ply", room / "capture", "--features", room / "capture/language_features"]
    argv += ["--encoder-name", "drsplat-words", "-o", tmp_path / "a.field"]
    said = stopped("field.evidence.aggregation.record", "view_weights", *argv)
    assert said.endswith(f"are kept in {tmp_path / 'a.field.parts'}: give the same command again to go on\n")
    assert len(list((tmp_path / "a.field.parts").glob("*.columns.safetensors"))) == 2


def test_a_stopped_demo_goes_on(tmp_path, monkeypatch, capsys):
    """Without embedding again what it has embedded; a folder of another origin is refused."""
    monkeypatch.chdir(tmp_path)

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    seen: list[bool] = []
    monkeypatch.setattr("drsplat.evaluation.demo.story.embed", lambda *_, overwrite, **__: seen.append(overwrite))
    monkeypatch.setattr("drsplat.evaluation.demo.story.read_features", stop)
    again = "drsplat: interrupted: the photos embedded so far are kept in here: give the same command again to go on\n"
    for _ in range(2):
        assert main(["demo", "-o", "here"]) == 130
        assert capsys.readouterr().err == again
    assert main(["demo", "-o", "here", "--overwrite"]) == 130
    assert "again, without --overwrite, to go on" in capsys.readouterr().err
    assert seen == [False, False, True]
    (tmp_path / "here/UNFINISHED").unlink()
    assert "exists already" in error_of(capsys, "demo", "-o", "here")


def test_the_documented_exit_codes_are_the_ones():
    table = SETTINGS.partition("## Exit codes")[2].partition("\n## ")[0]
    documented = [int(code) for code in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)]
    assert documented == [0, cli.FAILED, cli.MISUSED, cli.INTERRUPTED, cli.PIPE_CLOSED]
