"""Whether the rivals are no straw men: what they optimise, and how good they get, against the share of their steps.

    python benchmarks/study_rivals.py world/scenes/table_1 [--masks true] [--efforts 0.003 0.01 0.03 0.1 0.3 1]
        [--rivals langsplat-m legaussians-m opengaussian] [--width 320] [--device cuda]

Each row is a fit from the start with that share of the paper's steps: seconds and MiB of memory (of the GPU where it
fits there) beside those of the photos, bytes that a Gaussian and all of them keep, milliseconds of a query for every
Gaussian's cosine (of langsplat-m once its features are decoded), the loss of each stage at its first and its last
fiftieth, and mIoU of selection over the categories of the truth, in Gaussians, each at the threshold that is
best for it (so that no threshold decides); "own" is the same of our weighted mean, and "truth" the share of the
truth's Gaussians that a photo shows at all. IoU counts Gaussians that a photo shows.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from machine import describe, forget_peak, interleaved, resident_mib

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.masks import MASKS, features_of
from benchmarks.suite.rivals.fitting import RIVALS, make
from benchmarks.suite.rivals.rasterising import WIDTH, photos_of
from benchmarks.suite.scenes import BenchScene, owners, read_scene
from drsplat import PQ, MiniEncoder, Registration, read_views, register

EFFORTS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
LEAST = 60  # Gaussians of a category
OWN = "own"


class Truth:
    """Which Gaussians belong to each category."""

    def __init__(self, scene: BenchScene) -> None:
        truth = json.loads((scene.folder / "truth.json").read_text(encoding="utf-8"))
        count = len(truth["objects"]) + len(truth["structures"])
        whose = owners(scene.folder, scene.gaussians, read_views(scene.folder), count)
        things: dict[str, list[int]] = {}
        for thing in truth["objects"]:
            things.setdefault(thing["category"], []).append(thing["id"])
        members = {category: np.isin(whose, ids) for category, ids in things.items()}
        self.members = {category: mine for category, mine in members.items() if mine.sum() >= LEAST}

    def miou(self, features: np.ndarray, encoder: MiniEncoder) -> float:
        """At the best threshold of each category."""
        lengths = np.linalg.norm(features, axis=1)
        (known,) = np.nonzero(lengths > 0)
        unit = features[known] / lengths[known, None]
        best = [_best(unit @ encoder.encode_texts([text])[0], mine, known) for text, mine in self.members.items()]
        return float(np.mean(best))


def _best(scores: np.ndarray, mine: np.ndarray, known: np.ndarray) -> float:
    order = np.argsort(-scores, kind="stable")
    hits = np.cumsum(mine[known[order]])
    ious = hits / (np.arange(1, len(hits) + 1) + mine.sum() - hits)
    last = np.append(np.diff(scores[order]) != 0, True)
    return float(ious[last].max())


class Cost(NamedTuple):
    """seconds, and MiB beside what was held before, to make it; bytes of a Gaussian and of all; ms of a query."""

    seconds: float
    mib: float
    bytes: int
    shared: int
    query: float

    def __str__(self) -> str:
        return f"{self.seconds:.0f} | {self.mib:.0f} | {self.bytes} + {self.shared / 2**10:.0f} Ki | {self.query:.1f}"


@contextmanager
def measured(device: str) -> Iterator[list[float]]:
    """Fills in the seconds and the MiB of what is done within; on a GPU, of its memory."""
    on_gpu, found = device != "cpu", list[float]()
    if on_gpu:
        torch.cuda.reset_peak_memory_stats()
    else:
        forget_peak()
    before = torch.cuda.memory_allocated() / 2**20 if on_gpu else resident_mib(peak=False)
    start = time.perf_counter()
    yield found
    peak = torch.cuda.max_memory_allocated() / 2**20 if on_gpu else resident_mib(peak=True)
    found += [time.perf_counter() - start, peak - before]


def query_ms(scores: Callable[[np.ndarray], object], query: np.ndarray) -> float:
    return 1000 * float(np.median(interleaved({"scores": lambda: scores(query)}, 9)["scores"]))


def rows(folder: Path, kind: str, rivals: list[str], efforts: list[float], width: int, device: str) -> Iterator[str]:
    scene, encoder = read_scene(folder), MiniEncoder()
    features = features_of(scene, kind, encoder)
    truth, query = Truth(scene), encoder.encode_texts(["wooden table"])[0]
    head = f"| {scene.name} | {kind} |"
    with measured("cpu") as numbers:
        registration = replace(register(scene.gaussians, scene.views, features), encoder=encoder.identity)
        field = registration.to_field(PQ(), gaussians=scene.gaussians)
    cost = Cost(*numbers, 132, field.codebook.centroids.nbytes, query_ms(lambda q: field.scores(q[None]), query))
    yield f"{head} {OWN} | | {cost} | | {100 * truth.miou(own_features(registration), encoder):.1f} |"
    photos = photos_of(scene.gaussians, {view: features[view.name] for view in scene.views}, width, device=device)
    for name in rivals:
        for effort in efforts:
            with measured(device) as numbers:
                made = make(name, scene.gaussians, photos, effort)
            cost = Cost(*numbers, made.bytes, made.shared, query_ms(made.scores, query))
            losses = ", ".join(f"{stage} {known[0]:.3g} -> {known[-1]:.3g}" for stage, known in made.losses.items())
            quality = 100 * truth.miou(np.nan_to_num(made.features), encoder)
            yield f"{head} {name} | {effort:g} | {cost} | {losses} | {quality:.1f} |"


def own_features(registration: Registration) -> np.ndarray:
    """Of the weighted mean before it is coded, zero where nothing was seen."""
    (seen,) = np.nonzero(np.diff(registration.weights.indptr))
    mean = np.zeros((registration.weights.shape[0], registration.evidence.embeddings.shape[1]), np.float32)
    mean[seen] = registration.evidence.rows(seen).features(0, len(seen))
    return mean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--masks", nargs="+", choices=MASKS, default=["true"])
    parser.add_argument("--rivals", nargs="+", choices=RIVALS, default=list(RIVALS))
    parser.add_argument("--efforts", nargs="+", type=float, default=list(EFFORTS))
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--device", default="cpu", help="of PyTorch (default: cpu)")
    arguments = parser.parse_args()
    print(describe())
    columns = ("scene", "masks", "method", "effort", "s", "MiB", "bytes", "ms a query", "losses", "mIoU at best")
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}", flush=True)
    for folder in arguments.scenes:
        for kind in arguments.masks:
            for row in rows(folder, kind, arguments.rivals, arguments.efforts, arguments.width, arguments.device):
                print(row, flush=True)


if __name__ == "__main__":
    main()
