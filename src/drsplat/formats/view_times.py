"""When photos were taken: by a pattern of their names, or a table."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import FormatError, InputError
from ..scene.views import View
from .csv_tables import read_rows
from .photo_files import by_folded, folded, listed

HOLE = "{time}"
_NUMBER = r"([0-9]{1,15}(?:\.[0-9]{1,15})?)"


def with_times(views: Sequence[View], times: str | Path) -> list[View]:
    """Return every view with its time.

    times: the name of a table, NAME.csv, with a line "name,time" first; or a pattern of names such as
    "cam*/frame_{time}.png": {time} stands for the number that is the time, * for anything within a folder's or file's
    name, and all of the name has to fit, but for its suffix where the pattern has none.

    Raises: InputError: no such table, no {time} in the pattern, or views that have no time by it. FormatError: a
    damaged table.
    """
    text = str(times)
    if HOLE in text:
        found = _by_pattern(views, text)
    elif text.lower().endswith(".csv"):
        found = read_times(Path(times))
    else:
        raise InputError(f"times: expected a table NAME.csv, or a pattern such as cam*/frame_{HOLE}.png; got {text!r}")
    found = {key: found[name] for key, name in by_folded(found).items()} | found
    missing = [view.name for view in views if _key(view, found) is None]
    if missing:
        raise InputError(f"{len(missing)} of {len(views)} views have no time by {text!r}: {listed(missing)}")
    return [replace(view, time=found[key]) for view in views if (key := _key(view, found)) is not None]


def read_times(path: Path) -> dict[str, float]:
    """Read the times of a table by the names of photos, with or without suffix.

    Raises: InputError: there is no such file. FormatError: not a table of names and finite numbers, or a name twice.
    """
    found: dict[str, float] = {}
    for number, row in enumerate(read_rows(path, ("name", "time"), "a name and a number"), 2):
        name, time = _row(row, f"{path}, line {number}")
        if name in found:
            raise FormatError(f"{path}, line {number}: '{name}' is there twice")
        found[name] = time
    return found


def _row(row: list[str], where: str) -> tuple[str, float]:
    try:
        name, time = row[0].strip(), float(row[1])
        if len(row) == 2 and math.isfinite(time):
            return name, time
    except (ValueError, IndexError):
        pass
    raise FormatError(f"{where}: expected a name and a finite number, got {ascii(','.join(row))[:80]}")


def _by_pattern(views: Sequence[View], pattern: str) -> dict[str, float]:
    before, _, after = pattern.partition(HOLE)
    if HOLE in after:
        raise InputError(f"times: expected {HOLE} once in {pattern!r}")
    parts = (re.escape(part).replace(r"\*", "[^/]*?") for part in (before, after))
    suffix = "" if Path(pattern).suffix else r"(?:\.[^./]+)?"
    whole = re.compile(_NUMBER.join(parts) + suffix)
    fits = {view.name: whole.fullmatch(view.name) for view in views}
    return {name: float(fit[1]) for name, fit in fits.items() if fit}


def _key(view: View, found: Mapping[str, float]) -> str | None:
    stem = str(Path(view.name).with_suffix("").as_posix())
    return next((key for key in (view.name, stem, folded(view.name), folded(stem)) if key in found), None)
