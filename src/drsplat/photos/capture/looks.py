"""Appearance of a photo as one vector: its SIFT descriptors relative to the words of a small vocabulary.

The vocabulary is trained on the photos themselves, so nothing is downloaded.
Source: Jegou et al., Aggregating local descriptors into a compact image representation, CVPR 2010 (VLAD), with the
intra-normalisation of Arandjelovic and Zisserman, All about VLAD, CVPR 2013.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ...base.arrays import Float32

NUM_WORDS, KMEANS_STEPS = 32, 12
MAX_TRAINING_DESCRIPTORS = 40_000  # of the vocabulary
MAX_DESCRIPTORS = 2_000  # of a photo

Descriptors = Float32[np.ndarray, "n 128"]


def looks_of(keys: Sequence[str], read: Callable[[str], Descriptors]) -> Float32[np.ndarray, "p d"]:
    """Return a unit vector for each photo, zeros for one without descriptors; one photo is in memory at a time.

    read: returns the descriptors of a photo by its key, of unit length.
    """
    vocabulary = _vocabulary(keys, read)
    if vocabulary is None:
        return np.zeros((len(keys), 1), np.float32)
    return np.stack([_look(_thinned(read(key), MAX_DESCRIPTORS), vocabulary) for key in keys])


def _vocabulary(keys: Sequence[str], read: Callable[[str], Descriptors]) -> Float32[np.ndarray, "w 128"] | None:
    """Return the centres of a k-means of descriptors of all photos; None for too few descriptors."""
    each = max(1, MAX_TRAINING_DESCRIPTORS // max(len(keys), 1))
    step = max(1, len(keys) // MAX_TRAINING_DESCRIPTORS)
    sample = np.concatenate([_thinned(read(key), each) for key in keys[::step]] or [np.empty((0, 128), np.float32)])
    if len(sample) < 4 * NUM_WORDS:
        return None
    centres = sample[np.random.default_rng(0).choice(len(sample), NUM_WORDS, replace=False)]
    for _ in range(KMEANS_STEPS):
        nearest = _nearest(sample, centres)
        for word in range(NUM_WORDS):
            if (nearest == word).any():
                centres[word] = sample[nearest == word].mean(axis=0)
    return centres


def _look(descriptors: Descriptors, vocabulary: Float32[np.ndarray, "w 128"]) -> Float32[np.ndarray, " d"]:
    """Return the VLAD vector of a photo."""
    nearest = _nearest(descriptors, vocabulary)
    look = np.zeros_like(vocabulary)
    np.add.at(look, nearest, descriptors - vocabulary[nearest])
    look /= np.maximum(np.linalg.norm(look, axis=1, keepdims=True), 1e-9)
    flat = look.reshape(-1)
    return np.asarray(flat / max(float(np.linalg.norm(flat)), 1e-9), np.float32)


def _nearest(descriptors: Descriptors, centres: Float32[np.ndarray, "w 128"]) -> np.ndarray:
    return np.asarray(((centres**2).sum(1) - 2 * descriptors @ centres.T).argmin(axis=1))


def _thinned(descriptors: Descriptors, most: int) -> Descriptors:
    """Return at most `most` descriptors, evenly chosen."""
    return descriptors[np.linspace(0, len(descriptors) - 1, min(most, len(descriptors))).astype(np.intp)]
