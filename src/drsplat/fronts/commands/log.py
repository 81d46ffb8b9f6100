"""--log FILE: a copy of what is written to stderr, with times."""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import TextIOBase
from pathlib import Path
from typing import Any, TextIO

from ...base.system import NO_WAITING, OWN_FILE_FLAGS, can_be_a_path
from ...base.terminal import plain
from ...errors import InputError


class _Tee(TextIOBase):
    """Stream that writes to a terminal and, with the time before each line, to a file.

    It does not claim to be a terminal (`isatty`), so that progress comes in lines.
    """

    def __init__(self, terminal: Any, file: TextIO) -> None:
        self._terminal, self._file, self._line = terminal, file, ""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return str(self._terminal.encoding)

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        self._terminal.write(text)
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            self._file.write(f"{_now()} {plain(line)}\n")
        return len(text)

    def flush(self) -> None:
        self._terminal.flush()
        self._file.flush()


def path_of(options: Sequence[str]) -> str | None:
    """Return the path of the last --log, as argparse reads it; None for what is no path, which is an error later.

    The log begins before the line is parsed, so that it has errors in the line too.
    """
    pairs = zip(options, [*options[1:], ""], strict=False)
    paths = [after if text == "--log" else text[6:] for text, after in pairs if text.split("=")[0] == "--log"]
    path = paths[-1] if paths else ""
    return path if path and not path.startswith("-") and can_be_a_path(path) else None


@contextmanager
def logged(path: str | None, begin: str) -> Iterator[None]:
    """Append what the block writes to stderr to a file, after a line that names the command.

    Raises: InputError: a pipe. OSError: the file cannot be written.
    """
    if path is None:
        yield
        return
    terminal = sys.stderr
    # open a log to append to; a pipe, which could block for ever, is refused
    if Path(path).is_fifo():
        raise InputError(f"--log {path}: expected a file, this is a pipe")
    number = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | NO_WAITING | OWN_FILE_FLAGS, 0o666)
    with open(number, "a", encoding="utf-8", errors="backslashreplace") as file:
        tee = _Tee(terminal, file)
        one_line = plain(begin).replace("\n", "\\n")
        file.write(f"{_now()} {one_line}\n")
        sys.stderr = tee
        try:
            yield
        finally:
            sys.stderr = terminal
            tee.flush()


def _now() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")
