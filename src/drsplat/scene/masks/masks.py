"""Masks of one image, and the protocol of segmenters.

Masks of an image without the pixels that its photo's mask leaves out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ...base.arrays import Array, Bool, Indices, Int32, Mask, Numbers, Pixels
from ...errors import InputError

LEVELS = ("default", "small", "medium", "large")
"""LangSplat's names of how fine masks are, in the order in which its files have them."""


@dataclass(frozen=True, eq=False)
class Masks:
    """Masks of one image, each cut to its box, so that hundreds at full size stay small; may be none.

    height, width: of the image, pixels. boxes: x0, y0, x1, y1, ends excluded. parts: per mask the
    pixels of its box that belong to it. scores: how sure the segmenter is, 0 to 1.

    Raises: InputError: boxes that leave the image or are empty; parts of other sizes.
    """

    height: int
    width: int
    boxes: Int32[Array, "n 4"]
    parts: tuple[Bool[Array, "_ _"], ...]
    scores: Numbers

    def __post_init__(self) -> None:
        if not len(self.boxes) == len(self.parts) == len(self.scores):
            raise InputError(
                f"{len(self.boxes)} boxes, {len(self.parts)} parts and {len(self.scores)} scores: "
                "expected one each for a mask"
            )
        for (x0, y0, x1, y1), part in zip(self.boxes, self.parts, strict=True):
            inside = 0 <= x0 < x1 <= self.width and 0 <= y0 < y1 <= self.height
            if not inside or part.shape != (y1 - y0, x1 - x0):
                raise InputError(
                    f"a mask of {part.shape[1]}x{part.shape[0]} pixels for the box {x0} {y0} {x1} {y1} "
                    f"in an image of {self.width}x{self.height}"
                )

    def __len__(self) -> int:
        return len(self.parts)

    @property
    def areas(self) -> Indices:
        """Pixels of each mask."""
        return np.array([np.count_nonzero(part) for part in self.parts], np.int64)

    def full(self, index: int) -> Mask:
        """Return one mask at the size of the image."""
        mask = np.zeros((self.height, self.width), bool)
        x0, y0, x1, y1 = self.boxes[index]
        mask[y0:y1, x0:x1] = self.parts[index]
        return mask

    def subset(self, indices: Sequence[int] | Indices) -> "Masks":
        """Return the masks of these indices, in their order."""
        chosen = np.asarray(indices, np.int64)
        parts = tuple(self.parts[i] for i in chosen)
        return Masks(self.height, self.width, self.boxes[chosen], parts, self.scores[chosen])


def cut_masks(full: Bool[Array, "n h w"], scores: Numbers) -> Masks:
    """Cut each mask, given at the size of the image, to the smallest box that holds it.

    One without pixels gets the image's first pixel as its box and stays without pixels, so that
    numbers do not shift. Raises: InputError: images without pixels; scores of another number.
    """
    if 0 in full.shape[1:]:
        raise InputError(f"masks of {full.shape[2]}x{full.shape[1]} pixels: expected at least 1x1")
    boxes = np.array([tight_box(mask) or (0, 0, 1, 1) for mask in full], np.int32).reshape(-1, 4)
    parts = tuple(mask[y0:y1, x0:x1].copy() for mask, (x0, y0, x1, y1) in zip(full, boxes, strict=True))
    return Masks(full.shape[1], full.shape[2], boxes, parts, scores)


def tight_box(mask: Mask) -> tuple[int, int, int, int] | None:
    """Return x0, y0, x1, y1 of the smallest box around a mask, ends excluded; None for a mask without pixels."""
    rows = np.flatnonzero(mask.any(1))
    if not len(rows):
        return None
    columns = np.flatnonzero(mask[rows[0] : rows[-1] + 1].any(0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


@runtime_checkable
class Segmenter(Protocol):
    """Model that cuts an image into masks.

    identity: everything that decides what comes out (model, hash of its weights, settings), for
    fingerprints: two segmenters of equal identity give equal masks.
    """

    identity: Mapping[str, object]

    def segment(self, image: Pixels) -> Mapping[str, Masks]:
        """Return masks by level, keys from LEVELS; a segmenter of one level returns `large` only."""
        ...


MIN_KEPT_SHARE = 0.5  # of a mask's pixels; a smaller rest would be embedded as something else


def kept_masks(levels: Mapping[str, Masks], kept: Mask) -> dict[str, Masks]:
    """Return the masks of each level cut to the pixels that are kept; those that mostly are not are dropped."""
    return {level: _cut(masks, kept) for level, masks in levels.items()}


def _cut(masks: Masks, kept: Mask) -> Masks:
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
