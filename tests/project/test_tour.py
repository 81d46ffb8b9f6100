"""Every line of docs/tour.md and of the README, in one folder: with toy models and data under the very names.

The CLIP is real code with random weights; colours stand in for SAM. What is asserted is that a newcomer who
types the lines one after another meets no error, and that identities hold from embedding to question.
"""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

import drsplat as ds
from drsplat.cli import VERBS, main
from drsplat.errors import MismatchError
from drsplat.photos.models import sam
from fake_models import ColorSegmenter

pytest.importorskip("transformers", reason="the extra drsplat[models] is not installed")
pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("mcp", reason="the extra drsplat[mcp] is not installed")

from toured import DIM, commands_of, write_tour

ROOT = Path(__file__).resolve().parents[2]
TOUR, README = ROOT / "docs/tour.md", ROOT / "README.md"
CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
LASTING = ("view", "serve", "mcp")


def tour() -> list[list[str]]:
    """The lines of the tour, then the commands in the text around it; no line is left out."""
    text = TOUR.read_text(encoding="utf-8") + README.read_text(encoding="utf-8")
    inline = re.findall(r"`(drsplat [^`]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    whole = [line for line in inline if len(line.split()) > 2]  # others are names of verbs
    return [*commands_of(TOUR), *commands_of(README), *(shlex.split(line)[1:] for line in whole)]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tour(tmp_path_factory.mktemp("tour"), CLIP)


def test_the_tour_has_every_verb() -> None:
    assert {command[0] for command in [*tour(), ["demo"]]} == set(VERBS)


@pytest.mark.slow
def test_every_line_runs(place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In one go, because each builds on those before."""
    monkeypatch.chdir(place)
    monkeypatch.setattr(sam, "load_segmenter", lambda *_, **__: ColorSegmenter())
    for line in tour():
        short = {"scene.sog": "scene.ply"}  # the toy has no SOG
        command = [short.get(word, word) for word in line]
        if command[0] in ("when", "edit"):  # which need a match: a toy's encoder knows no mug from a plate
            command += ["--threshold", "-1"]
        if command[0] == "scan":  # the toy's photos as a capture; the segmenter would be looked for on the hub
            command = [*("capture" if word == "photos" else word for word in command), "--segmenter", "graph"]
            command += ["--iterations", "30"]
        if command[0] == "train":
            command += ["--iterations", "30"]
        if command[0] in (
            "capture",
            "photograph",
        ):  # the folder is there; and toy photos have no poses to find (photos/test_capture.py has some)
            assert main(command) == 1
            assert (place / "capture" / "images").is_dir(), "a capture that others made stays"
        elif command[0] in LASTING and "--export" not in command:
            started_asked_and_stopped(command, place)
        else:
            assert main(command) == 0, f"{command}: {capsys.readouterr().err}"
    field, encoder = ds.load_field("scene.field"), ds.load_encoder(CLIP, "cpu")
    assert field.encoder == encoder.identity
    assert field.encoder.weights
    for name in ("mug_ids.npy", "found.ply", "classes.ply", "out/results.json", "page.html"):
        assert (place / name).is_file()
    snippet = re.findall(r"^```python\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)
    exec(compile(snippet[0].replace("codebook.safetensors", "clip.safetensors"), "README", "exec"), {})

    argv = "register scene.ply capture --features capture/language_features --output other.field"
    assert main([*argv.split(), "--encoder-name", "ViT-B-16/laion2b_s34b_b88k"]) == 1
    error = capsys.readouterr().err
    assert f"was embedded by '{Path(CLIP).name}" in error
    assert "name no encoder" in error
    assert not (place / "other.field").exists()
    with pytest.raises(MismatchError, match="was embedded by"):
        ds.read_features("capture/language_features", encoder=ds.EncoderIdentity("ViT", DIM))


def started_asked_and_stopped(command: list[str], place: Path) -> None:
    """A line that runs until it is interrupted, on a port of its own where it has one."""
    port = {"view": ["--port", "18680"], "serve": ["--port", "18765"], "mcp": []}[command[0]]
    process = subprocess.Popen(
        [sys.executable, "-m", "drsplat", *command, *port],
        cwd=place, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        if command[0] == "mcp":
            process.stdin.write(json.dumps(HELLO) + "\n")
            process.stdin.flush()
            assert "drsplat" in json.loads(process.stdout.readline())["result"]["serverInfo"]["name"]
            process.stdin.close()  # which ends it
        else:
            line = process.stdout.readline()
            address = re.search(r"http://\S+:\d+(?:/scenes)?", line)
            assert address, line
            assert asked(address[0])
            process.send_signal(signal.SIGINT)
        assert process.wait(60) in (0, 130)
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            pipe.close()


HELLO = {
    "jsonrpc": "2.0", "id": 1, "method": "initialize",
    "params": {"protocolVersion": "2025-03-26", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}},
}  # fmt: skip


def asked(address: str) -> bytes:
    """Its answer; a server says where it is a moment before it listens."""
    for _ in range(100):
        try:
            with urllib.request.urlopen(address, timeout=60) as answer:
                content: bytes = answer.read()
                return content
        except urllib.error.URLError:
            time.sleep(0.2)
    raise AssertionError(f"nobody answers at {address}")
