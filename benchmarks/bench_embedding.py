"""What `embed` costs with SAM 2.1 tiny and CLIP ViT-B/16 on a capture, looking at everything and at what is enough.

    python benchmarks/bench_embedding.py CAPTURE SCENE [--rounds 3]

SCENE: trained on the capture. Models have their real sizes and random weights, which cost as much time as trained ones:
seconds of an image, a point and a crop are measured. How many photos are chosen and how many crops are embedded is
counted on the capture, with the masks of `graph`, since random weights make none: it cuts smaller pieces than SAM, of
which more show no object. Points: a grid of 16 x 16 before; after, the most that are asked, and what a simulated SAM
is asked in made rooms (`study_embedding.py`).
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.bench_encoders import written_clip
from benchmarks.bench_masks import random_model
from benchmarks.suite.masks import ROUNDS
from drsplat import View, read_gaussians, read_views, register
from drsplat.embedding.embed import embed
from drsplat.embedding.keeping import WithoutEmbedding
from drsplat.embedding.shared_crops import share_crops
from drsplat.embedding.view_choice import choose_views
from drsplat.formats.langsplat import read_features
from drsplat.models.graph import GraphSegmenter
from drsplat.models.loading import load_encoder
from drsplat.models.sam import ModelFrame, SamPredictor
from drsplat.scene.gaussians import Gaussians

GRID = 16 * 16
ROOM_POINTS = 36
BATCH = 64


def seconds(run: Callable[[], object], rounds: int) -> float:
    """Return the median after a warm-up."""
    run()
    walls = []
    for _ in range(rounds):
        start = time.perf_counter()
        run()
        walls.append(time.perf_counter() - start)
    return float(np.median(walls))


def model_costs(width: int, height: int, rounds: int) -> tuple[float, float, float]:
    """Return the seconds of SAM's image encoder, of a point and of a crop."""
    predictor = SamPredictor(random_model("sam2.1-tiny"), ModelFrame(1024, stretched=True), "cpu", {})
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (height, width, 3), np.uint8)
    features = predictor._features([image])
    points = rng.uniform(0, 1024, (BATCH, 2)).astype(np.float32)
    of_image = seconds(lambda: predictor._features([image]), rounds)
    of_points = seconds(lambda: predictor._answers(features, points), rounds)
    crops = [rng.integers(0, 256, (300, 300, 3), np.uint8) for _ in range(16)]
    with tempfile.TemporaryDirectory() as folder:
        encoder = load_encoder(str(written_clip(Path(folder))), "cpu")
        of_crops = seconds(lambda: encoder.encode_images(crops), rounds)  # type: ignore[union-attr]
    return of_image, of_points / BATCH, of_crops / len(crops)


def mask_counts(views: list[View], gaussians: Gaussians) -> tuple[int, int, float]:
    """Return the masks of some photos, the crops that stand for them, and the seconds that finding these takes."""
    with tempfile.TemporaryDirectory() as folder:
        embed(views, folder, GraphSegmenter(), WithoutEmbedding())
        features = read_features(folder)
        start = time.perf_counter()
        evidence = register(gaussians, views, features).evidence
        shared = share_crops(evidence, gaussians, views)
        return len(evidence.masks), len(shared.chosen), time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture")
    parser.add_argument("scene")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    views, gaussians = read_views(arguments.capture), read_gaussians(arguments.scene)
    of_image, of_point, of_crop = model_costs(views[0].width, views[0].height, arguments.rounds)
    print(f"image encoder {of_image:.2f} s, a point {of_point:.3f} s, a crop {of_crop:.3f} s")
    start = time.perf_counter()
    chosen = choose_views(gaussians, views).views
    choosing = time.perf_counter() - start
    all_masks, _, _ = mask_counts(views, gaussians)
    few_masks, crops, sharing = mask_counts(chosen, gaussians)
    before = len(views) * (of_image + GRID * of_point) + all_masks * of_crop
    print(
        "| | photos | points a photo | masks | embedded crops | seconds a photo of SAM | seconds in all | of before |"
    )
    print("|---" * 8 + "|")

    def row(name: str, photos: int, points: int, masks: int, embedded: int, more: float) -> None:
        of_sam = of_image + points * of_point
        total = photos * of_sam + embedded * of_crop + more
        counts = f"{photos} | {points} | {masks} | {embedded}"
        print(f"| {name} | {counts} | {of_sam:.1f} | {total:.0f} | {before / total:.1f} |")

    row("everything", len(views), GRID, all_masks, all_masks, 0)
    assert ROUNDS.most_points is not None
    row("enough, most points", len(chosen), ROUNDS.most_points, few_masks, crops, choosing + sharing)
    row("enough, points of made rooms", len(chosen), ROOM_POINTS, few_masks, crops, choosing + sharing)


if __name__ == "__main__":
    main()
