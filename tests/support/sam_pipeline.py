"""transformers' own mask generation, run alone in a process: python sam_pipeline.py FOLDER CALLS

FOLDER: a SAM that save_pretrained wrote, and image.npy, (H, W, 3). CALLS: the pipeline's arguments by
name, JSON. Writes FOLDER/<name>.npz: masks (N, H, W), scores and boxes, in the pipeline's order.

Its only need of torchvision is `batched_nms`, which is declared here, in this process alone.
"""

import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from PIL import Image
from transformers import SamModel
from transformers.models.sam import image_processing_pil_sam as processing
from transformers.pipelines.mask_generation import MaskGenerationPipeline


def batched_nms(boxes: torch.Tensor, scores: torch.Tensor, idxs: torch.Tensor, iou_threshold: float) -> torch.Tensor:
    """As torchvision documents it, one pair at a time; idxs, the categories, are all 0 here."""
    kept: list[int] = []
    for i in torch.argsort(scores, descending=True, stable=True).tolist():
        if not any(_iou(boxes[i], boxes[j]) > iou_threshold for j in kept):  # of no area: NaN
            kept.append(i)
    return torch.tensor(kept, dtype=torch.int64)


def _iou(a: torch.Tensor, b: torch.Tensor) -> float:
    low, high = torch.maximum(a[:2], b[:2]), torch.minimum(a[2:], b[2:])
    shared = (high - low).clamp(min=0).prod()
    return float(shared / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - shared))


class Processor(processing.SamImageProcessorPil):
    def post_process_for_mask_generation(self, *arguments):  # without the check for torchvision
        return processing._post_process_for_mask_generation(*arguments)


def main(folder: str, calls: str) -> None:
    torch.set_num_threads(1)
    for name in ("torchvision", "torchvision.ops", "torchvision.ops.boxes"):
        sys.modules[name] = ModuleType(name)
    sys.modules["torchvision.ops.boxes"].batched_nms = batched_nms
    model = SamModel.from_pretrained(folder).eval()
    side = model.config.vision_config.image_size
    square, longest = {"height": side, "width": side}, {"longest_edge": side}
    processor = Processor(size=longest, pad_size=square, mask_size=longest, mask_pad_size=square)
    pipeline = MaskGenerationPipeline(model=model, image_processor=processor)
    image = Image.fromarray(np.load(Path(folder) / "image.npy"))
    for name, arguments in json.loads(calls).items():
        found = pipeline(image, output_bboxes_mask=True, **arguments)
        np.savez(
            Path(folder) / f"{name}.npz",
            masks=np.stack([np.asarray(mask, bool) for mask in found["masks"]]),
            scores=np.asarray(found["scores"]),
            boxes=np.asarray(found["bounding_boxes"]),
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
