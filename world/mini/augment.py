"""What happens to a crop before it is learned: worse masks, things half hidden, other light, other paint."""

import numpy as np
from jaxtyping import UInt8
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion

from drsplat.base.arrays import Mask, Pixels
from drsplat.photos.models.mini.encoder import INPUT_SIDE_PIXELS
from drsplat.scene.masks.crops import crop
from drsplat.scene.masks.masks import tight_box


def cut_out(image: Pixels, mask: Mask) -> UInt8[np.ndarray, "s s 3"]:
    """What `mini` sees of a mask: its crop as `drsplat.scene.masks.crops` makes it, SIDE pixels."""
    x0, y0, x1, y1 = tight_box(mask) or (0, 0, 1, 1)
    square = crop(image, mask[y0:y1, x0:x1], (x0, y0, x1, y1))
    return np.asarray(Image.fromarray(square).resize((INPUT_SIDE_PIXELS, INPUT_SIDE_PIXELS), Image.Resampling.BILINEAR))


def augmented(image: Pixels, mask: Mask, rng: np.random.Generator) -> UInt8[np.ndarray, "s s 3"]:
    """A crop as a segmenter might have made it of another photo of the same thing."""
    if rng.random() < 0.3:
        image = _coarser(image, rng)
    if rng.random() < 0.5:
        image, mask = image[:, ::-1], mask[:, ::-1]
    if rng.random() < 0.35:
        mask = _worse(mask, rng)
    if rng.random() < 0.45:
        mask = _half_hidden(mask, rng)
    picture = cut_out(image, mask).astype(np.float32)
    black = picture.max(2, keepdims=True) == 0
    light = rng.uniform(0.75, 1.25) * (1 + rng.normal(0, 0.03, 3))
    picture = (picture / 255) ** rng.uniform(0.85, 1.18) * 255 * light + rng.normal(0, 3, picture.shape)
    return np.where(black, 0, np.clip(picture, 0, 255)).astype(np.uint8)


def repainted(picture: UInt8[np.ndarray, "s s 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "s s 3"]:
    """The same shape and shading in other colours and, at times, under a pattern: what it is made of and
    its colour are then unknown, what it is stays."""
    black = picture.max(2, keepdims=True) == 0
    mixed = picture[..., rng.permutation(3)].astype(np.float32)
    if rng.random() < 0.3:
        mixed = np.repeat(mixed.mean(2, keepdims=True), 3, 2) * rng.uniform(0.5, 1.5, 3)
    if rng.random() < 0.6:
        share = _pattern(picture.shape[0], rng)[..., None] * rng.uniform(0.4, 1)
        shade = mixed.mean(2, keepdims=True) / 128
        mixed = (1 - share) * mixed + share * shade * rng.uniform(20, 235, 3)
    return np.where(black, 0, np.clip(mixed, 1, 255)).astype(np.uint8)


def _pattern(side: int, rng: np.random.Generator) -> np.ndarray:
    """Stripes, checks, dots or blots: 0 and 1."""
    y, x = np.mgrid[:side, :side] / side
    angle, size = rng.uniform(0, np.pi), rng.uniform(2, 12)
    u = size * (x * np.cos(angle) + y * np.sin(angle)) + rng.random()
    v = size * (y * np.cos(angle) - x * np.sin(angle)) + rng.random()
    kind = int(rng.integers(4))
    if kind == 0:
        return (u % 1 < rng.uniform(0.3, 0.7)).astype(np.float32)
    if kind == 1:
        return ((u % 1 < 0.5) ^ (v % 1 < 0.5)).astype(np.float32)
    if kind == 2:
        return ((u % 1 - 0.5) ** 2 + (v % 1 - 0.5) ** 2 < rng.uniform(0.03, 0.12)).astype(np.float32)
    waves = np.sin(2 * u + rng.normal(0, 2, 3)[:, None, None] * v) * np.sin(3 * v + 2 * u[None])
    return (waves.sum(0) > rng.uniform(-0.8, 0.8)).astype(np.float32)


def _coarser(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As from farther away."""
    side = image.shape[0]
    small = int(rng.integers(side // 4, side))
    scaled = Image.fromarray(image).resize((small, small), Image.Resampling.BOX)
    return np.asarray(scaled.resize((side, side), Image.Resampling.BILINEAR))


def _worse(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    steps = int(rng.integers(1, 4))
    changed = binary_dilation(mask, iterations=steps) if rng.random() < 0.6 else binary_erosion(mask, iterations=steps)
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
