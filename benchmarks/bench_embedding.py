"""What `embed` costs with SAM 2.1 tiny and CLIP ViT-B/16 on a capture, looking at everything and at what is enough.

    python benchmarks/bench_embedding.py CAPTURE=SCENE --kept FOLDER [--rounds 3]

SCENE: trained on the capture. Models have their real sizes and random weights, which cost as much time as trained ones:
seconds of an image, of a point by transformers' own decoder, which was asked before, and by drsplat's, and of a crop.
Photos, points, masks and crops are counted on the capture, of whose outlined things a simulated SAM makes the masks
(`suite/simulated_sam.py`), since random weights make none. Before: a grid of 16 x 16 points on each photo, and a crop
of each mask. What the choice of photos and crops itself takes is in the seconds, which are CPU seconds of one thread.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.bench_encoders import written_clip
from benchmarks.bench_masks import random_model
from benchmarks.study_embedding import cameras, points_of
from benchmarks.suite.answers import place_of
from benchmarks.suite.places import Place
from drsplat.photos.embedding.objects_first import share_crops
from drsplat.photos.embedding.view_choice import choose_views
from drsplat.photos.models.loading import load_encoder
from drsplat.photos.models.sam import ModelFrame, SamPredictor

BATCH = 64


class Costs(NamedTuple):
    """Seconds of SAM's image encoder, of a point by transformers' decoder and by drsplat's, and of a crop."""

    image: float
    own_point: float
    point: float
    crop: float


def seconds(run: Callable[[], object], rounds: int) -> float:
    """Return the least CPU seconds after a warm-up."""
    run()
    spent = []
    for _ in range(rounds):
        start = time.process_time()
        run()
        spent.append(time.process_time() - start)
    return min(spent)


def model_costs(width: int, height: int, rounds: int) -> Costs:
    import torch

    model = random_model("sam2.1-tiny")
    predictor = SamPredictor(model, ModelFrame(1024, stretched=True), "cpu", {})
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (height, width, 3), np.uint8)
    features = predictor._features([image])
    points = rng.uniform(0, 1024, (BATCH, 2)).astype(np.float32)
    asked, labels = torch.from_numpy(points)[None, :, None], torch.ones((1, BATCH, 1), dtype=torch.int64)

    def by_transformers() -> object:
        return model(image_embeddings=embeddings, input_points=asked, input_labels=labels, multimask_output=True)

    crops = [rng.integers(0, 256, (300, 300, 3), np.uint8) for _ in range(16)]
    with torch.inference_mode(), tempfile.TemporaryDirectory() as folder:
        pixels = torch.from_numpy(predictor.frame.pixel_values(image))[None]
        embeddings = model.get_image_embeddings(pixels)
        encoder = load_encoder(str(written_clip(Path(folder))), "cpu")
        return Costs(
            seconds(lambda: predictor._features([image]), rounds),
            seconds(by_transformers, rounds) / BATCH,
            seconds(lambda: predictor._answers(features, points), rounds) / BATCH,
            seconds(lambda: encoder.encode_images(crops), rounds) / len(crops),  # type: ignore[union-attr]
        )


def crops_of(place: Place) -> tuple[int, float]:
    """Return the crops that stand for the masks of a place, and the seconds that finding them takes."""
    evidence = place.evidence_of(np.ones((len(place.owners), 1), np.float32))
    start = time.process_time()
    shared = share_crops(evidence, place.gaussians, place.cameras, threads=1)
    return len(shared.chosen), time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("place", metavar="CAPTURE=SCENE")
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    import torch

    torch.set_num_threads(1)
    grid, rounds = (place_of(arguments.place, kind, arguments.kept) for kind in ("grid16", "rounds"))
    views, points = cameras(rounds), points_of(arguments.place, rounds, "rounds")
    costs = model_costs(views[0].width, views[0].height, arguments.rounds)
    print(
        f"image encoder {costs.image:.2f} s, a point {costs.own_point:.3f} s by "
        f"transformers, {costs.point:.3f} s by drsplat, a crop {costs.crop:.3f} s\n"
    )
    print(
        "| | photos | points per photo | masks | embedded crops | SAM seconds per photo | seconds in total | speed-up |"
    )
    print("|---" * 8 + "|")
    everything = costs.image + 256 * costs.own_point
    before = len(views) * everything + len(grid.owners) * costs.crop

    def row(name: str, place: Place, asked: float, of_sam: float, crops: int, more: float = 0.0) -> None:
        evidence = place.evidence_of(np.ones((len(place.owners), 1), np.float32))
        photos = len(evidence.masks.view_names)
        total = photos * of_sam + crops * costs.crop + more
        counts = f"{photos} | {asked:.0f} | {len(evidence.masks)} | {crops}"
        print(f"| {name} | {counts} | {of_sam:.1f} | {total:.0f} | {before / total:.1f} |", flush=True)

    row("grid of 16 x 16 points, transformers' decoder", grid, 256, everything, len(grid.owners))
    row("the same, drsplat's decoder", grid, 256, costs.image + 256 * costs.point, len(grid.owners))
    of_sam = costs.image + points * costs.point
    row("points in rounds", rounds, points, of_sam, len(rounds.owners))
    crops, sharing = crops_of(rounds)
    row("crops of objects, too", rounds, points, of_sam, crops, sharing)
    start = time.process_time()
    chosen = choose_views(rounds.gaussians, views, threads=1).views
    choosing = time.process_time() - start
    few = replace(rounds, photos={view.name for view in chosen})
    crops, sharing = crops_of(few)
    row("photos that show enough, too", few, points, of_sam, crops, choosing + sharing)


if __name__ == "__main__":
    main()
