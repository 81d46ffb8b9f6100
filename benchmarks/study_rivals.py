"""Whether the rivals are no straw men: what they optimise, and how good they get, against the share of their steps.

    python benchmarks/study_rivals.py world/scenes/table_1 [--masks true] [--efforts 0.003 0.01 0.03 0.1 0.3 1]
        [--rivals langsplat-m legaussians-m opengaussian] [--width 320] [--device cuda]

Each row is a fit from the start with that share of the paper's steps: seconds, the loss of each stage at its first and
its last fiftieth, and mIoU of selection over the categories of the truth, in Gaussians, each at the threshold that is
best for it (so that no threshold decides); "own" is the same of our weighted mean, and "truth" the share of the
truth's Gaussians that a photo shows at all. IoU counts Gaussians that a photo shows.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.bench_boxes import owners
from benchmarks.suite.masks import MASKS, features_of
from benchmarks.suite.rivals.fitting import RIVALS, make
from benchmarks.suite.rivals.rasterising import WIDTH, photos_of
from benchmarks.suite.scenes import BenchScene, read_scene
from drsplat import MiniEncoder, read_views, register

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


def rows(folder: Path, kind: str, rivals: list[str], efforts: list[float], width: int, device: str) -> Iterator[str]:
    scene, encoder = read_scene(folder), MiniEncoder()
    features = features_of(scene, kind, encoder)
    truth, start = Truth(scene), time.perf_counter()
    registration = register(scene.gaussians, scene.views, features)
    (seen,) = np.nonzero(np.diff(registration.weights.indptr))
    mean = np.zeros((len(scene.gaussians), encoder.identity.dim), np.float32)
    mean[seen] = registration.evidence.rows(seen).features(0, len(seen))
    seconds = time.perf_counter() - start
    yield f"| {scene.name} | {kind} | {OWN} | | {seconds:.0f} | | {100 * truth.miou(mean, encoder):.1f} |"
    photos = photos_of(scene.gaussians, {view: features[view.name] for view in scene.views}, width, device=device)
    for name in rivals:
        for effort in efforts:
            start = time.perf_counter()
            made = make(name, scene.gaussians, photos, effort)
            seconds = time.perf_counter() - start
            losses = ", ".join(f"{stage} {known[0]:.3g} -> {known[-1]:.3g}" for stage, known in made.losses.items())
            quality = 100 * truth.miou(np.nan_to_num(made.features), encoder)
            yield f"| {scene.name} | {kind} | {name} | {effort:g} | {seconds:.0f} | {losses} | {quality:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--masks", nargs="+", choices=MASKS, default=["true"])
    parser.add_argument("--rivals", nargs="+", choices=RIVALS, default=list(RIVALS))
    parser.add_argument("--efforts", nargs="+", type=float, default=list(EFFORTS))
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--device", default="cpu", help="of PyTorch (default: cpu)")
    arguments = parser.parse_args()
    print("| scene | masks | method | effort | s | losses | mIoU at best |\n|---|---|---|--:|--:|---|--:|")
    for folder in arguments.scenes:
        for kind in arguments.masks:
            for row in rows(folder, kind, arguments.rivals, arguments.efforts, arguments.width, arguments.device):
                print(row, flush=True)


if __name__ == "__main__":
    main()
