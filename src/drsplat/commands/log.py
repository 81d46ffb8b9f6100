"""--log FILE: what is said on stderr, in a file too."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOBase
from typing import Any, TextIO


class _Both(TextIOBase):
    """A terminal and a file; each line of the latter begins with its time. No terminal to those who ask for one, so
    that progress comes in lines."""

    def __init__(self, terminal: Any, file: TextIO) -> None:
        self._terminal, self._file, self._line = terminal, file, ""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return str(self._terminal.encoding)

    def isatty(self) -> bool:
        return False

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        self._terminal.write(text)
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            self._file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {line}\n")
        return len(text)

    def flush(self) -> None:
        self._terminal.flush()
        self._file.flush()


@contextmanager
def logged(path: str | None, begin: str) -> Iterator[None]:
    """What the block says on stderr is appended to a file, after a line that says what began."""
    if path is None:
        yield
        return
    before = sys.stderr
    with open(path, "a", encoding="utf-8", errors="backslashreplace") as file:
        both = _Both(before, file)
        file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {begin}\n")
        sys.stderr = both
        try:
            yield
        finally:
            sys.stderr = before
            both.flush()
