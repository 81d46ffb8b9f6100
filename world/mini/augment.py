"""What happens to a crop before it is learned: worse masks, things half hidden, other light."""

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion

from drsplat.mini.network import SIDE


def cut_out(
    image: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "s s 3"]:
    """The mask's box, black around the mask and to a square, as `drsplat.crops` does it; SIDE pixels."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    part = image[box] * mask[box][..., None]
    h, w = part.shape[:2]
    side = max(h, w)
    square = np.zeros((side, side, 3), np.uint8)
    top, left = (side - h) // 2, (side - w) // 2
    square[top : top + h, left : left + w] = part
    return np.asarray(Image.fromarray(square).resize((SIDE, SIDE), Image.Resampling.BILINEAR))


def augmented(
    image: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], rng: np.random.Generator
) -> UInt8[np.ndarray, "s s 3"]:
    """A crop as a segmenter might have made it of another photo of the same thing."""
    if rng.random() < 0.3:
        image = _coarser(image, rng)
    if rng.random() < 0.5:
        image, mask = image[:, ::-1], mask[:, ::-1]
    if rng.random() < 0.35:
        mask = _worse(mask, rng)
    if rng.random() < 0.35:
        mask = _half_hidden(mask, rng)
    picture = cut_out(image, mask).astype(np.float32)
    black = picture.max(2, keepdims=True) == 0
    light = rng.uniform(0.75, 1.25) * (1 + rng.normal(0, 0.03, 3))
    picture = (picture / 255) ** rng.uniform(0.85, 1.18) * 255 * light + rng.normal(
        0, 3, picture.shape
    )
    return np.where(black, 0, np.clip(picture, 0, 255)).astype(np.uint8)


def _coarser(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As from farther away."""
    side = image.shape[0]
    small = int(rng.integers(side // 4, side))
    scaled = Image.fromarray(image).resize((small, small), Image.Resampling.BOX)
    return np.asarray(scaled.resize((side, side), Image.Resampling.BILINEAR))


def _worse(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    steps = int(rng.integers(1, 4))
    changed = (
        binary_dilation(mask, iterations=steps)
        if rng.random() < 0.6
        else binary_erosion(mask, iterations=steps)
    )
    return changed if changed.sum() > 80 else mask


def _half_hidden(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Without what lies beyond a random line, at most half of it."""
    y, x = np.nonzero(mask)
    angle = rng.uniform(0, 2 * np.pi)
    along = x * np.cos(angle) + y * np.sin(angle)
    keep = along <= np.quantile(along, rng.uniform(0.5, 0.95))
    cut = np.zeros_like(mask)
    cut[y[keep], x[keep]] = True
    return cut if cut.sum() > 80 else mask
