"""Runs that keep finished parts beside their output until it is there.

Killed when the output had appeared and its parts were not gone, they leave both: the same command then ends the work.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .options import exists_already, new_output

COMPLETE = " (it was complete already; only its parts were still to be removed)"


def parts_of(output: str | Path) -> Path:
    """Return the folder of an output's parts."""
    return Path(f"{output}.parts")


def new_or_complete(path: str, overwrite: bool, suffix: str = "") -> Path:
    """Check an output as `new_output` does, but accept one with parts beside it, which a killed run left."""
    return new_output(path, overwrite or parts_of(path).is_dir(), suffix)


def was_complete(output: Path, overwrite: bool, is_this: Callable[[], bool]) -> bool:
    """Return True if the output is there already and is what would be written.

    Raises: InputError: another one is there.
    """
    if overwrite or not output.exists():
        return False
    if not is_this():
        raise exists_already(output)
    return True
