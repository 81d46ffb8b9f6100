"""Masks of an image without the pixels that its photo's mask leaves out."""

from collections.abc import Mapping

import numpy as np

from ...base.arrays import Bool
from .masks import Masks, tight_box

MIN_KEPT_SHARE = 0.5  # of a mask's pixels; a smaller rest would be embedded as something else


def kept_masks(levels: Mapping[str, Masks], kept: Bool[np.ndarray, "h w"]) -> dict[str, Masks]:
    """Return the masks of each level cut to the pixels that are kept; those that mostly are not are dropped."""
    return {level: _cut(masks, kept) for level, masks in levels.items()}


def _cut(masks: Masks, kept: Bool[np.ndarray, "h w"]) -> Masks:
    rows, boxes, parts = [], [], []
    for row, ((x0, y0, x1, y1), part) in enumerate(zip(masks.boxes.tolist(), masks.parts, strict=True)):
        rest = part & kept[y0:y1, x0:x1]
        box = tight_box(rest)
        if box is None or np.count_nonzero(rest) < MIN_KEPT_SHARE * np.count_nonzero(part):
            continue
        left, top, right, bottom = box
        rows.append(row)
        boxes.append((x0 + left, y0 + top, x0 + right, y0 + bottom))
        parts.append(rest[top:bottom, left:right].copy())
    return Masks(
        masks.height, masks.width, np.array(boxes, np.int32).reshape(-1, 4), tuple(parts),
        masks.scores[np.array(rows, np.int64)],
    )  # fmt: skip
