"""Colours of Gaussians that say something: how well they answer, what was found, what they are."""

from collections.abc import Sequence

import numpy as np

from ...base.arrays import Flags, Float32, Ids, UInt8, Vectors
from ...drawing import heat
from ...field import LanguageField

ACCENTS = (
    (255, 170, 30), (60, 150, 255), (255, 70, 150), (70, 210, 110), (180, 110, 255), (60, 215, 220), (255, 95, 60),
    (200, 215, 60),
)  # fmt: skip
"""Colours of several queries at once, in the order of the queries."""

LUMA = heat.LUMA.astype(np.float32)
DIMMED_SHARE, DIM_FLOOR = 0.52, 0.08  # of its light that a Gaussian keeps where another is meant: dimmed, never black
GREYED_SHARE = 0.72  # of its colour that it loses
TINT_SHARE = 0.35  # of a query's colour in its matches, where there are several queries
LOOK = {"dim": DIMMED_SHARE, "floor": DIM_FLOOR, "greyed": GREYED_SHARE, "tint": TINT_SHARE}
"""The numbers above, as the client is told them: it paints answers as `highlighted` does."""
OBJECT_TINT_SHARE = 0.42  # of an object's colour, where every object has one of its own
HUE_TURNS_PER_OBJECT, CHROMA, CHROMA_STEP, CHROMA_DEPTH_SHARE = 0.618034, 0.5, 0.18, 0.8
SAMPLED_ROWS = 20_000


def accent(number: int) -> tuple[int, int, int]:
    return ACCENTS[number % len(ACCENTS)]


def dimmed(rgb: Vectors) -> Vectors:
    """Return colours with half their light and little of their hue, so that what is not dimmed stands out."""
    grey = (rgb @ LUMA)[:, None]
    return np.asarray(DIM_FLOOR + DIMMED_SHARE * (GREYED_SHARE * grey + (1 - GREYED_SHARE) * rgb), np.float32)


def highlighted(rgb: Vectors, owners: Ids, accents: Sequence[Sequence[int]]) -> Vectors:
    """Return what was found in its own colours and full light, the rest dimmed; as the client paints answers.

    Of several queries, what was found has a share of its query's colour.

    owners: the number of the query that found a Gaussian, -1 for none of them.
    """
    palette = np.array(accents, np.float32) / 255
    return _shaded(rgb, owners, palette, 0.0 if len(palette) == 1 else TINT_SHARE, 0.45)


def _shaded(rgb: Vectors, labels: Ids, palette: Float32[np.ndarray, "c 3"], tint: float, floor: float) -> Vectors:
    """Give what has a label a share of its colour, shaded by the scene's own light from `floor` on; dim the rest."""
    painted, found = dimmed(rgb), labels >= 0
    shade = (floor + (1 - floor) * (rgb[found] @ LUMA))[:, None]
    painted[found] = (1 - tint) * rgb[found] + tint * palette[labels[found]] * shade
    return np.clip(painted, 0, 1).astype(np.float32)


def class_painted(rgb: Vectors, labels: Ids, palette: UInt8[np.ndarray, "c 3"]) -> Vectors:
    """Paint classes in their colours, shaded by the scene's own light; dimmed where there is none."""
    return _shaded(rgb, labels, palette.astype(np.float32) / 255, 1.0, 0.5)


def object_colors(count: int) -> Vectors:
    """Return the colours of objects, as the client has them: hues far from each other, none of them loud."""
    numbers = np.arange(count)
    places = (np.array([5.0, 3.0, 1.0]) + (6 * (numbers * HUE_TURNS_PER_OBJECT % 1))[:, None]) % 6
    chroma = CHROMA + CHROMA_STEP * (numbers % 3)
    lost = CHROMA_DEPTH_SHARE * chroma[:, None] * np.clip(np.minimum(places, 4 - places), 0, 1)
    return np.asarray(1 - lost, np.float32)


def object_painted(rgb: Vectors, labels: Ids, count: int) -> Vectors:
    """Return objects with a share of a colour of their own, as the client paints them; the rest dimmed."""
    return _shaded(rgb, labels, object_colors(count), OBJECT_TINT_SHARE, 0.35)


def feature_colors(field: LanguageField, rgb: Vectors, registered: Flags, seed: int = 0) -> Vectors:
    """Return the three main directions of the field's features as red, green and blue; dimmed without a feature.

    rgb, registered: of every Gaussian of the scene. The directions are those of a sample of
    `SAMPLED_ROWS` rows, and each colour spans 98 of 100 of these.
    """
    painted, rows = dimmed(rgb), len(field)
    if rows < 3:
        return painted
    chosen = np.random.default_rng(seed).permutation(rows)[:SAMPLED_ROWS]
    sample = field.feature(np.sort(chosen)).astype(np.float64)
    middle = sample.mean(0)
    axes = np.linalg.eigh((sample - middle).T @ (sample - middle))[1][:, :-4:-1].T
    axes = axes * np.sign(axes[np.arange(3), np.abs(axes).argmax(1)])[:, None]  # a direction has two signs
    low, high = np.quantile((sample - middle) @ axes.T, (0.01, 0.99), axis=0)
    colors, block = np.empty((rows, 3), np.float32), 1 << 16
    for begin in range(0, rows, block):
        part = np.arange(begin, min(begin + block, rows))
        at = field.feature(part) @ axes.T.astype(np.float32) - middle @ axes.T
        colors[part] = np.clip((at - low) / np.maximum(high - low, 1e-9), 0, 1)
    painted[registered] = 0.08 + 0.9 * colors
    return painted
