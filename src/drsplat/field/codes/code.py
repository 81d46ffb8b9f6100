"""Protocol of every code: the features of n rows, kept small, and searched without being decoded."""

from typing import NamedTuple, Protocol, runtime_checkable

from ...base.arrays import Arrays, Embedding, Embeddings, FloatRows, Ids, Indices, Numbers, WholeNumbers
from ...errors import InputError


class Hits(NamedTuple):
    """Rows that a search returns, and their scores."""

    rows: Indices
    scores: Numbers


class Best(NamedTuple):
    """Best of several queries for each row: its index, its score, and the second best score.

    Ties go to the first query. With one query the second best score is -inf.
    """

    index: Ids  # type: ignore[assignment]  # hides tuple.index
    scores: Numbers
    runner_up: Numbers


@runtime_checkable
class Code(Protocol):
    """Coded features of n rows.

    Queries are unit vectors, and a score is the cosine with the decoded feature; 0 for a row without
    direction. threads: 0 takes all cores; all answers are the same to the bit for any number of them.
    """

    @property
    def kind(self) -> str:
        """Name of the code in files."""

    @property
    def dim(self) -> int: ...

    @property
    def nbytes(self) -> int:
        """Bytes of all rows together, without what they share."""

    def __len__(self) -> int: ...

    def scores(self, queries: Embeddings, *, threads: int = 0) -> FloatRows:
        """Return the score of every row for each query; the same whether a query comes alone or among others."""

    def select(self, query: Embedding, threshold: float, floor: Numbers | None = None, *, threads: int = 0) -> Hits:
        """Return the rows whose score, minus the row's `floor`, exceeds the threshold; ascending."""

    def top(self, query: Embedding, count: int, *, threads: int = 0) -> Hits:
        """Return the `count` best rows, best first, ties to the lower row."""

    def best(self, queries: Embeddings, *, threads: int = 0) -> Best:
        """Return the best query of each row, without a matrix of queries and rows."""

    def decode(self, rows: WholeNumbers) -> Embeddings:
        """Return the unit features of some rows; zero for a row without direction."""

    def rows(self, index: WholeNumbers) -> "Code":
        """Return the code of some rows."""

    def run(self, begin: int, end: int) -> "Code":
        """Return a run of rows without copying them; its scores have the bits that they have among all rows.

        Raises: InputError: a run that begins in the middle of rows that are scanned together.
        """

    def tensors(self) -> Arrays:
        """Return all arrays by name, as they are written to files."""


def check_run(begin: int, together: int) -> None:
    """Check that a run begins where rows that are scanned together do. Raises: InputError: it does not."""
    if begin % together:
        raise InputError(f"expected a run that begins at a multiple of {together} rows, got {begin}")
