"""Every line of the README, in its order, in one folder: with toy models and data under the very names.

The CLIP is real code with random weights; colours stand in for SAM. What is asserted is that a newcomer who
types the lines one after another meets no error, and that identities hold from embedding to question.
"""

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import drsplat as ds
from drsplat.cli import VERBS, main
from drsplat.errors import MismatchError
from drsplat.models import sam
from fake_models import ColorSegmenter
from lvis_files import write_set
from toy_capture import NEGATIVES, THINGS, write_toy_capture
from written_captures import write_colmap_text

pytest.importorskip("transformers", reason="the extra drsplat[models] is not installed")
pytest.importorskip("viser", reason="the extra drsplat[viewer] is not installed")
pytest.importorskip("fastapi", reason="the extra drsplat[serve] is not installed")
pytest.importorskip("mcp", reason="the extra drsplat[mcp] is not installed")

from tiny_encoders import write_model

README = Path(__file__).resolve().parent.parent / "README.md"
CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
LASTING = ("view", "serve", "mcp")
DIM = 128  # what 128 sub-vectors divide


def tour() -> list[list[str]]:
    """The lines of the tour, then the commands in the text around it; no line is left out."""
    text = README.read_text(encoding="utf-8")
    blocks = re.findall(r"^```bash\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    inline = re.findall(r"`(drsplat [^`]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    whole = [line for line in inline if len(line.split()) > 2]  # others are names of verbs
    commands = [shlex.split(line, comments=True) for line in [*lines, *whole]]
    return [command[1:] for command in commands if command[:1] == ["drsplat"]]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the tour begins: a scene, its photos without features, models, data sets, the demo's folder."""
    folder = write_toy_capture(tmp_path_factory.mktemp("tour"))
    write_demo(folder)
    shutil.rmtree(folder / "capture/language_features")
    write_poses_and_points(folder)
    write_model(folder / CLIP, "clip", dim=DIM, tokens=40)  # for the longest noun
    encoder = ds.load_encoder(str(folder / CLIP), "cpu")
    texts = [*THINGS, *NEGATIVES]
    vectors = dict(zip(texts, encoder.encode_texts(texts).tolist(), strict=True))
    (folder / "clip_texts.json").write_text(json.dumps(vectors))
    write_set(folder).rename(folder / "lvis_v1_train.json")
    (folder / "images").rename(folder / "coco")
    write_lerf(folder)
    (folder / "scenes/mugs").mkdir(parents=True)
    (folder / "scenes/mugs/scene.ply").symlink_to(folder / "scene.ply")
    for name in ("scenes/mugs/mugs.field", "teatime.field"):
        (folder / name).symlink_to(folder / "scene.field")
    (folder / "teatime.ply").symlink_to(folder / "scene.ply")
    return folder


def write_demo(folder: Path) -> None:
    """drsplat-demo/ with a field that needs no model for words, as the demo's own."""
    demo = folder / "drsplat-demo"
    demo.mkdir()
    (demo / "scene.ply").symlink_to(folder / "scene.ply")
    words = ds.WordEncoder.identity
    features = ds.read_features(folder / "capture/language_features", encoder=words)
    gaussians, views = ds.read_gaussians(folder / "scene.ply"), ds.read_views(folder / "capture")
    ds.register(gaussians, views, features).to_field().save(demo / "room.field")


def write_poses_and_points(folder: Path) -> None:
    """The capture's cameras as COLMAP has them, with points: training starts from some, not from 100,000."""
    views, means = ds.read_views(folder / "capture"), ds.read_gaussians(folder / "scene.ply").means
    cameras, images = [], []
    for number, view in enumerate(views, 1):
        K, pose = view.K, view.cam_from_world
        cameras.append((number, "PINHOLE", view.width, view.height, (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
        turned = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)
        images.append((number, turned, pose[:3, 3], number, view.name))
    plain = [(n, m, w, h, tuple(map(float, p))) for n, m, w, h, p in cameras]
    posed = [(n, tuple(map(float, q)), tuple(map(float, t)), c, name) for n, q, t, c, name in images]
    points = [(n, tuple(map(float, mean)), (128, 128, 128)) for n, mean in enumerate(means[::30], 1)]
    write_colmap_text(folder / "capture/sparse/0", plain, posed, points)
    (folder / "capture/cameras.json").unlink()


def write_lerf(folder: Path) -> None:
    """lerf_ovs/ with one scene, teatime: the capture, with the mug labelled in its first photo."""
    labels = folder / "lerf_ovs/label/teatime"
    labels.mkdir(parents=True)
    (folder / "lerf_ovs/teatime").symlink_to(folder / "capture")
    view = ds.read_views(folder / "capture")[0]
    box = [30, 20, 60, 50]
    corners = [[30, 20], [60, 20], [60, 50], [30, 50]]
    thing = {"category": "red mug", "bbox": box, "segmentation": corners}
    info = {"name": view.name, "width": view.width, "height": view.height}
    document = {"info": info, "objects": [thing]}
    (labels / view.name).with_suffix(".json").write_text(json.dumps(document))


def test_the_tour_has_every_verb() -> None:
    assert {command[0] for command in [*tour(), ["demo"]]} == set(VERBS)


def test_every_line_runs(place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In one go, because each builds on those before."""
    monkeypatch.chdir(place)
    monkeypatch.setattr(sam, "load_segmenter", lambda *_: ColorSegmenter())
    for line in tour():
        command = ["30" if word == "7000" else word for word in line]  # iterations: they take minutes
        if command[0] in ("when", "edit"):  # which need a match: a toy's encoder knows no mug from a plate
            command += ["--threshold", "-1"]
        if command[0] in LASTING and "--export" not in command:
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
