"""Photos that are sent to a service one a second: how long until answers know them, and what else is answered.

    drsplat demo --output-dir drsplat-demo
    python benchmarks/bench_live_views.py drsplat-demo [--first 12] [--every 1.0] [--light] [--workers 2]

The demo's room with its first photos registered; the others are sent, with their poses. Four times a second a client
asks where the red vase is, before the first photo and until the last one is added. From sending to being answerable:
from the moment before the POST to the change of the field, as the service notes it. --light: a field without objects
and with a codebook that was given, of which only the rows that a new photo sees are coded again. Seconds of the
processor are of the process that adds and of all others.
"""

import base64
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
from machine import arguments, wait_for

from drsplat import MiniEncoder, View, load_field, load_segmenter, read_features, read_gaussians, read_views
from drsplat.field.codes import Smaller
from drsplat.field.objects.finding import find_objects
from drsplat.field.registration import register
from drsplat.photos.embedding.embed import embed

KEY = "0123456789abcdef-key"
ASKING_S = 0.25
WARM_UP_S = 15
TICKS = os.sysconf("SC_CLK_TCK")
USER, SYSTEM, START = 11, 12, 19  # fields of /proc/PID/stat after the name


def write_room(demo: Path, folder: Path, names: list[str], light: bool) -> None:
    shutil.copytree(demo, folder, ignore=shutil.ignore_patterns("*.field", "language_features", "answers", "images"))
    poses = folder / "sparse/0/images.txt"
    lines = [line for line in poses.read_text().splitlines() if line.rpartition(" ")[2] in names]
    poses.write_text("".join(f"{line}\n\n" for line in lines))
    (folder / "images").mkdir()
    for name in names:
        shutil.copy(demo / "images" / name, folder / "images")
    views, gaussians = read_views(folder), read_gaussians(folder / "scene.compressed.ply")
    embed(views, folder / "language_features", load_segmenter("graph"), MiniEncoder())
    registration = register(gaussians, views, read_features(folder / "language_features"))
    field = registration.to_field(load_field(demo / "room.field").codebook if light else Smaller())
    if not light:
        field = field.with_objects(find_objects(field, gaussians))
    field.save(folder / "room.field")


def body_of(view: View) -> dict[str, Any]:
    assert view.image_path is not None
    lens = {"fx": view.K[0, 0], "fy": view.K[1, 1], "cx": view.K[0, 2], "cy": view.K[1, 2]}
    picture = base64.b64encode(view.image_path.read_bytes()).decode()
    return {
        "name": view.name,
        "picture": picture,
        "pose": {"cam_from_world": view.cam_from_world.tolist()},
        "lens": lens,
    }


def fetch(port: int, route: str, body: Any = None) -> dict[str, Any]:
    headers = {"content-type": "application/json", "x-api-key": KEY}
    data = None if body is None else json.dumps(body).encode()
    with urlopen(Request(f"http://127.0.0.1:{port}/scenes/room{route}", data, headers), timeout=60) as reply:
        return dict(json.load(reply))


class Asking(threading.Thread):
    """A client that asks the same again and again."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.port, self.seconds, self.fields, self.done = port, [], set(), threading.Event()

    def run(self) -> None:
        while not self.done.wait(ASKING_S):
            start = time.perf_counter()
            self.fields.add(fetch(self.port, "/locate", {"text": "red vase"})["field"])
            self.seconds.append(time.perf_counter() - start)


def cpu_seconds(server: int) -> tuple[float, float]:
    """Of the process that adds, which was started last, and of all others."""
    children = [
        int(one) for task in Path(f"/proc/{server}/task").glob("*/children") for one in task.read_text().split()
    ]
    stats = [Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in (server, *children)]
    seconds = [(int(stat[USER]) + int(stat[SYSTEM])) / TICKS for stat in stats]
    adding = max(range(len(stats)), key=lambda number: int(stats[number][START]))
    return seconds[adding], sum(seconds) - seconds[adding]


def asked_for(port: int, seconds: float) -> Asking:
    asking = Asking(port)
    asking.start()
    time.sleep(seconds)
    return asking


def row(name: str, seconds: list[float]) -> None:
    low, high = np.percentile(seconds, (50, 95))
    print(f"{name:>34}: {len(seconds):4d}, median {low:6.2f} s, p95 {high:6.2f} s, most {max(seconds):6.2f} s")


def send(port: int, views: list[View], every: float) -> tuple[dict[str, float], list[float]]:
    """Send photos, and wait until all are added; returns when each was sent, and how long each request took."""
    sent, posts = {}, []
    for view in views:
        body = body_of(view)
        sent[view.name] = time.time()
        fetch(port, "/views", body)
        posts.append(time.time() - sent[view.name])
        time.sleep(max(0, sent[view.name] + every - time.time()))
    while fetch(port, "/views")["num_waiting"]:
        time.sleep(0.2)
    return sent, posts


def measure(port: int, server: int, coming: list[View], every: float) -> None:
    send(port, coming[:1], 0)  # models are loaded
    start = cpu_seconds(server)[0]
    send(port, coming[1:2], 0)
    print(f"one photo alone: {cpu_seconds(server)[0] - start:.1f} s of the processor")
    fetch(port, "/locate", {"text": "red vase"})
    before = asked_for(port, WARM_UP_S)
    before.done.set()
    meanwhile, start_s = asked_for(port, 0), cpu_seconds(server)
    sent, posts = send(port, coming[2:], every)
    meanwhile.done.set()
    adding, others = (after - then for after, then in zip(cpu_seconds(server), start_s, strict=True))
    states = [state for state in fetch(port, "/views")["views"] if state["name"] in sent]
    assert {state["state"] for state in states} == {"added"}
    row("from sending to being answerable", [state["ended"] - sent[state["name"]] for state in states])
    row("POST of a photo", posts)
    row("locate, before", before.seconds)
    row("locate, meanwhile", meanwhile.seconds)
    changes = len({state["ended"] for state in states})
    print(f"{len(states)} photos in {changes} changes, answers of {len(meanwhile.fields)} versions of the field")
    print(f"seconds of the processor: {adding:.1f} adding, {adding / len(states):.2f} a photo; all others {others:.1f}")


def main() -> None:
    given = arguments(__doc__, "demo", first=12, every=1.0, light=False, workers=2)
    views = [view for view in read_views(given.demo) if (given.demo / "language_features").is_dir()]
    known = {path.name.partition(".")[0] for path in (given.demo / "language_features").glob("*.safetensors")}
    views = [view for view in views if Path(view.name).stem in known]
    with tempfile.TemporaryDirectory() as name, socket.socket() as free:
        folder = Path(name)
        write_room(given.demo, folder / "scenes/room", [view.name for view in views[: given.first]], given.light)
        (folder / "key.txt").write_text(KEY)
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        options = ["--port", str(port), "--workers", str(given.workers), "--take-views", "--json"]
        command = [sys.executable, "-m", "drsplat", "serve", str(folder / "scenes"), *options]
        server = subprocess.Popen([*command, "--api-key-file", str(folder / "key.txt")], stdout=subprocess.DEVNULL)
        try:
            wait_for(port)
            measure(port, server.pid, views[given.first :], given.every)
        finally:
            server.terminate()
            server.wait(60)


if __name__ == "__main__":
    main()
