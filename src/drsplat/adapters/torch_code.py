"""A product-quantised code on any device of torch: decoded a block at a time, then one matrix product.

For machines whose memory is faster on another device; on a CPU the native scan is many times faster. It has
been run on torch's CPU device only: how fast it is on a GPU was not measured.
"""

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32, Integer

from ..codes import Best, Hits, PQCode
from ..errors import InputError
from .devices import chosen_device

BLOCK = 1 << 15  # rows decoded at once: 64 MiB of 512 numbers
KEPT = 1 << 12  # queries that a block is compared with at once

_Tensor = Any  # torch may not be installed


class TorchCode:
    """The features of a PQCode, searched by torch; answers as `codes.Code` has them, in NumPy.

    device: "auto", "cpu", "cuda" or "mps". Scores are float32 products, off by about 1e-6; of
    equals `best` may name any.

    Raises: InputError: no such device. MissingExtraError: this machine has not got it.
    """

    kind = "pq"

    def __init__(self, code: PQCode, device: str = "auto") -> None:
        self._torch = import_module("torch")
        self._device = chosen_device(device)
        self._code = code
        codes = code.codes()
        book = code.codebook
        self._codes = self._held(codes.codes)
        self._norms = self._held(code.inverse_norms)
        self._centroids = self._held(book.centroids)
        self._coarse = None if book.coarse is None else self._held(book.coarse)
        ids = codes.coarse_ids
        self._ids = None if ids is None else self._held(ids.astype(np.int32))
        self._parts = self._torch.arange(book.num_subvectors, device=self._device)

    def __len__(self) -> int:
        return len(self._code)

    @property
    def dim(self) -> int:
        return self._code.dim

    @property
    def nbytes(self) -> int:
        return self._code.nbytes

    def scores(
        self, queries: Float32[np.ndarray, "q D"], *, threads: int = 0
    ) -> Float32[np.ndarray, "q n"]:
        """See Code. threads: torch has its own."""
        found = np.empty((len(queries), len(self)), np.float32)
        asked = self._held(queries)
        for rows, features in self._blocks():
            found[:, rows] = (asked @ features.T).cpu().numpy()
        return found

    def select(
        self,
        query: Float32[np.ndarray, " D"],
        threshold: float,
        floor: Float32[np.ndarray, " n"] | None = None,
        *,
        threads: int = 0,
    ) -> Hits:
        """See Code."""
        asked, hits = self._held(query), []
        for rows, features in self._blocks():
            scores = features @ asked
            margins = scores if floor is None else scores - self._held(floor[rows])
            found = (margins > threshold).nonzero()[:, 0]
            hits.append((found.cpu().numpy() + rows.start, scores[found].cpu().numpy()))
        return _joined(hits)

    def top(self, query: Float32[np.ndarray, " D"], count: int, *, threads: int = 0) -> Hits:
        """See Code. Raises: InputError: a count below 1."""
        if count < 1:
            raise InputError(f"expected to be asked for 1 row or more, got {count}")
        asked, hits = self._held(query), []
        for rows, features in self._blocks():
            scores = (features @ asked).cpu().numpy()
            best = np.argsort(-scores, kind="stable")[:count]
            hits.append((best + rows.start, scores[best]))
        found = _joined(hits)
        order = np.argsort(-found.scores, kind="stable")[:count]
        return Hits(found.rows[order], found.scores[order])

    def best(self, queries: Float32[np.ndarray, "q D"], *, threads: int = 0) -> Best:
        """See Code. Raises: InputError: no queries, or more than 4096."""
        if not 0 < len(queries) <= KEPT:
            raise InputError(f"expected 1 to {KEPT} queries to choose from, got {len(queries)}")
        asked, count = self._held(queries), len(self)
        answer = Best(np.zeros(count, np.int32), *(np.full(count, -np.inf, "f") for _ in range(2)))
        for rows, features in self._blocks():
            scores = features @ asked.T
            best, index = scores.max(dim=1)
            answer.scores[rows] = best.cpu().numpy()
            answer.index[rows] = index.cpu().numpy()
            if len(queries) > 1:
                scores.scatter_(1, index[:, None], -np.inf)
                answer.runner_up[rows] = scores.max(dim=1)[0].cpu().numpy()
        return answer

    def decode(self, rows: Integer[np.ndarray, " b"]) -> Float32[np.ndarray, "b D"]:
        """See Code."""
        return self._code.decode(rows)

    def rows(self, index: Integer[np.ndarray, " b"]) -> "TorchCode":
        """See Code."""
        return TorchCode(self._code.rows(index), self._device)

    def tensors(self) -> dict[str, np.ndarray]:
        """See Code."""
        return self._code.tensors()

    def _held(self, array: np.ndarray) -> _Tensor:
        return self._torch.from_numpy(np.array(array)).to(self._device)

    def _blocks(self) -> Iterator[tuple[slice, _Tensor]]:
        """Unit features of some rows at a time."""
        for begin in range(0, len(self), BLOCK):
            rows = slice(begin, min(begin + BLOCK, len(self)))
            features = self._centroids[self._parts, self._codes[rows].int()].flatten(1)
            if self._coarse is not None and self._ids is not None:
                features = features + self._coarse[self._ids[rows]]
            yield rows, features * self._norms[rows, None]


def _joined(hits: list[tuple[np.ndarray, np.ndarray]]) -> Hits:
    rows = [np.empty(0, np.int64), *(found.astype(np.int64) for found, _ in hits)]
    scores = [np.empty(0, np.float32), *(score for _, score in hits)]
    return Hits(np.concatenate(rows), np.concatenate(scores))
