"""The viewer's waits, server-side: from a query to all that a browser draws of it, and opening a large scene.

    python benchmarks/bench_viewer.py [--asked 100000] [--loaded 1000000] [--rounds 15] [--threads 1] [--folder DEMO]

asked: a query in words until its state (JSON) and its paint (arrays) are bytes, with the scores, things with their
evidence, boxes and counts; then a threshold that is moved. loaded: from files (PLY without higher harmonics, field) to
the bytes of all splats. Scenes are drawn: things are balls of Gaussians with codes of their own; with --folder, the one
that `drsplat demo` wrote is asked too. No browser takes part, so what the network and the graphics card take comes on
top. Times are of the processor (CPU), which other programs disturb least.
"""

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench_search import IDENTITY, random_code
from machine import arguments

from drsplat import Gaussians, LanguageField, write_gaussians
from drsplat.fronts.viewing.live.acts import done, read_act
from drsplat.fronts.viewing.live.shared import Shared
from drsplat.fronts.viewing.saving import Saves
from drsplat.fronts.viewing.session import Session
from drsplat.query import Scene, SceneFiles, open_scene

OF_A_THING = 256  # rows of one group of codes
WORDS = ("red vase", "candle", "couch", "laptop", "something to eat")  # of the demo


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


def viewer_of(scene: Scene, budget: int = 1_000_000) -> Shared:
    shared = Shared(Saves(None), lambda path: open_scene(path))
    shared.show(Session(scene, budget, edits_kept=False))
    shared.note()
    return shared


def cpu_ms(act: Callable[[], object]) -> float:
    begin = time.process_time()
    act()
    return 1000 * (time.process_time() - begin)


def acted(shared: Shared, **given: object) -> None:
    """What one press costs: the act, its state as JSON, and the paint."""
    json.dumps(done(shared, read_act(json.dumps(given).encode())))
    shared.paint()


def times_of(shared: Shared, texts: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds of queries, and of thresholds that are moved after each; the first makes the encoder."""
    acted(shared, act="ask", text=texts[0])
    shared.splats()
    asked, moved = [], []
    for text in texts[1:]:
        asked.append(cpu_ms(lambda text=text: acted(shared, act="ask", text=text)))
        low, high = shared.session.results[0].limits
        at = low + 0.7 * (high - low)
        moved.append(cpu_ms(lambda at=at: acted(shared, act="threshold", query=0, value=at)))
    return np.array(asked), np.array(moved)


def told(what: str, asked: np.ndarray, moved: np.ndarray) -> None:
    for name, times in (("query to state and paint", asked), ("threshold to state and paint", moved)):
        print(f"{what}, {name}: median {np.median(times):.1f} CPU ms, slowest {times.max():.1f} of {len(times)}")


def load_ms(count: int, threads: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        ply, path = Path(folder) / "scene.ply", Path(folder) / "scene.field"
        scene, field = drawn_scene(count)
        write_gaussians(ply, scene)
        field.save(path)
        del scene, field
        held: list[Scene] = []
        read = cpu_ms(lambda: held.append(open_scene(SceneFiles("drawn", path, (ply,)), threads=threads)))
        serve = cpu_ms(lambda: viewer_of(held[0], count).splats())
    return {"read": read, "splats": serve, "together": read + serve}


def main() -> None:
    given = arguments(__doc__, asked=100_000, loaded=1_000_000, rounds=15, threads=1, folder="")
    scene, field = drawn_scene(given.asked)
    source = Scene(field, scene, (), lambda: ThingEncoder(field), name="drawn", threads=given.threads)
    told(f"{given.asked:,} Gaussians", *times_of(viewer_of(source), [f"thing {n}" for n in range(given.rounds + 1)]))
    if given.folder:
        demo = viewer_of(open_scene(given.folder, threads=given.threads))
        told("the demo", *times_of(demo, [*WORDS] * 3))
    best = min((load_ms(given.loaded, given.threads) for _ in range(3)), key=lambda one: one["together"])
    stages = ", ".join(f"{stage} {ms / 1000:.2f}" for stage, ms in best.items())
    print(f"opening {given.loaded:,} Gaussians, CPU seconds, best of 3: {stages}")


if __name__ == "__main__":
    main()
