"""A folder of files that appears whole or not at all: a JSON manifest and named tensor files.

Knows nothing of what is in them; `drsplat.field` does.
"""

import ctypes
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.contents import open_file
from ..errors import InputError
from .json_files import as_object, document_in, write_json
from .replacing import (
    at_once,
    claimed_output,
    lock,
    refuse_missing_parent,
    saying_what_is_full,
    sweep,
    sync_folder,
    temporary_beside,
)
from .tensors import sealed, write_tensors

MANIFEST = "field.json"
_MAX_MANIFEST_BYTES = 1 << 20
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


class TensorFile(NamedTuple):
    tensors: Mapping[str, np.ndarray]
    metadata: Mapping[str, str]

    def equals(self, other: "TensorFile") -> bool:
        """Return True if both hold the same arrays, of the same types, under the same names."""
        return (self.metadata, self.tensors.keys()) == (other.metadata, other.tensors.keys()) and all(
            array.dtype == other.tensors[name].dtype and np.array_equal(array, other.tensors[name])
            for name, array in self.tensors.items()
        )


def write_folder(
    path: Path, manifest: Mapping[str, object], files: Mapping[str, TensorFile], overwrite: bool = False
) -> None:
    """Write all files beside `path`, then give the folder its name.

    A killed process leaves the old folder or the new one, never a mixture; what else it leaves, in a
    hidden `.tmp` folder, the next one removes. Where the file system cannot exchange two folders
    in one step, a kill between two renames leaves the old folder under such a hidden name.

    Raises: InputError: `path` exists and `overwrite` is false or it is not such a folder, or it has
    no folder to be in; the disk is full.
    """
    with replacing_folder(path, overwrite, MANIFEST) as temporary:
        for name, file in files.items():
            write_tensors(temporary / name, file.tensors, file.metadata)
        write_json(temporary / MANIFEST, sealed(manifest), indent=2)


@contextmanager
def replacing_folder(path: Path, overwrite: bool, mark: str) -> Iterator[Path]:
    """Make a new folder beside `path` that takes its name when the block ends well, or else vanishes.

    mark: the file that a folder has to hold to be ours to replace. Killed: as `write_folder`.

    Raises: InputError: as `write_folder`.
    """
    if path.exists() or path.is_symlink():
        if not overwrite:
            raise InputError(f"{path} exists already: pass overwrite=True to replace it")
        refuse_to_replace_others(path, mark)
    refuse_missing_parent(path)
    sweep(path.parent)
    with at_once(), saying_what_is_full(path), _new_folder(path) as temporary:
        yield temporary
        _take_place(temporary, path)
        sync_folder(path.parent)


@contextmanager
def _new_folder(path: Path) -> Iterator[Path]:
    """Make a hidden folder beside `path`, locked; it is gone when the block ends, if it has the name still."""
    temporary, descriptor = _locked_folder(path)
    try:
        yield temporary
    finally:
        os.close(descriptor)
        shutil.rmtree(temporary, ignore_errors=True)


def _locked_folder(path: Path) -> tuple[Path, int]:
    """Return a hidden folder and its open descriptor. Between its making and its lock it may be swept: then another."""
    while True:
        temporary = temporary_beside(path, f"{path.name}.")
        temporary.mkdir()
        with suppress(FileNotFoundError):
            descriptor = os.open(temporary, os.O_RDONLY)
            lock(descriptor)
            if temporary.exists():
                return temporary, descriptor
            os.close(descriptor)


@contextmanager
def claimed_field(path: Path) -> Iterator[Path]:
    """Claim a folder that a field is to be written to, before the work: no other process has it meanwhile.

    Raises: InputError: something else is there; as `claimed_output`.
    """
    refuse_to_replace_others(path)
    with claimed_output(path):
        yield path


def refuse_to_replace_others(path: Path, mark: str = MANIFEST) -> None:
    """Check `path`. Raises: InputError: something is there that is not such a folder."""
    if (path.exists() or path.is_symlink()) and not (path / mark).is_file():
        raise InputError(f"{path} exists and has no {mark}: it is not ours to replace")


def read_manifest(
    path: Path, name: str = MANIFEST, what: str = "field", most: int = _MAX_MANIFEST_BYTES
) -> dict[str, object]:
    """Read the JSON object of a folder. name: of its file, of at most so many bytes; what: is in the folder.

    Raises: InputError: there is no such folder, or its manifest is no file. FormatError: not a JSON object.
    """
    try:
        with open_file(path / name) as file:
            content = file.read(most)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: there is no such {what} (no {name} in it)") from None
    return as_object(document_in(content, str(path / name)), str(path / name))


def _take_place(temporary: Path, path: Path) -> None:
    """Rename `temporary` to `path`; what was there gets the temporary name or is gone."""
    if not path.exists():
        os.rename(temporary, path)
    elif not _exchange(temporary, path):
        aside = temporary.with_suffix(".old.tmp")
        os.rename(path, aside)
        os.rename(temporary, path)
        shutil.rmtree(aside, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change names in one step, where the system can."""
    if not sys.platform.startswith("linux"):
        return False
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    if rename is None:
        return False
    names = os.fsencode(one), os.fsencode(other)
    return bool(rename(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE) == 0)
