"""One writer for an output at a time."""

import errno
import json
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..base import system
from ..errors import InputError
from .replacing import sweep

LOCK = ".lock"
POLL_S = 0.05
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)  # of a file system that has none
_NO_FILE = (errno.ELOOP, errno.EISDIR, errno.ENXIO)  # a link, a folder, a socket


class ClaimedError(InputError):
    """Error for an output that another process writes."""


@contextmanager
def claimed_folder(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Make a folder, and while the block runs let no other process claim it; the lock is in it.

    The kernel holds the lock, on a file that says who has it. When a process is killed the lock is gone with it:
    a file that it leaves behind holds nobody up, and the next run removes it.

    Raises: ClaimedError: another process has it. InputError: it is a file, or what has the lock's name is none.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: give the name of a folder")
    folder.mkdir(parents=True, exist_ok=True)
    with _held(folder / LOCK, folder):
        yield


@contextmanager
def claimed_output(output: str | os.PathLike[str], patience: float = 0.0) -> Iterator[None]:
    """Claim an output that appears as a whole and may not exist yet; the lock is beside it, see `claimed_folder`.

    patience: seconds to wait for another process or thread that has it.

    Raises: ClaimedError: another process has it. InputError: there is no folder for it to be in, or what has the lock's
    name is no file.
    """
    path = Path(os.path.realpath(output))
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} to write {path.name} into: make it first")
    with _held(path.with_name(f".{path.name}{LOCK}"), path, patience):
        yield


@contextmanager
def _held(lock: Path, output: Path, patience: float = 0.0) -> Iterator[None]:
    file = _locked(lock, output, time.monotonic() + patience)
    try:
        sweep(lock.parent)  # also where nothing is left to be written
        yield
    finally:
        if not system.RENAMES_OPEN_FILES:
            file.close()
        with suppress(FileNotFoundError, PermissionError):  # the latter: on Windows, where another has opened it since
            lock.unlink()  # before it is let go: who waits for this file then finds that it has no name
        file.close()


def _locked(lock: Path, output: Path, until: float) -> BinaryIO:
    """Return the lock's file, held. until: time of the monotonic clock at which waiting for another process ends."""
    while True:
        file = _opened(lock)
        if not _ours_now(file):
            with file:
                if time.monotonic() < until:
                    time.sleep(POLL_S)
                    continue
                raise ClaimedError(
                    f"{output} is being written by {_holder(file)}: wait until it has ended, or name another output"
                )
        if _is_named(file, lock):
            _sign(file)
            return file
        file.close()


def _ours_now(file: BinaryIO) -> bool:
    """Return False where another process holds the file; where there are no locks, none does."""
    try:
        return system.try_lock(file.fileno())
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return True


def _opened(lock: Path) -> BinaryIO:
    """Open the lock's file, made if there is none; links are not followed, so that none leads to be overwritten.

    Raises: InputError: it is no plain file.
    """
    flags = os.O_RDWR | os.O_CREAT | system.NO_LINKS | system.OWN_FILE_FLAGS
    try:
        number = os.open(lock, flags, 0o666)
    except OSError as error:
        if error.errno in _NO_FILE:
            raise _not_ours(lock) from None
        raise
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise _not_ours(lock)
    return os.fdopen(number, "r+b")


def _not_ours(lock: Path) -> InputError:
    return InputError(f"{lock} is a link, a folder or a pipe, which drsplat does not make: remove it")


def _is_named(file: BinaryIO, lock: Path) -> bool:
    """Return False where the process that held the file before has unlinked it meanwhile."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.stat(lock))
    except FileNotFoundError:
        return False


def _sign(file: BinaryIO) -> None:
    from socket import gethostname

    file.truncate(0)
    with suppress(OSError):  # of a full disk, on which the lock holds all the same
        os.write(file.fileno(), json.dumps({"pid": os.getpid(), "host": gethostname()}).encode())


def _holder(file: BinaryIO) -> str:
    file.seek(0)
    try:
        who = json.loads(file.read(1000))
        return f"process {int(who['pid'])} on {str(who['host'])[:100]!a}"
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return "another process"
