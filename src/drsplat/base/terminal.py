"""Text on its way to a terminal or a notebook, which obey some characters instead of showing them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePath

# controls but tab and newline, what turns the direction of writing, and halves of surrogate pairs
_UNSHOWN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
MAX_QUOTED_CHARACTERS = 60


def plain(text: str) -> str:
    """Return the text with control characters written out: an escape sequence is \\x1b[2J, and does nothing."""
    return _UNSHOWN.sub(lambda match: _written(ord(match[0])), text)


def _written(code: int) -> str:
    return f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"


def plain_json(value: object) -> object:
    """Return a JSON object with all its texts, also names and paths, made `plain`."""
    if isinstance(value, str):
        return plain(value)
    if isinstance(value, PurePath):
        return plain(str(value))
    if isinstance(value, Mapping):
        return {plain_json(name): plain_json(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(part) for part in value]
    return value


def quoted(text: str) -> str:
    """Quote an input for a message: plain, in quotes, and not longer than a line."""
    shown = plain(text[: MAX_QUOTED_CHARACTERS + 1])
    return f"'{shown[:MAX_QUOTED_CHARACTERS]}...'" if len(text) > MAX_QUOTED_CHARACTERS else f"'{shown}'"


def counted(number: int, thing: str, things: str | None = None) -> str:
    """Return a number with its noun: 1 photo, 2 photos. things: the plural where it is not `thing` and s."""
    return f"{number:,} {thing if number == 1 else things or thing + 's'}"


def facts_html(title: str, facts: Mapping[str, object]) -> str:
    """Return a small HTML table for a notebook: a title, and a row for each fact."""
    rows = "".join(f"<tr><th>{_cell(name)}</th><td>{_cell(fact)}</td></tr>" for name, fact in facts.items())
    return f"<table><caption><b>{_cell(title)}</b></caption>{rows}</table>"


def rows_html(title: str, names: Sequence[str], rows: Iterable[Sequence[object]], of: int) -> str:
    """Return an HTML table for a notebook; where `of` rows are more than are shown it says how many."""
    lines = ["".join(f"<td>{_cell(value)}</td>" for value in row) for row in rows]
    head = "".join(f"<th>{_cell(name)}</th>" for name in names)
    more = f"<tr><td colspan={len(names)}>and {of - len(lines):,} more</td></tr>" if of > len(lines) else ""
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><caption><b>{_cell(title)}</b></caption><tr>{head}</tr>{body}{more}</table>"


def numbers_text(numbers: Iterable[float]) -> str:
    """Write the coordinates of a point or a size: 1.5, 0, -2.25."""
    return ", ".join(f"{number:.4g}" for number in numbers)


def _cell(value: object) -> str:
    from html import escape

    return escape(plain(str(value)))
