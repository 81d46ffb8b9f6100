"""Files that appear whole or not at all, and stay when the power fails.

Everything is written beside its place under a hidden name that ends in `.tmp`, brought to the disk, and renamed.
Whoever writes holds a lock on it, so that what killed processes left is known and swept by the next one.

One writer for an output at a time.
"""

import errno
import io
import json
import os
import re
import shutil
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import BinaryIO

from ..base import system
from ..base.contents import AnyPath
from ..errors import InputError

_WAITING: ContextVar[list[tuple[Path, Path, int | None]] | None] = ContextVar("waiting", default=None)
_BRIEF: ContextVar[bool] = ContextVar("brief", default=False)
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_OURS = re.compile(r"\.(.+\.)?[0-9a-f]{16}\.tmp", re.DOTALL)


class NoRoom(InputError):
    """The disk is full, or a limit on files is reached. reason: the system's words."""

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class _Writer(io.BufferedWriter):
    """A file that all libraries write through Python, whose errors say what happened; theirs do not."""

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")


@contextmanager
def replacing(path: AnyPath, overwrite: bool = False) -> Iterator[BinaryIO]:
    """Open a new file beside `path` that takes its name when the block ends well, or else vanishes.

    Raises: InputError: `path` exists and `overwrite` is false, is a folder, or has no folder to be
    in; the disk is full.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder: give the name of a file in it")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists already: pass overwrite=True to replace it")
    refuse_missing_parent(path)
    sweep(path.parent)
    with saying_what_is_full(path):
        temporary, raw = _new_file(path)
        try:
            with _Writer(raw) as file:
                yield file
                file.flush()
                if not _BRIEF.get():
                    os.fsync(raw.fileno())
                waiting = _WAITING.get()
                if waiting is not None:
                    waiting.append((temporary, path, os.dup(raw.fileno()) if system.RENAMES_OPEN_FILES else None))
                    return
                if not system.RENAMES_OPEN_FILES:
                    file.close()
                os.replace(temporary, path)  # while it is locked
            if not _BRIEF.get():
                sync_folder(path.parent)
        finally:
            if all(temporary != held for held, _, _ in _WAITING.get() or ()):
                temporary.unlink(missing_ok=True)


def take_over(made: Path, path: Path, overwrite: bool) -> None:
    """Write a file with what another library has made of it elsewhere. Raises: as `replacing`."""
    with replacing(path, overwrite) as file, made.open("rb") as source:
        shutil.copyfileobj(source, file, 1 << 20)


@contextmanager
def together() -> Iterator[None]:
    """Let files that are written in the block take their names at its end, one right after the other.

    A process that is killed leaves none of them, so that the same command can be given again; if the block fails,
    none appears.
    """
    waiting: list[tuple[Path, Path, int | None]] = []
    token = _WAITING.set(waiting)
    try:
        yield
        for temporary, path, _ in waiting:
            os.replace(temporary, path)
        for folder in {path.parent for _, path, _ in waiting}:
            sync_folder(folder)
    finally:
        _WAITING.reset(token)
        for temporary, _, descriptor in waiting:
            temporary.unlink(missing_ok=True)
            if descriptor is not None:
                os.close(descriptor)


@contextmanager
def at_once() -> Iterator[None]:
    """Let files of the block take their names as they are written: of a folder that waits as a whole."""
    token = _WAITING.set(None)
    try:
        yield
    finally:
        _WAITING.reset(token)


@contextmanager
def brief() -> Iterator[None]:
    """Write the block's files without waiting for the disk: of a folder that is gone when the process is."""
    token = _BRIEF.set(True)
    try:
        yield
    finally:
        _BRIEF.reset(token)


def refuse_missing_parent(path: Path) -> None:
    """Check the folder of `path`. Raises: InputError: there is none."""
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent} to write {path.name} into: make it first")


@contextmanager
def saying_what_is_full(path: Path) -> Iterator[None]:
    """Turn errors of a full or protected disk into ours.

    Raises: NoRoom: the block ran out of disk while it wrote `path`, or something for it. InputError: it may
    not write there.
    """
    try:
        yield
    except OSError as error:
        if error.errno in (errno.EROFS, errno.EACCES):
            reason = os.strerror(error.errno)
            raise InputError(f"{path}: cannot be written ({reason}): name another place") from error
        if error.errno not in _NO_ROOM:
            raise
        raise NoRoom(_no_room_text(path, os.strerror(error.errno)), os.strerror(error.errno)) from error
    except NoRoom as error:
        raise NoRoom(_no_room_text(path, error.reason), error.reason) from error


def _no_room_text(path: Path, reason: str) -> str:
    return (
        f"{path}: there is no room left to write it ({reason}), so it was left as it was: free some space and try again"
    )


def temporary_beside(path: Path, name: str = "") -> Path:
    """Return a hidden name that is free, and swept if what gets it is left there."""
    return path.with_name(f".{name}{os.urandom(8).hex()}.tmp")


def lock(descriptor: int) -> None:
    """Lock an open file against sweeping until it is closed, where the file system has locks."""
    with suppress(OSError):
        system.lock(descriptor)


@cache
def sweep(folder: Path) -> None:
    """Remove what killed processes left in a folder; once in the life of this process."""
    if system.can_sweep():
        for entry in os.scandir(folder):
            if _OURS.fullmatch(entry.name):
                with suppress(OSError):  # in use, not ours to remove, or gone
                    _remove_unlocked(Path(entry.path))


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can."""
    with suppress(OSError):  # some network drives refuse
        system.sync_folder(folder)


def _remove_unlocked(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | system.NO_LINKS)
    try:
        if not system.try_lock(descriptor):
            return
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
    finally:
        os.close(descriptor)


def _new_file(path: Path) -> tuple[Path, io.FileIO]:
    """Make a hidden, locked file beside `path`; one that is swept before it is locked is made again."""
    while True:
        temporary = temporary_beside(path)
        raw = io.FileIO(temporary, "xb")
        lock(raw.fileno())
        if temporary.exists():
            return temporary, raw
        raw.close()


LOCK = ".lock"
POLL_S = 0.05
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)  # of a file system that has none
_NO_FILE = (errno.ELOOP, errno.EISDIR, errno.ENXIO)  # a link, a folder, a socket


class ClaimedError(InputError):
    """Error for an output that another process writes."""


@contextmanager
def claimed_folder(folder: AnyPath) -> Iterator[None]:
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
def claimed_output(output: AnyPath, patience: float = 0.0) -> Iterator[None]:
    """Claim an output that appears as a whole and may not exist yet; the lock is beside it, see `claimed_folder`.

    patience: seconds to wait for another process or thread that has it.

    Raises: ClaimedError: another process has it. InputError: there is no folder for it to be in, or what has the lock's
    name is no file.
    """
    path = Path(os.path.realpath(output))
    refuse_missing_parent(path)
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
