"""Colours that are easy to tell apart."""

import colorsys

import numpy as np

from ..base.arrays import UInt8

LUMA = np.array([0.299, 0.587, 0.114])  # of red, green and blue: how light a colour looks
GOLDEN_TURN_SHARE = 0.6180339887498949  # between hues, which keeps any number of them apart


def class_colors(count: int) -> UInt8[np.ndarray, "c 3"]:
    """Return a colour per class: distinct hues, and neighbours in the list of different light."""
    hsv = [((0.02 + GOLDEN_TURN_SHARE * i) % 1, (0.85, 0.6)[i % 2], (0.95, 0.75)[i // 2 % 2]) for i in range(count)]
    rgb = np.array([colorsys.hsv_to_rgb(*color) for color in hsv]).reshape(count, 3)
    return np.asarray(np.round(255 * rgb), np.uint8)
