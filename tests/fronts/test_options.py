"""Options with odd values: every verb, every option; an error of a line or an answer, and no traceback."""

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drsplat import cli, load_field, read_gaussians
from drsplat.cli import make_parser
from drsplat.fronts.commands.declaring import MAX_COUNT, MAX_NUMBER, finite, length, whole, words
from fields import with_flat_objects
from toy_capture import PER_THING, write_toy_capture

NO_NUMBERS = [
    "",
    "-1",
    "1.5",
    "²",
    "１２",
    "1e3",
    "0x10",
    " 1",
    "+1",
    "2147483648",
    "99999999999999999999",
    "9" * 5000,
    "nan",
]
NO_FLOATS = ["", "nan", "inf", "-inf", "1e39", "-1e999", "9" * 5000, "high", "²"]
NUMBERS = ["0", "1", "2147483647", "3e38", "-3e38"]  # extreme, and of an option that takes them
TEXTS = ["\ud800", "x\udc80", "\x1b[2J", "", "/dev/null", "9" * 5000]
LASTING = {"serve", "mcp", "doctor", "demo"}  # that run until stopped, or take nothing


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_toy_capture(tmp_path_factory.mktemp("options"))
    argv = ["register", "scene.ply", "capture", "--features", "capture/language_features"]
    argv += ["--encoder-name", "drsplat-words", "-o", "room.field"]
    subprocess.run([sys.executable, "-m", "drsplat", *argv], cwd=folder, check=True)
    field = load_field(folder / "room.field")
    named = with_flat_objects(field, read_gaussians(folder / "scene.ply"), field.gaussian_ids // PER_THING)
    named.save(folder / "room.field", overwrite=True)
    return folder


def options_of(verb: str) -> Iterator[argparse.Action]:
    """Those that take one value."""
    choices = next(a.choices for a in make_parser()._actions if a.choices)
    assert isinstance(choices, dict)
    for action in choices[verb]._actions:
        if action.option_strings and action.nargs in (None, "?", "*"):
            yield action


def refused(action: argparse.Action, text: str) -> bool:
    assert callable(action.type)
    try:
        action.type(text)
    except (argparse.ArgumentTypeError, ValueError) as error:
        return len(str(error)) < 200
    return False


def is_number(action: argparse.Action) -> bool:
    return callable(action.type) and refused(action, "x") and not refused(action, "1")


def values_of(action: argparse.Action) -> list[str]:
    if action.dest in ("iterations", "voxel_side"):  # which take their time
        return []
    if action.choices or action.dest in ("encoder", "segmenter", "host", "ask", "save_dir"):
        return TEXTS[:2]
    return NUMBERS if is_number(action) else TEXTS


def test_every_option_that_is_a_number_refuses_what_is_none():
    seen = set()
    for verb in cli.VERBS:
        for action in options_of(verb):
            if is_number(action) and not action.choices:
                assert callable(action.type)
                no_numbers = NO_NUMBERS if type(action.type("1")) is int else NO_FLOATS
                assert [text for text in no_numbers if not refused(action, text)] == [], action
                seen.add(action.option_strings[0])
    assert seen > {"--threads", "--topk", "--max-side", "--iterations", "--port", "--voxel-side"}


@given(st.text() | st.integers().map(str) | st.floats().map(str))
def test_a_number_is_read_or_refused(text):
    for read, low, high in ((whole, 0, MAX_COUNT), (finite, -MAX_NUMBER, MAX_NUMBER), (length, 0, MAX_NUMBER)):
        try:
            number = read(text)
        except argparse.ArgumentTypeError:
            continue
        assert low <= number <= high


def test_numbers_are_read():
    assert [whole(text) for text in ("0", "007", "2147483647")] == [0, 7, MAX_COUNT]
    assert (finite("-1e3"), length("0.5"), words("größer")) == (-1000, 0.5, "größer")


def a_run_of(verb: str, room: Path, out: Path) -> list[str]:
    """What answers in an instant, for an option to be added to."""
    field, scene, capture = (str(room / name) for name in ("room.field", "scene.ply", "capture"))
    asked = ["--scene", scene, "--views", capture]
    return {
        "train": [
            capture,
            "-o",
            str(out / "model"),
            "--iterations",
            "1",
            "--overwrite",
            "--resolution",
            "32",
            "--max-gaussians",
            "50",
        ],
        "scan": [
            *[capture, "-o", str(out / "room"), "--iterations", "1", "--overwrite"],
            *["--segmenter", "graph", "--encoder", "drsplat-mini"],
        ],
        "capture": [str(room / "frames"), "-o", str(out / "capture")],  # no photos: refused at once
        "inspect": [capture],
        "embed": [capture, "--segmenter", "graph", "--encoder", "drsplat-mini", "-o", str(out / "lf")],
        "codebook": ["train", str(out / "none.npy"), "--encoder-name", "x", "-o", str(out / "b.safetensors")],
        "register": [
            scene,
            capture,
            "--features",
            f"{capture}/language_features",
            "-o",
            str(out / "a.field"),
            "--overwrite",
        ],
        "objects": [field, *asked],
        "field": ["carry", field, scene, "--scene", scene, "-o", str(out / "carried.field"), "--overwrite"],
        "add": [field, capture, "--features", f"{capture}/language_features", "--scene", scene],
        "remove": [field, "--scene", scene, "--views", "photo_0"],
        "select": [field, "red mug", *asked],
        "tile": [scene, "-o", str(out / "s.tiles"), "--overwrite"],
        "locate": [field, "red mug", *asked],
        "segment": [field, "--classes", "red mug,blue plate", *asked],
        "edit": [str(shutil.copy(scene, out / "edited.ply")), "--field", field, "--everything", "--views", capture],
        "render": [scene, "--views", capture, "--view", "photo_0", "-o", str(out), "--overwrite"],
        "view": [
            field,
            *asked,
            "--export",
            str(out / "page.html"),
            "--ask",
            "red mug",
            "--overwrite",
            "--words",
            "mug",
        ],
        "export": [scene, "--field", field, "--views", capture, "-o", str(out / "out.glb"), "--overwrite"],
        "photograph": [
            *[scene, "-o", str(out / "pictures"), "--overwrite"],
            *["--size", "32x24", "--number", "2", "--path", "swing"],
        ],
        "motion": [str(room / "frames"), "-o", str(out / "s.motion"), "--overwrite"],
        "when": [field, "red mug", "above", "blue plate", *asked],
        "catalogue": ["ask", str(out / "none.catalogue"), "red mug"],
        "evaluate": ["voxel", str(out), "--name", "x", "--scene", scene, "--field", field, "--report", str(out / "r")],
    }[verb]


@pytest.mark.slow
@pytest.mark.parametrize("verb", [verb for verb in cli.VERBS if verb not in LASTING])
def test_no_value_of_an_option_is_a_traceback(verb, room, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    tried = 0
    for action in options_of(verb):
        for value in values_of(action):
            argv = [verb, *a_run_of(verb, room, tmp_path), f"{action.option_strings[0]}={value}"]
            code, (out, err) = cli.main(argv), capsys.readouterr()
            assert code in (0, 1, 2), (action.dest, value)
            assert code != 0 or value not in ("", "\ud800"), action.dest
            assert "\x1b" not in out + err, (action.dest, value)
            assert "RuntimeWarning" not in err
            tried += 1
    assert tried > 5


@pytest.mark.slow
@pytest.mark.parametrize("argv", [["inspect", "{room}/scene.ply"], ["inspect", "nowhere"]])
@pytest.mark.parametrize("json", [[], ["--json"]])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_behind_stdout_is_one_line(argv, json, room):
    command = [sys.executable, "-m", "drsplat", *(part.format(room=room) for part in argv), *json]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("drsplat: error: ")
    assert done.stderr.count("\n") == 1


def test_arguments_that_are_no_text_are_refused(room):
    """As bytes, which is how a shell hands them over."""
    command = [os.fsencode(sys.executable), b"-m", b"drsplat", b"select", os.fsencode(room / "room.field")]
    done = subprocess.run([*command, b"red \x80"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "expected text in UTF-8, got 'red \\udc80'" in done.stderr
