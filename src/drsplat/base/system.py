"""Differences between operating systems; no other module asks which one it runs on.

Linux and macOS have all of it. On Windows, files have other locks and cannot be renamed while they are open.
"""

import getpass
import os
import sys
import threading
import time
from pathlib import Path

try:
    import fcntl
    import resource
except ImportError:  # Windows
    fcntl = resource = None  # type: ignore[assignment]

WINDOWS = sys.platform == "win32"
RENAMES_OPEN_FILES = not WINDOWS
NO_WAITING = getattr(os, "O_NONBLOCK", 0)
NO_LINKS = NO_WAITING | getattr(os, "O_NOFOLLOW", 0)
"""Flags to open what a stranger may have put there: no pipe is waited for, and no link is followed."""
OWN_FILE_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
PARENT_POLL_S = 0.5  # interval at which a process checks whether its parent has ended
_LOCKED_BYTE = 1 << 30  # offset: Windows forbids reading a locked byte, so it lies far beyond any content


def can_be_a_path(text: str) -> bool:
    """Return whether the file system has bytes for every letter of a text."""
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        return False
    return True


def can_sweep() -> bool:
    """Return whether a lock tells files in use from those that a killed process left."""
    return fcntl is not None


def lock(descriptor: int) -> None:
    """Wait for the lock of an open file. Raises: OSError: the file system has none."""
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX)


def try_lock(descriptor: int) -> bool:
    """Take the lock of an open file until it is closed; return False if another process has it.

    Raises: OSError: the file system has no locks.
    """
    if fcntl is None:
        return _try_windows_lock(descriptor)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _try_windows_lock(descriptor: int) -> bool:
    import msvcrt

    at = os.lseek(descriptor, 0, os.SEEK_CUR)
    os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    except PermissionError:
        return False
    finally:
        os.lseek(descriptor, at, os.SEEK_SET)
    return True


def sync_folder(folder: str | os.PathLike[str]) -> None:
    """Bring the names in a folder to the disk, where the system can. Raises: OSError: this drive cannot."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def owner() -> str:
    """Return the user of this process as part of a file's name: the user id, else the name."""
    return str(os.getuid()) if hasattr(os, "getuid") else getpass.getuser()


def is_ours(found: os.stat_result) -> bool:
    return not hasattr(os, "getuid") or found.st_uid == os.getuid()


def end_with(parent: int) -> None:
    """End this process, whatever it is doing, as soon as its parent process has ended in any way.

    parent: the parent's process id, passed by the parent itself: a killed parent is no longer its children's parent.
    """
    threading.Thread(target=_end_after, args=(parent,), name="end with parent", daemon=True).start()


def _end_after(parent: int) -> None:
    if WINDOWS:
        _wait_for_windows_process(parent)
    else:
        while os.getppid() == parent:
            time.sleep(PARENT_POLL_S)
    os._exit(1)


def _wait_for_windows_process(number: int) -> None:
    import ctypes

    synchronize, for_ever = 0x00100000, 0xFFFFFFFF
    kernel = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined,unused-ignore]
    kernel.OpenProcess.restype = ctypes.c_void_p
    handle = kernel.OpenProcess(synchronize, False, number)
    if handle:
        kernel.WaitForSingleObject(ctypes.c_void_p(handle), for_ever)


def folder_bytes(folder: Path) -> int:
    """Return the size of all files in a folder and below it."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def peak_memory_bytes() -> int:
    """Return the largest resident size of this process so far."""
    if resource is None:
        return _windows_peak_bytes()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _windows_peak_bytes() -> int:
    import ctypes

    class Counters(ctypes.Structure):  # PROCESS_MEMORY_COUNTERS
        _fields_ = (
            ("cb", ctypes.c_uint32), ("PageFaultCount", ctypes.c_uint32), ("PeakWorkingSetSize", ctypes.c_size_t),
            ("rest", ctypes.c_size_t * 7),
        )  # fmt: skip

    counters = Counters(ctypes.sizeof(Counters))
    kernel = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined,unused-ignore]
    kernel.GetCurrentProcess.restype = ctypes.c_void_p
    kernel.K32GetProcessMemoryInfo.argtypes = (ctypes.c_void_p, ctypes.POINTER(Counters), ctypes.c_uint32)
    kernel.K32GetProcessMemoryInfo(kernel.GetCurrentProcess(), ctypes.byref(counters), counters.cb)
    return int(counters.PeakWorkingSetSize)


def allow_open_files(wanted: int) -> int:
    """Ask to open `wanted` files at once, and return how many this process may open."""
    if resource is None:
        return 512  # what Windows gives a process by itself
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = wanted if hard == resource.RLIM_INFINITY else min(hard, wanted)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    return int(allowed)
