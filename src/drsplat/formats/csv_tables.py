"""Small tables that people write: a line of column names, then a line for each row."""

from pathlib import Path

from ..base.contents import file_text
from ..errors import FormatError, InputError

MAX_ROWS = 1_000_000


def read_rows(path: Path, columns: tuple[str, ...], each: str) -> list[list[str]]:
    """Return the rows of a table below the line of its columns; how many cells each has is not checked.

    each: what a row holds, for messages.

    Raises: InputError: there is no such file. FormatError: no table of these columns, or more than `MAX_ROWS`.
    """
    import csv

    try:
        rows = list(csv.reader(file_text(path).splitlines(), strict=True))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path}: expected a table in UTF-8: {error}") from None
    if not rows or tuple(cell.strip() for cell in rows[0]) != columns or len(rows) > MAX_ROWS:
        raise FormatError(f"{path}: expected the line '{','.join(columns)}', and then {each} in each")
    return rows[1:]
