"""Tasks for COLMAP, each in a process of its own; see `worker.py`."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ...errors import DrSplatError, FormatError, InputError, MissingExtraError, pip_install

MAX_LOG_BYTES = 1 << 20
MIN_FREE_BYTES = 1 << 20  # a disk with less is full
_FULL = ("disk is full", "No space left", "disk I/O error")
_DAMAGED = ("malformed", "not a database", "No registered database factory")

Report = Callable[[int], None]


class ColmapFailure(DrSplatError):
    """Failure of a COLMAP task; the message is COLMAP's."""


def require_colmap() -> None:
    """Check for COLMAP's package. Raises: MissingExtraError: it is not installed."""
    if find_spec("pycolmap") is None:
        raise MissingExtraError(f"finding poses needs COLMAP's package pycolmap: {pip_install('capture')}")


def ask_colmap(task: str, log: Path, report: Report | None = None, **request: Any) -> Any:
    """Run a task of `worker.py` and return its answer. log: file for COLMAP's output.

    Raises: InputError: the disk is full. FormatError: the database is damaged. ColmapFailure: anything else.
    """
    command = [sys.executable, "-P", "-m", f"{__package__}.worker"]
    pipe, message = subprocess.PIPE, {}
    with (
        log.open("ab") as errors,
        subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=errors, text=True, encoding="utf-8", start_new_session=True
        ) as process,
    ):
        start = errors.tell()
        assert process.stdin
        assert process.stdout
        try:
            with process.stdin as line:
                line.write(json.dumps({"task": task, "parent": os.getpid(), **request}))
            for answer in process.stdout:
                message = json.loads(answer)
                if "done" not in message:
                    break
                if report is not None:
                    report(message["done"])
        except BrokenPipeError:
            pass
        finally:
            process.kill()
    if "answer" in message:
        return message["answer"]
    raise _failure(task, message.get("error") or _last_words(log, start), log)


def _failure(task: str, message: str, log: Path) -> DrSplatError:
    if any(words in message for words in _FULL) or shutil.disk_usage(log.parent).free < MIN_FREE_BYTES:
        return InputError(
            f"{log.parent}: there is no room left while COLMAP worked there: free some space and give the same "
            "command again, what is done is kept"
        )
    if any(words in message for words in _DAMAGED):
        return FormatError(f"COLMAP's database in {log.parent} is damaged: remove that folder, and start anew")
    return ColmapFailure(f"COLMAP could not {task.replace('_', ' ')}: {message.strip() or 'it ended without a word'}")


def _last_words(log: Path, start: int) -> str:
    """Return COLMAP's last message before it ended: the exception that it did not catch, else its last line."""
    with log.open("rb") as file:
        file.seek(start)
        lines = file.read(MAX_LOG_BYTES).decode("utf-8", "replace").strip().splitlines()
    errors = [line.partition("what():")[2] for line in lines if "what():" in line]
    return (errors or lines[-1:] or [""])[0].strip()
