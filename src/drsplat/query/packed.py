"""Vectors in six bits a number."""

from dataclasses import dataclass

import numpy as np

from ..base.arrays import Float32, Int8, UInt8

LARGEST = 31  # of the numbers


@dataclass(frozen=True, eq=False)
class Packed:
    """Vectors whose numbers are whole numbers from -31 to 31, times a step for each of the D dimensions.

    data: the numbers plus 31. Those of three quarters of a vector are the low six bits of a byte each; those of the
    last quarter lie in the high bits, the lowest two in the first quarter. So whole runs of bytes are unpacked at once.
    """

    data: UInt8[np.ndarray, "p b"]
    steps: Float32[np.ndarray, " D"]

    @classmethod
    def checked(cls, data: np.ndarray, steps: np.ndarray, dim: int) -> "Packed":
        """Return vectors that come from a file. Raises: ValueError: other shapes or steps than they have."""
        expected = 3 * _quarter(dim)
        if data.dtype != np.uint8 or data.shape[1:] != (expected,):
            raise ValueError(f"expected vectors of {expected} bytes, got {data.dtype} {data.shape}")
        if steps.dtype != np.float32 or steps.shape != (dim,) or not ((steps >= 0) & (steps <= 1)).all():
            raise ValueError(f"expected {dim} steps between 0 and 1")
        return cls(data, steps)

    @classmethod
    def none(cls, dim: int) -> "Packed":
        return cls(np.empty((0, 3 * _quarter(dim)), np.uint8), np.ones(dim, np.float32))

    @classmethod
    def of(cls, vectors: Float32[np.ndarray, "p D"]) -> "Packed":
        """Return vectors rounded, the largest number of each dimension 31 or -31."""
        steps = np.maximum(np.abs(vectors).max(axis=0, initial=0) / LARGEST, 1e-12).astype(np.float32)
        return cls(_packed(np.round(vectors / steps).astype(np.int8)), steps)

    def __len__(self) -> int:
        return len(self.data)

    @property
    def dim(self) -> int:
        return len(self.steps)

    @property
    def vectors(self) -> Float32[np.ndarray, "p D"]:
        return np.asarray(_unpacked(self.data, self.dim) * self.steps, np.float32)

    def products(self, queries: Float32[np.ndarray, "q D"]) -> Float32[np.ndarray, "q p"]:
        """Return the vectors' inner products with queries, without unpacking them."""
        weights = np.zeros((len(queries), 4 * _quarter(self.dim)), np.float32)
        weights[:, : self.dim] = queries * self.steps
        low, last = weights[:, : -_quarter(self.dim)], weights[:, -_quarter(self.dim) :]
        high = np.concatenate([last, 4 * last, 16 * last], axis=1)
        # Not by BLAS, whose threads would spin for longer than so few products take.
        sums = np.einsum("qb,pb->qp", low, (self.data & 63).astype(np.float32))
        sums += np.einsum("qb,pb->qp", high, (self.data >> 6).astype(np.float32))
        return np.asarray(sums - LARGEST * weights.sum(axis=1, keepdims=True), np.float32)


def _quarter(dim: int) -> int:
    return -(-dim // 4)


def _packed(numbers: Int8[np.ndarray, "p D"]) -> UInt8[np.ndarray, "p b"]:
    padded = np.pad(numbers + LARGEST, ((0, 0), (0, -numbers.shape[1] % 4))).astype(np.uint8)
    a, b, c, last = np.split(padded, 4, axis=1)
    return np.concatenate([a | last << 6, b | last >> 2 << 6, c | last >> 4 << 6], axis=1)


def _unpacked(data: UInt8[np.ndarray, "p b"], dim: int) -> Int8[np.ndarray, "p D"]:
    low, mid, high = np.split(data >> 6, 3, axis=1)
    numbers = np.concatenate([data & 63, low | mid << 2 | high << 4], axis=1)[:, :dim]
    return numbers.view(np.int8) - np.int8(LARGEST)
