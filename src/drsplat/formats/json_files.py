"""JSON from strangers: numbers that are numbers, matrices that are matrices, objects as a dataclass describes them.

Rows of a scene in few numbers: spans in memory, lengths in turns in JSON.
"""

import json
import math
import os
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin

import numpy as np

from ..base.arrays import DoubleRows, Doubles, Matrix3, Matrix4, OtherIndices, RowIds, Spans, Vector3
from ..base.contents import AnyPath, Document, file_text
from ..errors import FormatError
from .replacing import replacing

T = TypeVar("T")
MAX_NUMBER = 1e100  # the product of three is still finite


def read_json(path: Path) -> object:
    """Read the document in `path`.

    Raises: InputError: there is no such file. FormatError: it is not UTF-8 JSON, nested too deep, or as `parsed` says.
    """
    try:
        text = file_text(path)
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


def write_json(path: AnyPath, document: object, overwrite: bool = False, end: str = "\n", **style: Any) -> None:
    """Write a document whole or not at all. style: of `json.dumps`, by default an indent of 1.

    Raises: InputError: as `replacing`.
    """
    text = json.dumps(document, **({"indent": 1} | style))
    with replacing(path, overwrite) as file:
        file.write(f"{text}{end}".encode())


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


def as_vector(value: object, length: int, where: str) -> Doubles:
    """Return `length` finite numbers."""
    if not isinstance(value, list) or len(value) != length:
        raise FormatError(f"{where}: expected {length} numbers, got {excerpt(value)}")
    return np.array([as_number(item, where) for item in value])


def as_matrix(value: object, rows: int, columns: int, where: str) -> DoubleRows:
    """Return `rows` lists of `columns` finite numbers."""
    if not isinstance(value, list) or len(value) != rows:
        raise FormatError(f"{where}: expected {rows} rows of {columns} numbers, got {excerpt(value)}")
    return np.stack([as_vector(row, columns, where) for row in value])


def as_object(value: object, where: str) -> Document:
    """Return an object's entries by name."""
    return _of_type(value, dict, "an object", where)


def as_list(value: object, where: str) -> list[Any]:
    """Return a list."""
    return _of_type(value, list, "a list", where)


def as_text(value: object, where: str) -> str:
    """Return a text."""
    return _of_type(value, str, "a text", where)


def as_kind(value: object, kind: Any, where: str) -> Any:
    """Return a value of a document as the kind of Python value that is expected there.

    A dataclass or a NamedTuple describes an object whose keys are its fields; further keys are left alone, and a field
    with a default may be missing:

        class Place(NamedTuple):
            center: Vector3
            name: str = ""

        places = as_kind(read_json(path), tuple[Place, ...], str(path))

    Args:
        value: what `read_json`, `document_in` or `parsed` returned.
        kind: `float`, `int` (1080.0 is one too), `str`, `bool`, `object` for anything, `Vector3`, `Matrix3`, `Matrix4`;
            `list[K]`, `tuple[K, ...]`, `dict[str, K]`, `Mapping[str, K]`, `K | None` and `Literal[...]`; a dataclass, a
            NamedTuple, or any function with annotations, which is called with the entries by name.
        where: names the value in errors, and begins the names of its parts: "places.json: 3: center".

    Raises: FormatError: it is of another kind; the message names the part.
    """
    origin, inner = get_origin(kind), get_args(kind)
    if kind in _CHECKS:
        return _CHECKS[kind](value, where)
    if NoneType in inner:
        return None if value is None else as_kind(value, inner[0], where)
    if origin is Literal:
        if value not in inner:
            raise FormatError(f"{where}: expected {' or '.join(map(repr, inner))}, got {excerpt(value)}")
        return value
    if origin in (list, tuple):
        return origin(as_kind(item, inner[0], f"{where}: {n}") for n, item in enumerate(as_list(value, where)))
    if origin in (dict, Mapping):
        items = as_object(value, where).items()
        return {name: as_kind(item, inner[1], f"{where}: {excerpt(name)}") for name, item in items}
    fields = signature(kind).parameters.values()
    entries = value if isinstance(value, dict) else {}
    expected = {one.name: one.annotation for one in fields if one.name in entries or one.default is one.empty}
    return kind(**as_fields(value, where, **expected))


def as_fields(value: object, where: str, /, **kinds: Any) -> Document:
    """Return some entries of an object by name, each as its kind, see `as_kind`; `K | None` may be missing."""
    entries = _of_type(value, dict, f"an object with {', '.join(kinds) or 'keys'}", where)
    return {name: as_kind(entries.get(name), kind, f"{where}: {name}") for name, kind in kinds.items()}


def as_document(value: object, where: str, name: str, version: object = None, cure: str = "") -> Document:
    """Return an object that names its format, and its version where it has one, as those that drsplat writes.

    Raises: FormatError: of another format or version. cure: ends the message, and says what to do.
    """
    document = value if isinstance(value, dict) else {}
    if (document.get("format"), document.get("version")) != (name, version):
        expected = f"'{name}'" if version is None else f"'{name}' of version {version}"
        got = document.get("version") if document.get("format") == name else document.get("format", value)
        raise FormatError(f"{where}: expected {expected}, got {excerpt(got)}. {cure}".removesuffix(". "))
    return document


def _of_type(value: object, kind: type[T], called: str, where: str) -> T:
    if not isinstance(value, kind):
        raise FormatError(f"{where}: expected {called}, got {excerpt(value)}")
    return value


_CHECKS: Mapping[Any, Callable[[Any, str], Any]] = {
    float: as_number,
    int: as_count,
    int | float: as_number,
    str: as_text,
    bool: lambda value, where: _of_type(value, bool, "true or false", where),
    object: lambda value, where: value,
    Vector3: lambda value, where: as_vector(value, 3, where),
    Matrix3: lambda value, where: as_matrix(value, 3, 3, where),
    Matrix4: lambda value, where: as_matrix(value, 4, 4, where),
}


def excerpt(value: object) -> str:
    """Format a value, short enough for an error message."""
    if isinstance(value, int) and value.bit_length() > 256:
        return "a huge integer"  # str() of it may be refused by Python itself
    text = ascii(value) if not isinstance(value, list | dict) else f"a {type(value).__name__} of {len(value)}"
    return text if len(text) <= 80 else text[:77] + "..."


MAX_GAUSSIANS = (1 << 31) - 1  # what the native core can count


def spans_of(ids: RowIds) -> Spans:
    """Return the spans of ascending rows, each from its first number to before its second; none of no rows."""
    rows = ids.astype(np.int64)
    begins = np.flatnonzero(np.diff(rows, prepend=-2) != 1)
    lasts = np.append(begins[1:], len(rows))[: len(begins)] - 1
    return np.stack([rows[begins], rows[lasts] + 1], axis=1).reshape(-1, 2)


def count_in(spans: Spans) -> int:
    """Return how many rows spans stand for."""
    return int((spans[:, 1] - spans[:, 0]).sum())


def are_rows(spans: Spans) -> bool:
    """Return True if spans are those of one or more ascending rows."""
    ends = spans.ravel()
    return bool(len(ends) and ends[0] >= 0 and (ends[1:] > ends[:-1]).all())


def ids_of(spans: Spans) -> OtherIndices:
    """Return the rows that spans stand for. The caller has checked the last one, which may be any number."""
    lengths = spans[:, 1] - spans[:, 0]
    ends = np.cumsum(lengths)
    return np.arange(lengths.sum()) + np.repeat(spans[:, 1] - ends, lengths)


def runs_of(spans: Spans) -> list[int]:
    """Return lengths in turns: rows that are left out, rows that are in it, and so on."""
    return np.diff(spans.ravel(), prepend=0).tolist()


def spans_of_runs(value: object, where: str) -> Spans:
    """Return the spans of lengths from JSON. Raises: FormatError: no pairs of lengths."""
    if not isinstance(value, list):
        raise FormatError(f"{where}: expected a list of lengths")
    are_integers = set(map(type, value)) <= {int}  # millions of them: only others are looked at one by one
    lengths = value if are_integers else [as_count(run, where) for run in value]
    if len(lengths) % 2 or not 0 <= min(lengths, default=0) <= max(lengths, default=0) <= MAX_GAUSSIANS:
        raise FormatError(f"{where}: expected pairs of lengths: rows left out, rows in it")
    return np.cumsum(np.array(lengths, np.int64)).reshape(-1, 2)
