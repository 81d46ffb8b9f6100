"""The viewer's two waits, server-side: from enter to the highlighted picture, and opening a large scene.

    python benchmarks/bench_viewer.py [--asked 50000] [--loaded 1000000] [--rounds 15] [--threads 0]

asked: a query in words until all that the browser needs is queued: scores, things with their evidence, colours, boxes,
names, the list. loaded: from files (PLY without higher harmonics, field) to a server that a browser can connect to.
Scenes are drawn: things are balls of Gaussians with codes of their own. Needs viser; no browser takes part, so what the
network and the graphics card take comes on top.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from bench_search import IDENTITY, random_code
from machine import arguments

from drsplat import Gaussians, LanguageField, write_gaussians
from drsplat.query import Scene, SceneFiles, open_scene
from drsplat.viewing.panel import Panel
from drsplat.viewing.session import Session
from drsplat.viewing.window import Window

UP = np.array([0.0, 0.0, 1.0])
OF_A_THING = 256  # rows of one group of codes


class ThingEncoder:
    """ "thing 7" is the feature of the first Gaussian of the seventh ball."""

    identity, threshold = IDENTITY, 0.3

    def __init__(self, field: LanguageField) -> None:
        self.field = field

    def encode_texts(self, texts: list[str]) -> np.ndarray:
        return self.field.feature(np.array([int(text.split()[1]) * OF_A_THING for text in texts]))


def drawn_scene(count: int) -> tuple[Gaussians, LanguageField]:
    rng = np.random.default_rng(0)
    centers = np.repeat(rng.uniform(-3, 3, (-(-count // OF_A_THING), 3)), OF_A_THING, axis=0)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    columns = (
        centers[:count] + 0.05 * rng.normal(size=(count, 3)), quats,
        np.exp(rng.normal(-4.5, 0.6, (count, 3))), rng.uniform(0.2, 1, count), rng.normal(0, 0.8, (count, 1, 3)),
    )  # fmt: skip
    scene = Gaussians(*(column.astype(np.float32) for column in columns))
    field = LanguageField(
        np.arange(count, dtype=np.uint32), random_code(count, 128), IDENTITY, scene.fingerprint, count
    )  # fmt: skip
    return scene, field


def seconds_to_ask(count: int, rounds: int, threads: int) -> np.ndarray:
    scene, field = drawn_scene(count)
    source = Scene(field, scene, (), lambda: ThingEncoder(field), name="drawn", threads=threads)
    window = Window(Session(source), UP, port=8935)
    panel, seconds = Panel(window, Path()), []
    for number in range(rounds + 1):
        start = time.perf_counter()
        panel.ask(f"thing {number}")
        seconds.append(time.perf_counter() - start)
        assert len(panel.session.selection), "the query was to find something"
    window.stop()
    return np.array(seconds[1:])  # the first makes the encoder


def seconds_to_load(count: int, threads: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        ply, path = Path(folder) / "scene.ply", Path(folder) / "scene.field"
        scene, field = drawn_scene(count)
        write_gaussians(ply, scene)
        field.save(path)
        del scene, field
        start = time.perf_counter()
        opened = open_scene(SceneFiles("drawn", path, (ply,)), threads=threads)
        read = time.perf_counter()
        window = Window(Session(opened, count), UP, port=8936)
        Panel(window, Path(folder))
        ready = time.perf_counter()
        window.stop()
    return {"read": read - start, "serve": ready - read, "together": ready - start}


def main() -> None:
    given = arguments(__doc__, asked=50_000, loaded=1_000_000, rounds=15, threads=0)
    asked = 1000 * seconds_to_ask(given.asked, given.rounds, given.threads)
    print(
        f"enter to highlighted picture, {given.asked:,} Gaussians: median {np.median(asked):.0f} ms, "
        f"slowest {asked.max():.0f} ms of {len(asked)}"
    )
    loads = [seconds_to_load(given.loaded, given.threads) for _ in range(3)]
    best = min(loads, key=lambda one: one["together"])
    stages = ", ".join(f"{stage} {seconds:.2f} s" for stage, seconds in best.items())
    print(f"loading {given.loaded:,} Gaussians, best of 3: {stages}")


if __name__ == "__main__":
    main()
