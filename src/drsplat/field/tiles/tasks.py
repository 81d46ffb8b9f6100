"""Work in parts by tasks that leave files: whoever is killed, finished parts are there, and only others are made."""

import hashlib
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

from ...base.arrays import ArraysByName
from ...base.contents import pieces
from ...base.working import Held, Part
from ...formats.tensors import map_tensors
from ...kernels import default_isa
from ..codes import Track
from .launching import Launcher, followed
from .store import Remote, Shared, Store, make_once

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Stored:
    """`Held` in a file of a store; another process gets the name, and maps the file when it needs it."""

    store: Store
    name: str

    @cached_property
    def arrays(self) -> ArraysByName:
        return map_tensors(self.store.bring(self.name))[0]

    def __getstate__(self) -> dict[str, object]:
        return {"store": self.store, "name": self.name}


def make_part(store: Store, part: Part[Any], threads: int, task: tuple[str, Any]) -> bool:
    """Make the file of an item, unless it is there. task: name of the file, and item."""
    name, item = task
    return make_once(store, name, name, lambda: part(item, threads))


@dataclass(frozen=True, eq=False)
class ByTasks:
    """A `Work` that lets a launcher work. folder: of the files in the store. threads: of each worker.

    The name of a file has a hash of all that decides what is in it.
    """

    store: Store
    launcher: Launcher
    threads: int
    track: Track
    folder: str

    def hold(self, arrays: ArraysByName) -> Held:
        """See Work."""
        digest = hashlib.blake2b(digest_size=16)
        for name, array in arrays.items():
            digest.update(f"{name} {array.dtype} {array.shape}".encode())
            for piece in pieces(array):
                digest.update(piece)
        name = f"{self.folder}/{digest.hexdigest()}.held.safetensors"
        make_once(self.store, name, name, lambda: arrays)
        return Stored(self.store, name)

    def __call__(self, part: Part[T], items: Sequence[T], doing: str) -> list[Held]:
        """See Work."""
        kind = type(part).__name__.lower()
        key = _key(default_isa(), part)
        names = [f"{self.folder}/{_key(key, item)}.{kind}.safetensors" for item in items]
        results = self.launcher.results(
            partial(make_part, self.store, part, self.threads), list(zip(names, items, strict=True))
        )
        for _ in followed(results, self.track, [f"{kind} {number}" for number in range(len(items))], doing):
            pass
        return [Stored(self.store, name) for name in names]


class _Deciding(pickle.Pickler):
    """Pickles what decides a result: not where files are, nor what dataclasses compute or do not show."""

    def persistent_id(self, thing: object) -> str | None:
        return "place" if isinstance(thing, Shared | Remote | Path) else None

    def reducer_override(self, thing: Any) -> Any:
        if is_dataclass(thing) and not isinstance(thing, type):
            deciding = (getattr(thing, one.name) for one in fields(thing) if one.repr)
            return tuple, ([type(thing).__name__, *deciding],)
        return NotImplemented


def _key(*things: object) -> str:
    """Hash all that decides a result. Nothing reads what is pickled for it."""
    out = BytesIO()
    _Deciding(out, pickle.HIGHEST_PROTOCOL).dump(things)
    return hashlib.blake2b(out.getvalue(), digest_size=16).hexdigest()
