"""The processes that a service starts."""

from pathlib import Path

WORKER = b"drsplat.fronts.serving.worker"


def children_of(pid: int, command: bytes = WORKER) -> list[int]:
    """Those whose command line has `command` in it, of all threads of a process."""
    lists = (tasks.read_text().split() for tasks in Path(f"/proc/{pid}/task").glob("*/children"))
    children = sorted(int(child) for listed in lists for child in listed)
    return [child for child in children if command in Path(f"/proc/{child}/cmdline").read_bytes()]
