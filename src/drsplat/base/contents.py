"""The bytes of files from strangers: only of regular files, read where they are few, mapped where they are many.

A pipe would block its reader for ever. A mapped file that is cut short where it lies kills whoever reads on, so only
what is too large to be copied is mapped.
"""

import math
import mmap
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from io import BufferedReader
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..errors import FormatError, InputError, MissingFileError
from .arrays import UInt8
from .system import NO_WAITING, OWN_FILE_FLAGS

AnyPath: TypeAlias = str | PathLike[str]
"""A path, as text or as an object of `pathlib`."""
Document: TypeAlias = dict[str, Any]
"""A JSON object."""
PAGE_SUFFIXES = (".html", ".htm", ".svg", ".xml")
_PAGE = re.compile(  # also the short answers of servers of files
    rb"(\xef\xbb\xbf)?\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)?"
    rb"(<(!doctype\s+html|html|head|error)[\s>]|(404: |entry )?not found\b)",
    re.IGNORECASE | re.DOTALL,
)
_PAGE_BYTES = 512
_LFS_START = b"version https://git-lfs.github.com/spec/"
MAX_READ_BYTES = 64 << 20  # read in some hundredths of a second; larger files are mapped
_CACHE_LINE_BYTES = 64
_PIECE_BYTES = 1 << 20  # of a mapped file that are in memory at once, and written: more may take nine times as long


def open_file(path: str | os.PathLike[str]) -> BufferedReader:
    """Open a regular file for reading; never wait for a pipe's writer.

    Raises: MissingFileError. InputError: a folder, pipe, socket or device. FormatError: what lies there in place of a
    file, a pointer of Git LFS or a web page. OSError: as `open`.
    """
    try:
        number = os.open(path, os.O_RDONLY | NO_WAITING | OWN_FILE_FLAGS)
    except (FileNotFoundError, NotADirectoryError):
        raise MissingFileError(f"{path}: there is no such file") from None
    except ValueError:  # no system call was made
        raise InputError(f"{os.fspath(path)!r}: no name that a file can have: expected UTF-8 without a null") from None
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise InputError(f"{path}: expected a file, this is a folder, a pipe or a device")
    file = open(number, "rb")  # noqa: SIM115  (the caller closes it)
    try:  # what downloads leave under the name of a file
        start = file.raw.read(_PAGE_BYTES)  # not into the buffer, which would keep them
        file.raw.seek(0, os.SEEK_SET)
        if start.startswith(_LFS_START):
            raise FormatError(
                f"{path}: a pointer of {os.fstat(number).st_size} bytes, which Git LFS keeps in place of the file: "
                "fetch the file itself with `git lfs pull`"
            )
        if _PAGE.match(start) and not os.fspath(path).lower().endswith(PAGE_SUFFIXES):
            raise FormatError(
                f"{path}: a web page or a message (HTML), which a server sent in place of the file: download the file "
                "itself, by its link to the raw file, logged in where that is asked for"
            )
    except BaseException:
        file.close()
        raise
    return file


def file_text(path: str | os.PathLike[str]) -> str:
    """Read a text file in UTF-8, or in what its byte order mark says. Raises: UnicodeDecodeError; as `open_file`."""
    with open_file(path) as file:
        encoding = encoding_of(file)
        return file.read().decode(encoding)


def encoding_of(file: BufferedReader) -> str:
    """Return the encoding of a text file by its byte order mark, which programs for Windows write; else UTF-8."""
    file.seek(0)
    start = file.peek(2)[:2]
    return "utf-16" if start in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"


def file_bytes(path: Path) -> UInt8[np.ndarray, " n"]:
    """Return all bytes of a file, read-only, beginning at a cache line; map the file if it is large.

    Raises: InputError: there is no such file, or it is none. FormatError: it becomes shorter while it is read.
    """
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > MAX_READ_BYTES:
            return np.memmap(file, np.uint8, "r")
        room = np.empty(size + _CACHE_LINE_BYTES, np.uint8)
        start = -room.ctypes.data % _CACHE_LINE_BYTES
        content = room[start : start + size]
        if file.readinto(content.data) != size:
            raise FormatError(f"{path}: the file became shorter while it was read: try again")
    content.setflags(write=False)
    return content


def scratch(shape: tuple[int, ...], dtype: type[np.generic]) -> np.ndarray:
    """Return an array to fill, which a temporary file holds where it is large, so that the system may write it out.

    The file has no name and is gone with the array.

    Raises: OSError: there is no room for it.
    """
    if math.prod(shape) * np.dtype(dtype).itemsize <= MAX_READ_BYTES:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile(prefix="drsplat-") as file:
        return np.memmap(file, dtype, "w+", shape=shape)


def release(*arrays: np.ndarray) -> None:
    """Give back the memory of those arrays that are maps of files: what is used again is read again."""
    for array in arrays:
        while isinstance(array.base, np.ndarray):
            array = array.base
        shared = isinstance(array, np.memmap) and array.mode != "c"
        if shared and isinstance(array.base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            array.base.madvise(mmap.MADV_DONTNEED)


def pieces(array: np.ndarray) -> Iterator[memoryview]:
    """Yield the bytes of an array in C order, in pieces; a mapped file is never in memory as a whole."""
    raw = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    for begin in range(0, raw.size, _PIECE_BYTES):
        yield raw[begin : begin + _PIECE_BYTES].data
        release(array)
