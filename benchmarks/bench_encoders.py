"""Crops per second of ViT-B/16 CLIP with random weights: precision, batch and threads.

    python benchmarks/bench_encoders.py [--crops 32] [--rounds 2] [--threads 1 2]

The weights are random, the architecture that of laion/CLIP-ViT-B-16-laion2B-s34B-b88K: speed does not
depend on the values. CPU seconds are of all threads; on a busy machine trust them before the clock.
Scaling and normalising are included; the first round of each warms up.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from machine import arguments

from drsplat.photos.models.loading import load_encoder

SIDE = 400  # pixels of a crop, about what SAM's larger masks have in photos


def written_clip(folder: Path) -> Path:
    """ViT-B/16 as the published one: 12 layers of 768 for images, of 512 for texts, 512 numbers out."""
    import transformers

    transformers.utils.logging.disable_progress_bar()
    text = {"hidden_size": 512, "intermediate_size": 2048, "num_attention_heads": 8}
    vision = {"patch_size": 16, "hidden_act": "gelu"}
    config = transformers.CLIPConfig(
        text_config={**text, "hidden_act": "gelu"}, vision_config=vision, projection_dim=512
    )
    transformers.CLIPModel(config).save_pretrained(folder)
    return folder


def measured(encoder: Any, crops: list[np.ndarray], rounds: int) -> tuple[float, float]:
    """Best seconds by the clock and mean CPU seconds of a round."""
    encoder.encode_images(crops[: encoder.batch])
    clock, cpu = [], []
    for _ in range(rounds):
        start, start_cpu = time.perf_counter(), time.process_time()
        encoder.encode_images(crops)
        clock.append(time.perf_counter() - start)
        cpu.append(time.process_time() - start_cpu)
    return min(clock), float(np.mean(cpu))


def crops_of_the_model_alone(encoder: Any, rounds: int) -> float:
    """A second, in one batch that is scaled and on the device already."""
    import torch

    side = encoder.preprocessing.side
    pixels = torch.zeros((encoder.batch, 3, side, side), dtype=getattr(torch, encoder.dtype), device=encoder.device)
    best = float("inf")
    for _ in range(rounds + 1):
        start = time.perf_counter()
        with torch.inference_mode():
            encoder._model.get_image_features(pixel_values=pixels)
        if encoder.device == "cuda":
            torch.cuda.synchronize()
        best = min(best, time.perf_counter() - start)
    return float(encoder.batch / best)


def main() -> None:
    args = arguments(
        __doc__, crops=32, rounds=2, threads=[1, 2], batches=[8, 16, 32], dtypes=["float32", "bfloat16"], device="cpu"
    )
    import torch

    from drsplat.photos.models.transformers_encoders import TransformersEncoder

    print(f"torch {torch.__version__}")
    rng = np.random.default_rng(0)
    crops = [rng.integers(0, 256, (SIDE, SIDE, 3), np.uint8) for _ in range(args.crops)]
    with tempfile.TemporaryDirectory() as folder:
        model = written_clip(Path(folder))
        encoders = {dtype: load_encoder(str(model), args.device, dtype) for dtype in args.dtypes}
    exact: Any = None
    print("dtype      batch  threads  crops/s   CPU s per crop  lowest cosine with the first dtype")
    for dtype, encoder in encoders.items():
        assert isinstance(encoder, TransformersEncoder)
        rows = encoder.encode_images(crops[:8])
        exact = rows if exact is None else exact
        cosine = float((rows * exact).sum(1).min())
        print(f"{dtype:<10} the model alone: {crops_of_the_model_alone(encoder, args.rounds):.1f} crops/s")
        for threads in args.threads:
            torch.set_num_threads(threads)
            for batch in args.batches:
                encoder.batch = batch
                clock, cpu = measured(encoder, crops, args.rounds)
                print(
                    f"{dtype:<10} {batch:5} {threads:8} {args.crops / clock:8.1f} "
                    f"{cpu / args.crops:16.3f}  {cosine:.5f}"
                )


if __name__ == "__main__":
    main()
