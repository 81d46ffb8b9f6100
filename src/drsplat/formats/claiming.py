"""One writer for an output at a time."""

import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError

LOCK = ".lock"
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)  # of a file system that has none


@contextmanager
def claimed_folder(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Make a folder, and while the block runs let no other process claim it; the lock is in it.

    The kernel holds the lock, on a file that says who has it. When a process is killed the lock is gone with it:
    a file that it leaves behind holds nobody up, and the next run removes it.

    Raises: InputError: another process has it, or it is a file.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: give the name of a folder")
    folder.mkdir(parents=True, exist_ok=True)
    with _held(folder / LOCK, folder):
        yield


@contextmanager
def claimed_output(output: str | os.PathLike[str]) -> Iterator[None]:
    """As `claimed_folder`, of what appears as a whole and may be no more than a name yet; the lock is beside it.

    Raises: InputError: another process has it, or there is no folder for it to be in.
    """
    path = Path(os.path.realpath(output))
    if not path.parent.is_dir():
        raise InputError(
            f"there is no folder {path.parent} to write {path.name} into: make it first"
        )
    with _held(path.with_name(f".{path.name}{LOCK}"), path):
        yield


@contextmanager
def _held(lock: Path, output: Path) -> Iterator[None]:
    file = _locked(lock, output)
    try:
        yield
    finally:
        with suppress(FileNotFoundError):
            lock.unlink()  # before it is let go: who waits for this file then finds that it has no name
        file.close()


def _locked(lock: Path, output: Path) -> BinaryIO:
    """The file that has the lock's name, held."""
    while True:
        file = open(lock, "a+b")  # noqa: SIM115  # its owner closes it
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            with file:
                raise InputError(
                    f"{output} is being written by {_holder(file)}: wait until it has ended, or name another output"
                ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        if _is_named(file, lock):
            _sign(file)
            return file
        file.close()


def _is_named(file: BinaryIO, lock: Path) -> bool:
    """False where the one before has unlinked it meanwhile."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.stat(lock))
    except FileNotFoundError:
        return False


def _sign(file: BinaryIO) -> None:
    file.truncate(0)
    file.write(json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode())
    file.flush()


def _holder(file: BinaryIO) -> str:
    file.seek(0)
    try:
        who = json.loads(file.read(1000))
        return f"process {int(who['pid'])} on {str(who['host'])[:100]!a}"
    except (ValueError, TypeError, KeyError):
        return "another process"
