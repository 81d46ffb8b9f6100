"""Files that appear whole or not at all."""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: str | os.PathLike[str], overwrite: bool = False) -> Iterator[BinaryIO]:
    """A new file beside `path` that takes its name when the block ends well, or else vanishes.

    Raises: InputError: `path` exists and `overwrite` is false, is a folder, or has no folder to be
    in; the disk is full.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder: give the name of a file in it")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists already: pass overwrite=True to replace it")
    if not path.parent.is_dir():
        raise InputError(
            f"there is no folder {path.parent} to write {path.name} into: make it first"
        )
    temporary = path.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with open(temporary, "xb") as file:
            yield file
        os.replace(temporary, path)
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        raise InputError(
            f"{path}: there is no room left to write it ({os.strerror(error.errno)}), so it was "
            "left as it was: free some space and try again"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
