"""Embeddings with the statistics of a published CLIP codebook, for masks whose real CLIP embeddings nobody has.

They are drawn, not measured: per thing a direction near a coarse centroid of the index, per mask that
direction plus the noise of views (covariance of the coarse centroids) and of residual codes.
"""

from pathlib import Path

import numpy as np

from drsplat import EncoderIdentity
from drsplat.field.codes import read_faiss_codebook

INDEX, TEXTS = "pq_index.faiss", "text_negative.npy"
CLIP = EncoderIdentity("drawn like ViT-B-16", 512)


def unit(rows: np.ndarray) -> np.ndarray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


class Drawn:
    """folder: has an IndexIVFPQ and embeddings of texts that mean nothing in particular."""

    def __init__(self, folder: Path, seed: int = 0) -> None:
        book = read_faiss_codebook(folder / INDEX, CLIP)
        assert book.coarse is not None
        self.rng = np.random.default_rng(seed)
        self.centroids = book.centroids
        self.coarse = book.coarse[np.linalg.norm(book.coarse, axis=1) > 0.5]
        self.mean = self.coarse.mean(axis=0)
        covariance = np.cov(self.coarse.T) + 1e-7 * np.eye(book.dim)
        self.spread = np.linalg.cholesky(covariance).astype(np.float32)
        self.common_text = unit(unit(np.load(folder / TEXTS)).mean(axis=0, keepdims=True))[0]

    def residuals(self, count: int) -> np.ndarray:
        parts, _, dim = self.centroids.shape
        codes = self.rng.integers(0, 256, (count, parts))
        drawn = self.centroids[np.arange(parts), codes] - self.centroids.mean(axis=1)
        return drawn.reshape(count, parts * dim)

    def things(self, count: int) -> np.ndarray:
        near = self.coarse[self.rng.choice(len(self.coarse), count, replace=count > len(self.coarse))]
        return unit(near + 1.1 * self.residuals(count))

    def masks(self, things: np.ndarray) -> np.ndarray:
        """One embedding for each row of `things`."""
        count, dim = things.shape
        views = self.rng.standard_normal((count, dim), np.float32) @ self.spread.T
        noise = 0.006 * self.rng.standard_normal((count, dim), np.float32)
        return unit(things + 0.7 * views + self.residuals(count) + noise)

    def texts(self, things: np.ndarray) -> np.ndarray:
        """A query for each row of `things`, as far from images as texts are."""
        noise = unit(self.rng.standard_normal(things.shape, np.float32))
        return unit(0.75 * self.common_text + 0.22 * unit(things - self.mean) + 0.55 * noise)
