"""What a photo costs with `graph`, mask NMS beside a plain loop, and what an image costs with SAM 2's smallest model.

    python benchmarks/bench_masks.py [--photo FILE ...] [--masks 300] [--rounds 5] [--points 32] [--crop-layers 0]
                                     [--skip-models] [--model sam2.1-tiny sam-base sam-huge] [--device cpu]
                                     [--size 1920x1080]

The stages of `graph` are timed in turns with their twins on NumPy and scikit-image, on one thread: the least CPU
seconds of all rounds, their mean over the photos. Without --photo it cuts a made picture of 640x480 pixels. The model
has the architecture of SAM 2.1 Hiera tiny, or of SAM ViT-B or ViT-H, and random weights. Its time to encode and to
decode is that of trained weights; that of enlarging and choosing masks depends on how many pass the thresholds: the run
with thresholds at the median of the model's own scores passes about half of all, more than a photo does. CPU seconds
are of all threads.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from machine import arguments, forget_peak, resident_mib
from PIL import Image
from skimage.segmentation import felzenszwalb

from drsplat.kernels import photo_regions as native
from drsplat.photos.models.graph import GraphSegmenter
from drsplat.photos.models.graph import segmenter as graph
from drsplat.photos.models.graph.segmenter import layers_of
from drsplat.scene.masks.masks import Masks, cut_masks
from drsplat.scene.masks.selection import mask_nms

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

from twins import photo_network
from twins import photo_regions as twin
from twins.photo_merging import Merging

HEIGHT, WIDTH = 1080, 1920


def blobs(number: int, rng: np.random.Generator) -> Masks:
    """Ellipses of 15 to 600 px with rough edges; many lie in others, as parts do in things."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    rough = rng.normal(size=(HEIGHT // 4, WIDTH // 4)).astype(np.float32).repeat(4, 0).repeat(4, 1)
    cut = []
    for _ in range(number):
        radius, aspect = np.exp(rng.uniform(np.log(15), np.log(600))), rng.uniform(0.5, 2)
        middle = rng.uniform((0, 0), (WIDTH, HEIGHT))
        far = np.hypot((x - middle[0]) / aspect, (y - middle[1]) * aspect) + rough * 3
        cut.append(cut_masks((far < radius)[None], rng.uniform(0.65, 1, 1).astype(np.float32)))
    return Masks(
        HEIGHT, WIDTH, np.concatenate([masks.boxes for masks in cut]), tuple(masks.parts[0] for masks in cut),
        np.concatenate([masks.scores for masks in cut]),
    )  # fmt: skip


def nms_by_loop(masks: Masks) -> np.ndarray:
    """Every two masks at full size, as the published code has it, here with one `and` per pair."""
    full = [masks.full(i) for i in range(len(masks))]
    areas, order = masks.areas, np.argsort(-masks.scores, kind="stable")
    gone = ~(masks.scores > 0.7)
    for a, i in enumerate(order):
        for j in order[a + 1 :]:
            shared = int(np.count_nonzero(full[i] & full[j]))
            of_i, of_j = shared / areas[i], shared / areas[j]
            gone[j] |= shared / (areas[i] + areas[j] - shared) > 0.8
            gone[j] |= of_i < 0.5 and of_j >= 0.85
            gone[i] |= of_i >= 0.85 and of_j < 0.5
    return np.flatnonzero(~gone)


class Stages:
    """The stages of `graph` for one photo; each is given what those before it made, by name."""

    def __init__(self, image: np.ndarray) -> None:
        segmenter = GraphSegmenter(threads=1)
        self.image, self.rule, settings = image, segmenter.rule, segmenter.settings
        self.layers, share = layers_of(segmenter.network), graph.working_share(image[..., 0].size)
        self.limits = float(self.rule.threshold[0]), settings.least_area * share, settings.least_width
        self.scale, self.least = graph.MERGE_SCALE * share, round(graph.MIN_AREA_PIXELS * share)

    def twins(self) -> dict[str, Callable[[dict], object]]:
        return {
            "colours": lambda _: twin.lab_colors(self.image),
            "small regions": lambda made: felzenszwalb(
                made["colours"] / native.LAB_STEPS, self.scale, graph.BLUR_PIXELS, self.least
            ).astype(np.int32),
            "network": lambda _: photo_network.look(self.image, self.layers),
            "sums": lambda made: twin.region_graph(made["small regions"], made["colours"], made["network"]),
            "merging": lambda made: self._merged_by_twin(made["sums"]),
        }

    def natives(self) -> dict[str, Callable[[dict], object]]:
        return {
            "colours": lambda _: native.lab_colors(self.image, threads=1),
            "small regions": lambda made: native.small_regions(made["colours"], self.scale / 255, self.least),
            "network": lambda _: native.look(self.image, self.layers, threads=1),
            "sums": lambda made: native.region_graph(made["small regions"], made["colours"], made["network"]),
            "merging": lambda made: native.merged_regions(made["sums"], self.rule.parts, *self.limits),
        }

    def _merged_by_twin(self, graph: native.RegionGraph) -> np.ndarray:
        merging = Merging(graph, self.rule.likelihood)
        merging.merge_above(self.limits[0])
        merging.merge_small(*self.limits[1:])
        return merging.labels()


def done(stages: dict[str, Callable[[dict], object]]) -> tuple[dict[str, Any], np.ndarray]:
    """What all stages make, and the CPU seconds of each."""
    made: dict[str, Any] = {}
    seconds = []
    for name, stage in stages.items():
        start = time.process_time()
        made[name] = stage(made)
        seconds.append(time.process_time() - start)
    return made, np.array(seconds)


def peak_growth(run: Callable[[], object]) -> float:
    """MiB that a run takes at most beyond what the process holds."""
    forget_peak()
    before = resident_mib(peak=False)
    run()
    return resident_mib(peak=True) - before


def made_picture() -> np.ndarray:
    """Overlapping discs in light from above, with noise."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:480, :640]
    picture = np.full((480, 640, 3), 140.0)
    for radius in rng.uniform(10, 120, 60):
        middle, color = rng.uniform(0, (480, 640)), rng.uniform(30, 230, 3)
        light = 1 - 0.4 * np.clip((y - middle[0]) / radius, 0, 1)
        disc = np.hypot(y - middle[0], x - middle[1]) < radius
        picture[disc] = (light[..., None] * color)[disc]
    return np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8)


def bench_graph(photos: Sequence[str], rounds: int) -> None:
    images = [np.asarray(Image.open(photo).convert("RGB")) for photo in photos] or [made_picture()]
    first_stages = Stages(np.ascontiguousarray(graph.working_image(images[0])))
    fast_peak, slow_peak = (
        peak_growth(lambda made=made: done(made)) for made in (first_stages.natives(), first_stages.twins())
    )
    seconds, ties, others = np.zeros((2, 5)), 0, 0
    for image in images:
        stages = Stages(np.ascontiguousarray(graph.working_image(image)))
        least = np.full((2, 5), np.inf)
        for _ in range(rounds):
            (before, first), (after, second) = done(stages.twins()), done(stages.natives())
            least = np.minimum(least, [first, second])
        seconds += least / len(images)
        ties += bool((before["small regions"] != after["small regions"]).any())
        others += bool((before["merging"][before["small regions"]] != after["merging"][after["small regions"]]).any())
    print(f"graph, {len(images)} photos, CPU seconds of one, least of {rounds}: twin, native")
    for name, (slow, fast) in zip([*stages.natives(), "all"], np.c_[seconds, seconds.sum(1)].T, strict=True):
        print(f"{name:<44} {slow:8.3f} {fast:8.3f}")
    print(
        f"{ties} photos with other small regions, where scikit-image takes equal ones otherwise; {others} other masks"
    )
    print(f"memory of the first photo at most {slow_peak:.0f} and {fast_peak:.0f} MiB")
    timed("segment, with masks at full size", lambda: GraphSegmenter(threads=1).segment(images[-1]), rounds)


HUGE = {
    "hidden_size": 1280, "num_hidden_layers": 32, "num_attention_heads": 16, "mlp_dim": 5120,
    "global_attn_indexes": [7, 15, 23, 31],
}  # fmt: skip


def random_model(name: str) -> Any:
    """transformers' defaults of Sam2Config are the sizes of SAM 2.1 Hiera tiny, those of SamConfig of ViT-B."""
    import torch
    from transformers import Sam2Config, Sam2Model, SamConfig, SamModel

    torch.manual_seed(0)
    if name == "sam2.1-tiny":
        return Sam2Model(Sam2Config()).eval()
    return SamModel(SamConfig(vision_config=HUGE if name == "sam-huge" else {})).eval()


def timed(name: str, run: Callable[[], object], rounds: int) -> None:
    """The median of some rounds after a warm-up, or one run without."""
    if rounds > 1:
        run()
    walls, cpus = [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    print(
        f"{name:<44} {np.median(walls):7.2f} s wall (median of {rounds}; {min(walls):.2f} to "
        f"{max(walls):.2f}), {np.median(cpus):7.2f} s CPU"
    )


def bench_nms(number: int, rounds: int) -> None:
    masks = blobs(number, np.random.default_rng(0))
    assert mask_nms(masks).tolist() == nms_by_loop(masks).tolist()
    print(f"{number} masks at {WIDTH}x{HEIGHT}, {masks.areas.sum() / HEIGHT / WIDTH:.1f} deep on average")
    timed("mask_nms", lambda: mask_nms(masks), rounds)
    timed("plain loop", lambda: nms_by_loop(masks), 1)


def bench_segmenter(name: str, device: str, size: tuple[int, int], points: int, crop_layers: int, rounds: int) -> None:
    import torch

    from drsplat.photos.models.point_masks import PointMaskSettings, PointSegmenter
    from drsplat.photos.models.sam import ModelFrame, SamPredictor

    model = random_model(name)
    weights = sum(tensor.numel() for tensor in model.parameters())
    print(f"{name}, {weights / 1e6:.1f} M random weights, {device}, {torch.get_num_threads()} threads")
    predictor = SamPredictor(model, ModelFrame(1024, stretched=name.startswith("sam2")), device, {})
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*size[::-1], 3), np.uint8)
    timed("encoder", lambda: _waited(device, lambda: predictor._features([image])), rounds)
    features = predictor._features([image])
    asked = rng.uniform(0, 1024, (64, 2)).astype(np.float32)
    timed("decoder, 64 points", lambda: predictor._answers(features, asked), rounds)
    logits, iou = predictor._answers(features, asked)
    spread = float(logits.std())
    none = PointMaskSettings(points_per_side=points, crop_layers=crop_layers, min_predicted_iou=2.0)
    half = replace(
        none, min_predicted_iou=float(np.median(iou)), stability_offset=spread / 100, min_stability=0.5, mask_score=-1.0
    )
    what = f"{points}x{points} points, {crop_layers} crop layers"
    for name, settings in (("no mask passes", none), ("half pass", half)):
        segmenter = PointSegmenter(predictor, settings)
        timed(f"{what}, {name}", lambda s=segmenter: s.segment(image), 1)
    if device == "cuda":
        print(f"at most {torch.cuda.max_memory_allocated() / 2**30:.2f} GiB of the GPU's memory")


def _waited(device: str, run: Callable[[], object]) -> None:
    """Until a GPU has done it; the decoder's answers wait by themselves."""
    import torch

    run()
    if device == "cuda":
        torch.cuda.synchronize()


def main() -> None:
    args = arguments(
        __doc__, masks=300, rounds=5, points=32, crop_layers=0, skip_models=False, model=["sam2.1-tiny"],
        device=("cpu", "cuda"), size="1920x1080", photo=[""],
    )  # fmt: skip
    bench_graph([photo for photo in args.photo if photo], args.rounds)
    bench_nms(args.masks, args.rounds)
    width, height = map(int, args.size.split("x"))
    for name in [] if args.skip_models else args.model:
        bench_segmenter(name, args.device or "cpu", (width, height), args.points, args.crop_layers, args.rounds)


if __name__ == "__main__":
    main()
