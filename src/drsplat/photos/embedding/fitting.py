"""Fit of photos to the nouns of the built-in encoder, known before a scene is made of them."""

from collections.abc import Iterable

import numpy as np
from PIL import Image

from ...base.arrays import OtherPixels
from ...kernels.algebra import dense_rows
from ...scene.masks.selection import mask_maps
from ..models.graph import GraphSegmenter
from ..models.mini import MiniEncoder
from .keeping import mask_rows

PICTURE_SIDE_PIXELS = 640


def pixel_fit(pictures: Iterable[OtherPixels], *, threads: int = 0) -> float:
    """Return the cosine of the best noun that half of the pixels' masks reach, 0 without pictures.

    Masks count by their pixels, as they do in the features of a field: eight photos then tell the rooms of the
    training from other scenes, at `MiniEncoder.least_fit`, as `query.naming.fit_of` does with the field (docs/mini.md).
    """
    encoder, segmenter = MiniEncoder(threads=threads), GraphSegmenter(threads=threads)
    nouns = encoder.encode_texts(encoder.nouns).T
    fits, areas = [np.zeros(1, np.float32)], [np.zeros(1, np.int64)]
    for picture in pictures:
        small = Image.fromarray(picture)
        small.thumbnail((PICTURE_SIDE_PIXELS, PICTURE_SIDE_PIXELS))
        pixels = np.asarray(small)
        masks = mask_maps(segmenter.segment(pixels)).masks
        fits.append(dense_rows(mask_rows(pixels, masks, encoder), nouns, threads=threads).max(1))
        areas.append(masks.areas)
    order, below = np.argsort(fit := np.concatenate(fits)), np.concatenate(areas)
    return float(fit[order][np.searchsorted(np.cumsum(below[order]), below.sum() / 2)])
