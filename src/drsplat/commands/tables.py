"""Tables on the terminal: a library for them takes longer to load than most questions take."""

import os
import sys
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from shutil import get_terminal_size
from textwrap import wrap

LEAST_ROOM = 10  # columns for a value, on however narrow a terminal


def show_facts(title: str, facts: Mapping[str, object]) -> None:
    """Names and values, one to a line; values are folded where a terminal ends."""
    names, values = [name.replace("_", " ") for name in facts], list(map(said, facts.values()))
    if sys.stdout.isatty():
        room = get_terminal_size().columns - max(map(_width, names), default=0) - 2
        values = [_folded(value, max(room, LEAST_ROOM)) for value in values]
    print(title)
    for line in _lines(zip(names, values, strict=True), "  ", to_right=False):
        print(line)


def show_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """The first column to the left, the others to the right; as wide as it needs to be, nothing is cut."""
    head, *body = _lines([columns, *rows], "   ", to_right=True)
    width = _width(head)
    blank, rule = " " * width, ("─" if _can_show("─") else "-") * width
    shown = f"\x1b[1m{head}\x1b[0m" if _is_bold_known() else head
    print(title)
    for line in (blank, shown, rule, *body, blank):
        print(f" {line} ")


def _lines(rows: Iterable[Sequence[str]], between: str, *, to_right: bool) -> Iterator[str]:
    """Return lines with cells as wide as their column; to_right: all but those of the first are moved there."""
    cells = [line for row in rows for line in zip_longest(*(cell.split("\n") for cell in row), fillvalue="")]
    widths = [max(map(_width, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        yield between.join(_padded(cell, widths[at], to_right and at > 0) for at, cell in enumerate(line))


def _padded(cell: str, width: int, to_right: bool) -> str:
    gap = " " * (width - _width(cell))
    return gap + cell if to_right else cell + gap


def _width(text: str) -> int:
    """Return the columns that a text takes: two for a letter of Chinese, none for an accent."""
    return len(text) if text.isascii() else sum(map(_width_of, text))


def _width_of(letter: str) -> int:
    if unicodedata.category(letter) in ("Mn", "Me", "Cf"):
        return 0
    return 2 if unicodedata.east_asian_width(letter) in "WF" else 1


def _folded(text: str, room: int) -> str:
    lines = (wrap(line, room, break_on_hyphens=False, replace_whitespace=False) or [""] for line in text.split("\n"))
    return "\n".join(part for parts in lines for part in parts)


def _can_show(text: str) -> bool:
    try:
        text.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return False
    return True


def _is_bold_known() -> bool:
    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def said(value: object) -> str:
    """A value for people: 1,234; 0.123; a, b."""
    if value is None:
        return "none"
    if hasattr(value, "tolist"):
        return said(value.tolist())
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {said(part)}" for name, part in value.items()) or "none"
    if isinstance(value, list | tuple):
        shown = ", ".join(said(part) for part in value[:8])
        return (shown + (f" and {len(value) - 8} more" if len(value) > 8 else "")) or "none"
    return str(value)


def size_said(num_bytes: int) -> str:
    amount, units = float(num_bytes), iter(("B", "KB", "MB", "GB", "TB"))
    unit = next(units)
    while amount >= 1000 and unit != "TB":
        amount, unit = amount / 1000, next(units)
    return f"{amount:.0f} {unit}" if unit == "B" else f"{amount:.1f} {unit}"
