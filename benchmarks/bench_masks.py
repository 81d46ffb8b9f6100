"""Mask NMS beside a plain loop, and what segmenting an image costs with SAM 2's smallest model.

    python benchmarks/bench_masks.py [--masks 300] [--rounds 5] [--points 32] [--crop-layers 0] [--skip-models]
                                     [--model sam2.1-tiny sam-base sam-huge] [--device cpu] [--size 1920x1080]

The model has the architecture of SAM 2.1 Hiera tiny, or of SAM ViT-B or ViT-H, and random weights. Its
time to encode and to decode is that of trained weights; that of enlarging and choosing masks depends on
how many pass the thresholds: the run with thresholds at the median of the model's own scores passes
about half of all, more than a photo does. CPU seconds are of all threads.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from machine import arguments

from drsplat.masks.masks import Masks, cut_masks
from drsplat.masks.selection import mask_nms

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

    from drsplat.models.point_masks import PointMaskSettings, PointSegmenter
    from drsplat.models.sam import ModelFrame, SamPredictor

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
        device=("cpu", "cuda"), size="1920x1080",
    )  # fmt: skip
    bench_nms(args.masks, args.rounds)
    width, height = map(int, args.size.split("x"))
    for name in [] if args.skip_models else args.model:
        bench_segmenter(name, args.device or "cpu", (width, height), args.points, args.crop_layers, args.rounds)


if __name__ == "__main__":
    main()
