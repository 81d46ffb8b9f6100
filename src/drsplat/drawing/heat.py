"""Heat of an answer: values to heat, and heat to colours; and colours that are easy to tell apart."""

import colorsys

import numpy as np

from ..base.arrays import Colors, Numbers, Vectors

LUMA = np.array([0.299, 0.587, 0.114])  # of red, green and blue: how light a colour looks
GOLDEN_TURN_SHARE = 0.6180339887498949  # between hues, which keeps any number of them apart
Values = Numbers

HEAT = np.array(
    [
        (0.05, 0.06, 0.20),
        (0.17, 0.24, 0.62),
        (0.16, 0.62, 0.72),
        (0.62, 0.80, 0.30),
        (0.98, 0.72, 0.16),
        (0.86, 0.14, 0.10),
    ],
    np.float32,
)
"""Colours from dark blue to red, evenly spaced over heat from 0 to 1."""


def heat_of(values: Values, threshold: float) -> Values:
    """Return heat: 0 at the median and below, 0.5 at the threshold, 1 at the highest value.

    Where nothing is above the threshold, nothing is warmer than 0.5.
    """
    middle, top = float(np.median(values)), float(values.max(initial=0))
    middle, top = min(middle, threshold - 1e-6), max(top, threshold + 1e-6)
    below = (values - middle) / (2 * (threshold - middle))
    above = 0.5 + (values - threshold) / (2 * (top - threshold))
    return np.clip(np.where(values <= threshold, below, above), 0, 1).astype(np.float32)


def heat_colors(heat: Values) -> Vectors:
    """Map heat in [0, 1] to colours, linearly between those of `HEAT`."""
    at = np.clip(heat, 0, 1) * (len(HEAT) - 1)
    low = np.minimum(at.astype(np.int64), len(HEAT) - 2)
    share = (at - low)[:, None].astype(np.float32)
    return HEAT[low] * (1 - share) + HEAT[low + 1] * share


def class_colors(count: int) -> Colors:
    """Return a colour per class: distinct hues, and neighbours in the list of different light."""
    hsv = [((0.02 + GOLDEN_TURN_SHARE * i) % 1, (0.85, 0.6)[i % 2], (0.95, 0.75)[i // 2 % 2]) for i in range(count)]
    rgb = np.array([colorsys.hsv_to_rgb(*color) for color in hsv]).reshape(count, 3)
    return np.asarray(np.round(255 * rgb), np.uint8)
