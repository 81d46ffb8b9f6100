"""Stores of finished work for all workers: a folder that all of them see, or the address of an object store."""

import hashlib
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...base.system import is_ours, owner
from ...errors import InputError, MissingExtraError, pip_install
from ...formats.replacing import replacing
from ...formats.tensors import write_tensors
from ..evidence.columns import is_finished


@dataclass(frozen=True)
class Shared:
    """Files by name in a folder that every worker sees."""

    folder: Path

    def bring(self, name: str) -> Path:
        """Return the local path of a file, fetching it first if it is in the store."""
        return self.folder / name

    def has(self, name: str) -> bool:
        """Return whether all workers can have a file."""
        return (self.folder / name).exists()

    def send(self, name: str) -> None:
        """Make a file of `folder` available to all workers."""


@dataclass(frozen=True)
class Remote:
    """An address that fsspec knows (s3://, gs://, ...); what is in use is copied to this machine.

    Raises, when it is used: MissingExtraError: fsspec, or what it needs for the address, is not installed.
    InputError: an address that it does not know.
    """

    url: str

    @cached_property
    def folder(self) -> Path:
        name = hashlib.blake2b(self.url.encode(), digest_size=8).hexdigest()
        place = Path(tempfile.gettempdir()) / f"drsplat-store-{owner()}-{name}"
        place.mkdir(mode=0o700, exist_ok=True)
        if not is_ours(place.stat()):
            raise InputError(f"{place} belongs to somebody else: remove it, or set TMPDIR")
        return place

    def __getstate__(self) -> dict[str, str]:
        """Return what workers need, each with folder and connection of its own."""
        return {"url": self.url}

    def bring(self, name: str) -> Path:
        files, root = self._files
        there, here = f"{root}/{name}", self.folder / name
        mark = here.with_name(f"{here.name}.version")
        try:
            version = str(files.ukey(there))
        except FileNotFoundError:
            return here
        if not (here.exists() and mark.exists() and mark.read_text() == version):
            here.parent.mkdir(parents=True, exist_ok=True)
            with files.open(there, "rb") as source, replacing(here, overwrite=True) as out:
                while block := source.read(1 << 22):
                    out.write(block)
            mark.write_text(version)
        return here

    def has(self, name: str) -> bool:
        files, root = self._files
        return bool(files.exists(f"{root}/{name}"))

    def send(self, name: str) -> None:
        files, root = self._files
        there = f"{root}/{name}"
        files.makedirs(there.rpartition("/")[0], exist_ok=True)
        files.put_file(str(self.folder / name), f"{there}.{os.getpid()}.tmp")
        files.mv(f"{there}.{os.getpid()}.tmp", there)  # whole or not at all
        (self.folder / f"{name}.version").write_text(str(files.ukey(there)))

    @cached_property
    def _files(self) -> tuple[Any, str]:
        try:
            import fsspec
        except ImportError:
            raise MissingExtraError(f"{self.url} needs fsspec: {pip_install('ray')}") from None
        try:
            files, root = fsspec.core.url_to_fs(self.url, use_listings_cache=False)
        except (ValueError, ImportError) as error:
            raise InputError(f"{self.url}: {error}") from None
        return files, str(root).rstrip("/")


Store = Shared | Remote


def store_of(place: str | os.PathLike[str]) -> Store:
    """Return the store of a folder, or of an address with "://"."""
    return Remote(str(place)) if "://" in str(place) else Shared(Path(place))


def make_once(store: Store, name: str, key: str, make: Callable[[], Mapping[str, np.ndarray]]) -> bool:
    """Make a file of tensors, unless it is there, whole and with this key; return True if it was made now.

    key: of all that decides what is in it.
    """
    path = store.bring(name)
    is_new = not is_finished(path, {"key": key})
    if is_new:
        tensors = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tensors(path, tensors, {"key": key}, overwrite=True)
    if is_new or not store.has(name):  # who made it may have been killed before it was sent
        store.send(name)
    return is_new
