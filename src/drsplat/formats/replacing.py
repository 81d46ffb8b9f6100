"""Files that appear whole or not at all, and stay when the power fails.

Everything is written beside its place under a hidden name that ends in `.tmp`, brought to the disk, and renamed.
Whoever writes holds a lock on it, so that what killed processes left is known and swept by the next one.
"""

import errno
import io
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import BinaryIO

from ..base import system
from ..errors import InputError

_WAITING: ContextVar[list[tuple[Path, Path, int | None]] | None] = ContextVar("waiting", default=None)
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
def replacing(path: str | os.PathLike[str], overwrite: bool = False) -> Iterator[BinaryIO]:
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
                os.fsync(raw.fileno())
                waiting = _WAITING.get()
                if waiting is not None:
                    waiting.append((temporary, path, os.dup(raw.fileno()) if system.RENAMES_OPEN_FILES else None))
                    return
                if not system.RENAMES_OPEN_FILES:
                    file.close()
                os.replace(temporary, path)  # while it is locked
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
