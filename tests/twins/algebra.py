"""The float64 twins of `kernels.algebra`: slow, plain, and what the native kernels must compute."""

import numpy as np
from scipy import sparse

from drsplat.base.arrays import Float, Float64, Int64, Integer, UInt8


def weighted_rows(
    indptr: Integer[np.ndarray, " n1"],
    indices: Integer[np.ndarray, " e"],
    data: Float[np.ndarray, " e"],
    embeddings: Float[np.ndarray, "m d"],
    begin: int,
    end: int,
) -> Float64[np.ndarray, "b d"]:
    """Rows [begin, end) of W @ E, each divided by its L2 norm; a row of zero norm stays zero."""
    shape = (len(indptr) - 1, len(embeddings))
    weights = sparse.csr_array((data.astype(np.float64), indices, indptr), shape=shape)
    rows = weights[begin:end] @ embeddings.astype(np.float64)
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(np.divide(rows, norms, out=np.zeros_like(rows), where=norms > 0))


def dense_rows(a: Float[np.ndarray, "n k"], b: Float[np.ndarray, "k m"]) -> Float64[np.ndarray, "n m"]:
    """Return A @ B."""
    return np.asarray(a.astype(np.float64) @ b.astype(np.float64))


def convolve(
    images: Float[np.ndarray, "n h w c"], weight: Float[np.ndarray, "k o"], bias: Float[np.ndarray, " o"], stride: int
) -> Float64[np.ndarray, "n _ _ o"]:
    """Return a 3x3 convolution and ReLU, with one pixel of zeros around each image."""
    padded = np.pad(images.astype(np.float64), ((0, 0), (1, 1), (1, 1), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2))[:, ::stride, ::stride]
    rows = np.moveaxis(windows, 3, 5).reshape(*windows.shape[:3], weight.shape[0])
    return np.asarray(np.maximum(rows @ weight.astype(np.float64) + bias, 0))


def pq_distances(
    features: Float[np.ndarray, "n D"], centroids: Float[np.ndarray, "L c d"]
) -> Float64[np.ndarray, "n L c"]:
    """Squared L2 distance of every sub-vector to every centroid."""
    subvectors, _, dim = centroids.shape
    parts = features.astype(np.float64).reshape(len(features), subvectors, 1, dim)
    return np.asarray(((parts - centroids.astype(np.float64)) ** 2).sum(axis=3))


def pq_encode(features: Float[np.ndarray, "n D"], centroids: Float[np.ndarray, "L c d"]) -> UInt8[np.ndarray, "n L"]:
    """The nearest centroid of each sub-vector, ties to the lowest index."""
    return np.asarray(pq_distances(features, centroids).argmin(axis=2), np.uint8)


def code_sums(
    points: Float[np.ndarray, "n D"], codes: UInt8[np.ndarray, "n L"]
) -> tuple[Float64[np.ndarray, "L 256 d"], Int64[np.ndarray, "L 256"]]:
    """Return the sum of the sub-vectors of each code, in the order of points, and how many they are."""
    parts = points.astype(np.float64).reshape(*codes.shape, points.shape[1] // codes.shape[1])
    sums, counts = np.zeros((codes.shape[1], 256, parts.shape[2])), np.zeros((codes.shape[1], 256), np.int64)
    for m, column in enumerate(codes.T):
        np.add.at(sums[m], column, parts[:, m])
        np.add.at(counts[m], column, 1)
    return sums, counts


def pq_decode(codes: UInt8[np.ndarray, "n L"], centroids: Float[np.ndarray, "L c d"]) -> Float64[np.ndarray, "n D"]:
    """The centroids that the codes name, side by side."""
    rows = centroids.astype(np.float64)[np.arange(codes.shape[1]), codes]
    return np.asarray(rows.reshape(len(codes), -1))
