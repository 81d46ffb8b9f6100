"""Which objects of a catalogue are meant, as the command line says it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .query_inputs import numbers

if TYPE_CHECKING:
    from datetime import datetime

    from ...query.catalogue.conditions import Corners, Degrees


def box(text: str | None) -> Corners | None:
    """Return the corners of a box such as "-1,0,0,2,3,1.5". Raises: InputError: not six finite numbers."""
    if text is None:
        return None
    a, b, c, d, e, f = numbers("--box", text, 6)
    return a, b, c, d, e, f


def area(text: str | None) -> Degrees | None:
    """Return the degrees of an area such as "13.3,52.4,13.5,52.6". Raises: InputError: not four finite numbers."""
    if text is None:
        return None
    west, south, east, north = numbers("--area", text, 4)
    return west, south, east, north


def moment(text: str | None) -> datetime | None:
    """Return the time of "2026-11-22" or "2026-11-22T14:00", on this machine's clock where no zone is given.

    Raises: InputError: no such time.
    """
    from datetime import datetime

    from ...errors import InputError

    if text is None:
        return None
    try:
        return datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError, OSError):
        raise InputError(f"--since {text}: expected a time, e.g. 2026-11-22 or 2026-11-22T14:00") from None
