"""Masks of one image, and who makes them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from .errors import InputError

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
    boxes: Int32[np.ndarray, "n 4"]
    parts: tuple[Bool[np.ndarray, "_ _"], ...]
    scores: Float32[np.ndarray, " n"]

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


@runtime_checkable
class Segmenter(Protocol):
    """An image to masks.

    identity: everything that decides what comes out (model, hash of its weights, settings), for
    fingerprints: two segmenters of equal identity give equal masks.
    """

    identity: Mapping[str, object]

    def segment(self, image: UInt8[np.ndarray, "h w 3"]) -> Mapping[str, Masks]:
        """Masks by level, keys from LEVELS; a segmenter of one level gives that of `large` only."""
        ...
