"""Matches and objects as a pandas table."""

from collections.abc import Iterable
from typing import Any

from ...errors import MissingExtraError
from ...query import Match


def to_frame(matches: Iterable[Match]) -> Any:
    """Return a `pandas.DataFrame` with a row for each match, in order.

    Columns: score, num_gaussians, x, y, z of the centre, length, width, height of the box, object_id, label.

    Raises: MissingExtraError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise MissingExtraError("pandas is not installed: pip install pandas") from None
    return pandas.DataFrame([_row(match) for match in matches], columns=COLUMNS)


COLUMNS = ["score", "num_gaussians", "x", "y", "z", "length", "width", "height", "object_id", "label"]


def _row(match: Match) -> tuple[object, ...]:
    return (match.score, len(match), *match.center.tolist(), *match.extent.tolist(), match.object_id, match.label)
