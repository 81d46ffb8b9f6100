"""JSON from strangers: numbers that are numbers, matrices that are matrices."""

import json
import math
import os
from pathlib import Path

import numpy as np

from ..base.arrays import Float64
from ..base.contents import file_text
from ..errors import FormatError, InputError

MAX_NUMBER = 1e100  # the product of three is still finite


def read_json(path: Path) -> object:
    """Read the document in `path`.

    Raises: InputError: there is no such file. FormatError: it is not UTF-8 JSON, nested too deep, or as `parsed` says.
    """
    try:
        text = file_text(path)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except UnicodeError as error:
        raise FormatError(f"{path}: expected JSON: {error}") from error
    return document_in(text, str(path))


def document_in(text: str | bytes, where: str) -> object:
    """Return the document of a text, see `read_json`. where: names the text in errors."""
    try:
        return parsed(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{where}: expected JSON: {error}") from error


def parsed(text: str | bytes) -> object:
    """Parse a JSON document; each name must be given once, and all text be Unicode that can be written.

    Raises: ValueError, RecursionError: it is not.
    """
    text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    document: object = json.loads(text, object_pairs_hook=unique_names)
    if "\\u" in text:  # only so may half a character come in
        try:
            json.dumps(document, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:
            half = ascii(error.object[error.start])
            raise ValueError(f"expected text that can be written, got half a character, {half}") from None
    return document


def is_text(value: object) -> bool:
    """Return whether a text can be written: JSON can hold half of a character, which no file can."""
    return isinstance(value, str) and value == value.encode(errors="ignore").decode()


def written_name(name: str) -> str:
    """Return the name of a file as a text that can be written; each byte that is not UTF-8 becomes `\\xff` or alike."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")


def unique_names(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Refuse names that are given twice, of which json.loads takes the last. Raises: ValueError."""
    entries = dict(pairs)
    if len(entries) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{excerpt(twice)} is given twice")
    return entries


def as_number(value: object, where: str) -> float:
    """Return a finite float; `where` names the value in the error.

    Raises: FormatError: not a number, not finite, or beyond `MAX_NUMBER`.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FormatError(f"{where}: expected a number, got {excerpt(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not abs(number) <= MAX_NUMBER:
        raise FormatError(f"{where}: expected a finite number up to {MAX_NUMBER:g}, got {excerpt(value)}")
    return number


def as_count(value: object, where: str) -> int:
    """Return a value as a whole number; files also write them as 1080.0."""
    number = as_number(value, where)
    if number != int(number):
        raise FormatError(f"{where}: expected a whole number, got {excerpt(value)}")
    return int(number)


def as_vector(value: object, length: int, where: str) -> Float64[np.ndarray, " n"]:
    """Return `length` finite numbers."""
    if not isinstance(value, list) or len(value) != length:
        raise FormatError(f"{where}: expected {length} numbers, got {excerpt(value)}")
    return np.array([as_number(item, where) for item in value])


def as_matrix(value: object, rows: int, columns: int, where: str) -> Float64[np.ndarray, "r c"]:
    """Return `rows` lists of `columns` finite numbers."""
    if not isinstance(value, list) or len(value) != rows:
        raise FormatError(f"{where}: expected {rows} rows of {columns} numbers, got {excerpt(value)}")
    return np.stack([as_vector(row, columns, where) for row in value])


def excerpt(value: object) -> str:
    """Format a value, short enough for an error message."""
    if isinstance(value, int) and value.bit_length() > 256:
        return "a huge integer"  # str() of it may be refused by Python itself
    text = ascii(value) if not isinstance(value, list | dict) else f"a {type(value).__name__} of {len(value)}"
    return text if len(text) <= 80 else text[:77] + "..."
