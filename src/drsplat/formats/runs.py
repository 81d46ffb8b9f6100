"""Rows of a scene in few numbers: spans in memory, lengths in turns in JSON."""

import numpy as np

from ..base.arrays import Int64, Integer
from ..errors import FormatError
from .json_files import as_count

MAX_GAUSSIANS = (1 << 31) - 1  # what the native core can count
Spans = Int64[np.ndarray, "s 2"]


def spans_of(ids: Integer[np.ndarray, " m"]) -> Spans:
    """Return the spans of ascending rows, each from its first number to before its second; none of no rows."""
    rows = ids.astype(np.int64)
    begins = np.flatnonzero(np.diff(rows, prepend=-2) != 1)
    lasts = np.append(begins[1:], len(rows))[: len(begins)] - 1
    return np.stack([rows[begins], rows[lasts] + 1], axis=1).reshape(-1, 2)


def are_rows(spans: Spans) -> bool:
    """Return True if spans are those of one or more ascending rows."""
    ends = spans.ravel()
    return bool(len(ends) and ends[0] >= 0 and (ends[1:] > ends[:-1]).all())


def ids_of(spans: Spans) -> Int64[np.ndarray, " m"]:
    """Return the rows that spans stand for. The caller has checked the last one, which may be any number."""
    lengths = spans[:, 1] - spans[:, 0]
    ends = np.cumsum(lengths)
    return np.asarray(np.arange(lengths.sum()) + np.repeat(spans[:, 1] - ends, lengths))


def runs_of(spans: Spans) -> list[int]:
    """Return lengths in turns: rows that are left out, rows that are in it, and so on."""
    runs: list[int] = np.diff(spans.ravel(), prepend=0).tolist()
    return runs


def spans_of_runs(value: object, where: str) -> Spans:
    """Return the spans of lengths from JSON. Raises: FormatError: no pairs of lengths."""
    if not isinstance(value, list):
        raise FormatError(f"{where}: expected a list of lengths")
    are_integers = set(map(type, value)) <= {int}  # millions of them: only others are looked at one by one
    lengths = value if are_integers else [as_count(run, where) for run in value]
    if len(lengths) % 2 or not 0 <= min(lengths, default=0) <= max(lengths, default=0) <= MAX_GAUSSIANS:
        raise FormatError(f"{where}: expected pairs of lengths: rows left out, rows in it")
    return np.cumsum(np.array(lengths, np.int64)).reshape(-1, 2)
