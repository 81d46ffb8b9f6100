"""Files that browsers send: each batch in a temporary folder of its own, bounded in bytes and files."""

import re
import shutil
import tempfile
from collections import OrderedDict
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path

from starlette.exceptions import HTTPException

from ....errors import InputError
from ....formats.photo_files import safe_name
from ....formats.replacing import replacing
from ....formats.scenes import FIELD_SUFFIX

MAX_FOLDER_DEPTH = 8
_BATCH = re.compile(r"[A-Za-z0-9_-]{1,64}")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # files of no disk, on Windows


@dataclass(frozen=True)
class UploadLimits:
    """bytes, files: of all batches that are there. batches: that are not open yet. free: left on the disk, in bytes."""

    bytes: int = 4 << 30
    files: int = 20_000
    batches: int = 4
    free: int = 1 << 30


@dataclass(eq=False)
class Batch:
    """Files that belong together. size: bytes of them."""

    folder: Path
    size: int = 0
    files: int = 0


@dataclass(eq=False)
class Uploads:
    """Batches by the name that their sender gave them. Their folders go away with `close`, if not before."""

    limits: UploadLimits = UploadLimits()
    batches: "OrderedDict[str, Batch]" = field(default_factory=OrderedDict)
    opened: Batch | None = None
    _root: Path | None = None

    @property
    def root(self) -> Path:
        """The folder that all of them are in, made when it is first needed."""
        if self._root is None:
            self._root = Path(tempfile.mkdtemp(prefix="drsplat-")).resolve()
        return self._root

    @property
    def roots(self) -> list[Path]:
        """Folders of this machine that senders are not told."""
        return [*(batch.folder for batch in self.every), *([] if self._root is None else [self._root])]

    def close(self) -> None:
        """Remove all files."""
        self.batches.clear()
        self.opened = None
        if self._root is not None:
            shutil.rmtree(self._root, ignore_errors=True)
            self._root = None

    @property
    def every(self) -> list[Batch]:
        """All batches that are there, with the one that is open."""
        return [*self.batches.values(), *([] if self.opened is None else [self.opened])]

    async def take(self, batch: str, name: str, chunks: AsyncIterator[bytes]) -> int:
        """Write one file of a batch; returns its bytes. Half of a file is not kept.

        Raises: InputError: a name that is no plain path inside a folder, or of a file that is there. HTTPException: it
        is too large, or the disk too full.
        """
        place = checked_path(name)
        if not _BATCH.fullmatch(batch):
            raise InputError("batch: expected 1 to 64 letters, digits, - and _")
        if batch not in self.batches:
            while len(self.batches) >= self.limits.batches:
                self.drop(next(iter(self.batches)))
            self.batches[batch] = Batch(Path(tempfile.mkdtemp(dir=self.root)))
        own = self.batches[batch]
        if own.files >= self.limits.files:
            raise HTTPException(413, f"a batch of at most {self.limits.files:,} files is taken")
        path, begun = own.folder / place, own.size
        own.files += 1
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path, overwrite=False) as file:
                async for chunk in chunks:
                    size = len(chunk)
                    if sum(one.size for one in self.every) + size > self.limits.bytes:
                        raise HTTPException(413, f"files of at most {self.limits.bytes:,} bytes in all are taken")
                    if shutil.disk_usage(own.folder).free - size < self.limits.free:
                        raise HTTPException(507, "the disk of the viewer's machine is too full for this file")
                    own.size += size
                    file.write(chunk)
        except BaseException:
            own.size, own.files = begun, own.files - 1
            raise
        return own.size - begun

    def drop(self, name: str) -> None:
        """Remove a batch, if it is there."""
        batch = self.batches.pop(name, None)
        if batch is not None:
            shutil.rmtree(batch.folder, ignore_errors=True)

    def batch(self, name: str) -> Batch:
        """Return a batch of files. Raises: InputError: nothing was sent under that name."""
        if name not in self.batches:
            raise InputError("open: expected a batch of files that was sent before")
        return self.batches[name]

    def keep_opened(self, name: str | None) -> None:
        """Keep the files of a batch while its scene is open, and remove those of the scene before it."""
        before, self.opened = self.opened, None if name is None else self.batches.pop(name)
        if before is not None:
            shutil.rmtree(before.folder, ignore_errors=True)


def checked_path(name: str) -> Path:
    """Return the path of a file inside a folder. Raises: FormatError, InputError: it would leave it, or is no file."""
    parts = Path(safe_name(name, "name")).parts
    odd = (
        _DEVICE.fullmatch(part) or part.startswith(".") or part.endswith((" ", ".")) or ":" in part for part in parts
    )
    if len(parts) > MAX_FOLDER_DEPTH or any(odd):
        raise InputError(f"name: expected a plain file, in {MAX_FOLDER_DEPTH} folders at most; got {name!a:.80}")
    return Path(*parts)


def root_of(folder: Path) -> Path:
    """Return the one file in a folder, or the folder in it where a scene and what belongs to it lie side by side."""
    inside = list(folder.iterdir())
    if len(inside) != 1 or inside[0].suffix == FIELD_SUFFIX:
        return folder
    return root_of(inside[0]) if inside[0].is_dir() else inside[0]
