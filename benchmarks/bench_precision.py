"""Ways to compute SAM 2.1 tiny and CLIP ViT-B/16 on a CPU: CPU seconds, and whether the answers stay the same.

    python benchmarks/bench_precision.py [--ways own float32 bfloat16 products compiled openvino openvino-bf16]
                                         [--threads 1] [--points 64] [--batches 16 32 64 128] [--crops 8] [--rounds 2]

Real sizes, random weights. own: the mask decoder of transformers, float32; all others: drsplat's. products: only the
factors of products are rounded to bfloat16. compiled: by torch.compile, of SAM the decoder alone; it needs a C++
compiler. openvino: its own package, which drsplat does not use.
Of masks the IoU with those of "own" after the threshold, the least and the median; of crops the least cosine with
float32. Masks of random weights are noise, which has edges everywhere: equal here is equal anywhere, but what differs
here may differ less on a photo. CPU seconds are of all threads, the least of all rounds after a warm-up.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from bench_masks import random_model
from machine import arguments

from drsplat.photos.models.sam import ModelFrame, SamPredictor

Run = Callable[[Any], Any]


def cpu_seconds(run: Callable[[], Any], rounds: int) -> tuple[float, Any]:
    """The least of some rounds after a warm-up, and the answer."""
    answer, best = run(), float("inf")
    for _ in range(rounds):
        start = time.process_time()
        answer = run()
        best = min(best, time.process_time() - start)
    return best, answer


def in_bfloat16(run: Run) -> Run:
    def cast(value: Any) -> Any:
        with torch.autocast("cpu", dtype=torch.bfloat16):
            return run(value)

    return cast


def with_rounded_factors(run: Run) -> Run:
    def rounded(value: Any) -> Any:
        torch.set_float32_matmul_precision("medium")
        try:
            return run(value)
        finally:
            torch.set_float32_matmul_precision("highest")

    return rounded


def by_openvino(module: torch.nn.Module, example: Any, precision: str) -> Run:
    import openvino as ov

    settings = {"INFERENCE_PRECISION_HINT": precision, "INFERENCE_NUM_THREADS": torch.get_num_threads()}
    model = ov.compile_model(ov.convert_model(module, example_input=example), "CPU", settings)
    return lambda value: [torch.from_numpy(rows.copy()) for rows in model(value.numpy()).values()]


def way_of(way: str, module: torch.nn.Module, example: Any) -> Run:
    """How a module is run. Compiling is not in the measured time."""
    if way.startswith("openvino"):
        return by_openvino(module, example, "bf16" if way.endswith("bf16") else "f32")
    if way == "compiled":
        return torch.compile(module)  # type: ignore[no-any-return]
    casts = {"bfloat16": in_bfloat16, "products": with_rounded_factors}
    return casts[way](module) if way in casts else module


class ImageEncoder(torch.nn.Module):
    def __init__(self, model: Any):
        super().__init__()
        self.model = model

    def forward(self, pixels: Any) -> Any:
        return self.model.get_image_embeddings(pixels)


class OwnDecoder(torch.nn.Module):
    """transformers' own, for one image."""

    def __init__(self, model: Any, features: Any):
        super().__init__()
        self.model, self.features = model, features

    def forward(self, points: Any) -> Any:
        answer = self.model(
            image_embeddings=self.features, input_points=points[None, :, None],
            input_labels=torch.ones((1, len(points), 1), dtype=torch.int64), multimask_output=True,
        )  # fmt: skip
        return answer.pred_masks[0], answer.iou_scores[0]


class Decoder(torch.nn.Module):
    """drsplat's, for one image."""

    def __init__(self, predictor: SamPredictor, features: Any):
        super().__init__()
        self.decoder, self.image = predictor._decoder, predictor._decoder.share(features)

    def forward(self, points: Any) -> Any:
        return self.decoder.answers(self.image, points.numpy())


def decoder_of(way: str, model: Any, predictor: SamPredictor, features: Any, points: Any) -> Run:
    """OpenVINO cannot trace NumPy arrays, so it gets transformers' own."""
    openvino = way.startswith("openvino")
    return way_of(way, OwnDecoder(model, features) if openvino else Decoder(predictor, features), points)


def masks_alike(masks: Any, expected: Any) -> str:
    one, other = (logits.float() > 0 for logits in (masks, expected))
    shared, either = ((both).flatten(2).sum(2) for both in (one & other, one | other))
    iou = shared / either.clamp(min=1)
    return f"{float(iou.min()):.4f} {float(iou.median()):.4f}"


def bench_sam(ways: list[str], points: int, batches: list[int], rounds: int) -> None:
    model = random_model("sam2.1-tiny")
    predictor, rng = SamPredictor(model, ModelFrame(1024, stretched=True), "cpu", {}), np.random.default_rng(0)
    pixels, encode = torch.randn(1, 3, 1024, 1024, generator=torch.Generator().manual_seed(0)), ImageEncoder(model)
    features = [part.clone() for part in encode(pixels)]
    asked = torch.from_numpy(rng.uniform(0, 1024, (points, 2)).astype(np.float32))
    own, expected = cpu_seconds(lambda: OwnDecoder(model, features)(asked), rounds if "own" in ways else 0)
    print(
        f"SAM 2.1 tiny     image encoder  {points} points  IoU of masks: least, median; largest change of predicted IoU"
    )
    for way in ways:
        plain = way in ("own", "compiled")  # compiling the encoder takes minutes
        encoder = way_of("float32" if plain else way, encode, pixels)
        seconds, changed = cpu_seconds(lambda run=encoder: run(pixels), rounds)
        decoded, (masks, iou) = own, expected
        if way != "own":
            decoder = decoder_of(way, model, predictor, features, asked)
            decoded, _ = cpu_seconds(lambda run=decoder: run(asked), rounds)
            shared = [part.float() for part in changed]
            masks, iou = (decoder_of(way, model, predictor, shared, asked))(asked)
        change = float((iou.float() - expected[1]).abs().max())
        print(f"{way:<16} {seconds:13.2f} {decoded:10.2f}  {masks_alike(masks, expected[0])} {change:.5f}", flush=True)
    run = Decoder(predictor, features)
    for batch in batches:
        some = asked.repeat(-(-batch // points), 1)[:batch]
        seconds, _ = cpu_seconds(lambda some=some: run(some), rounds)
        print(f"float32, batches of {batch:<4} {seconds / batch:.4f} a point", flush=True)


def bench_clip(ways: list[str], crops: int, rounds: int) -> None:
    import transformers

    torch.manual_seed(0)
    vision = transformers.CLIPVisionConfig(patch_size=16, hidden_act="gelu", projection_dim=512)
    model = transformers.CLIPVisionModelWithProjection(vision).eval()

    class Images(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, pixels: Any) -> Any:
            return self.model(pixel_values=pixels).image_embeds

    pixels, images = torch.randn(crops, 3, 224, 224), Images()
    expected = images(pixels)
    print(f"CLIP ViT-B/16    CPU s a crop, batches of {crops}   least cosine")
    for way in (way for way in ways if way != "own"):
        run = way_of(way, images, pixels)
        seconds, answer = cpu_seconds(lambda run=run: run(pixels), rounds)
        rows = (answer[0] if isinstance(answer, list) else answer).float()
        cosine = float(torch.nn.functional.cosine_similarity(rows, expected).min())
        print(f"{way:<16} {seconds / crops:13.4f} {cosine:26.5f}", flush=True)


def main() -> None:
    args = arguments(
        __doc__, ways=["own", "float32", "bfloat16", "products", "compiled", "openvino", "openvino-bf16"], threads=1,
        points=64, batches=[16, 32, 64, 128], crops=8, rounds=2,
    )  # fmt: skip
    torch.set_num_threads(args.threads)
    print(f"torch {torch.__version__}, {args.threads} threads")
    with torch.inference_mode():
        bench_clip(args.ways, args.crops, args.rounds)
        bench_sam(args.ways, args.points, args.batches, args.rounds)


if __name__ == "__main__":
    main()
