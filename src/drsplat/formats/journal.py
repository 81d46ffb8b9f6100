"""Changes to a JSON document, a line each, so that a long document is not written anew after each of them.

The first line names the document that it continues by its checksum: a journal beside another document is one that
had been taken into it, and is not read. Each line carries its own checksum. A last line without its end was being
written when the process was killed, and does not count.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..base.contents import open_file
from ..errors import FormatError
from .checksums import check_seal, sealed
from .json_files import document_in
from .replacing import saying_what_is_full, sync_folder

CONTINUES = "continues"


class Journal:
    """A new journal of a document; it replaces another. A line is on disk when `add` returns.

    document: the checksum of what the lines continue.
    """

    def __init__(self, path: Path, document: str) -> None:
        self.path = path
        path.unlink(missing_ok=True)
        with saying_what_is_full(path):
            self._file: BinaryIO = path.open("xb", buffering=0)
        self.add({CONTINUES: document})
        sync_folder(path.parent)

    def add(self, change: dict[str, object]) -> None:
        """Append a change and sync it to disk. Raises: NoRoom: the disk is full."""
        with saying_what_is_full(self.path):
            line = json.dumps(sealed(change)).encode() + b"\n"
            while line:
                line = line[self._file.write(line) :]
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Leave the file as it is; it is removed when all that it holds stands in the document."""
        self._file.close()


def changes_to(path: Path, document: str, cure: str) -> Iterator[dict[str, object]]:
    """Yield the changes that the journal at `path` holds of a document with this checksum, in their order.

    cure: what to do about damage, a sentence.

    Raises: FormatError: a line that is not what was written. InputError: a folder or a pipe is in its place.
    """
    try:
        with open_file(path) as file:
            *lines, _ = file.read().split(b"\n")
    except FileNotFoundError:
        return
    for number, line in enumerate(lines):
        where = f"{path}: line {number + 1}"
        change = document_in(line, where)
        if not isinstance(change, dict) or json.dumps(change).encode() != line:
            raise FormatError(f"{where}: damaged or edited: expected an object as it was written. {cure}")
        check_seal(change, where, cure=cure)
        if number > 0:
            yield change
        elif change.get(CONTINUES) != document:
            return
