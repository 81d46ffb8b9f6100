"""embedding.json: what made the features of a folder, and which of them are finished.

While `embed` runs, it appends a line to the journal embedding.jsonl for each photo that it finishes: rewriting the
document each time would cost more with every photo. At the end the document takes over all entries, and the journal is
removed. The journal's first line names the document that it continues by its checksum: a journal beside another
document is one that had been taken into it, and is not read. Each line carries its own checksum. A last line without
its end was being written when the process was killed, and does not count.

The names that files of language features have.
"""

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from ..base.contents import open_file
from ..errors import FormatError, InputError, MismatchError
from ..scene.encoders import EncoderIdentity, identity_text
from .json_files import as_document, as_fields, as_kind, document_in, read_json, write_json
from .photo_files import listed
from .replacing import saying_what_is_full, sync_folder
from .tensors import DOCUMENT, check_document, check_seal, hash_file, sealed

MAPS, EMBEDDINGS = "_s.npy", "_f.npy"  # LangSplat's
COMPACT = ".features.safetensors"
Form = Literal["compact", "langsplat"]
"""Forms that features of a photo are stored in; `langsplat.FORMS` says how each is opened."""


def stems(directory: Path, ending: str) -> list[str]:
    """Return the names, without `ending`, of the files in a folder and its subfolders that end so, sorted."""
    names = (path.relative_to(directory).as_posix() for path in directory.rglob(f"*{ending}"))
    return sorted(name.removesuffix(ending) for name in names)


CONTINUES = "continues"


class Journal:
    """A new journal of a document; it replaces another. A line is on disk when `add` returns.

    document: the checksum of what the lines continue.
    """

    def __init__(self, path: Path, document: str) -> None:
        self.path = path
        path.unlink(missing_ok=True)
        with saying_what_is_full(path):
            self._file: BinaryIO = path.open("xb", buffering=0)
        self.add({CONTINUES: document})
        sync_folder(path.parent)

    def add(self, change: dict[str, object]) -> None:
        """Append a change and sync it to disk. Raises: NoRoom: the disk is full."""
        with saying_what_is_full(self.path):
            line = json.dumps(sealed(change)).encode() + b"\n"
            while line:
                line = line[self._file.write(line) :]
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Leave the file as it is; it is removed when all that it holds stands in the document."""
        self._file.close()


FILE_NAME, JOURNAL, FORMAT = "embedding.json", "embedding.jsonl", "drsplat embedding 1"
_CURE = "Name another folder, or pass overwrite to make all anew"
_ENDINGS = (MAPS, COMPACT, EMBEDDINGS)  # in the order of removal: a photo is listed by its maps or compact file


@dataclass(frozen=True)
class Finished:
    """Record of one photo's finished files.

    photo: hash of the photo's bytes, and its raster. embeddings: hash of `_f.npy`, which is written first, or of the
    compact file. map_bytes: size of `_s.npy`; None for a compact file, which needs none. masks: their number by level.
    empty_masks: number of masks left out because they had no pixels.
    """

    photo: str
    embeddings: str
    map_bytes: int | None
    masks: Mapping[str, int]
    empty_masks: int

    @property
    def form(self) -> Form:
        return "compact" if self.map_bytes is None else "langsplat"


class EmbeddingRecord:
    """Record of one folder, of `open_record`, or `read_record` to be read. A change is on disk when a method returns.

    settings: what `embed` used last here. changes: those that differ from the folder's former ones. finished: entries
    by stem of the files.
    """

    def __init__(
        self, folder: Path, settings: Mapping[str, object], finished: dict[str, Finished], changes: tuple[str, ...] = ()
    ) -> None:
        self.folder, self.settings, self.finished, self.changes = folder, settings, finished, changes
        self._journal: Journal | None = None

    def is_finished(self, stem: str, photo: str) -> bool:
        """Return whether a photo's files exist and belong to these settings and to this photo."""
        entry = self.finished.get(stem)
        return entry is not None and entry.photo == photo and _fits(entry, self.folder, stem)

    def has_files(self, stem: str) -> bool:
        return any((self.folder / f"{stem}{ending}").is_file() for ending in (MAPS, COMPACT))

    def unfinished(self) -> list[str]:
        """Return the stems that have files but no entry."""
        return [stem for stem in _listed_stems(self.folder) if stem not in self.finished]

    def whole(self) -> "EmbeddingRecord":
        """Return the record of features that are all of its settings.

        Raises: MismatchError: some have no entry, for example after `embed` was stopped when a setting had changed.
        """
        if others := self.unfinished():
            raise MismatchError(
                f"{self.folder}: {len(others)} photos have features that are not of the settings in "
                f"{FILE_NAME}: let drsplat embed finish, or remove them: {listed(others)}"
            )
        return self

    def embedded_by(self, named: EncoderIdentity | None) -> EncoderIdentity:
        """Return the recorded encoder. Raises: MismatchError: another is named. FormatError: a damaged record."""
        recorded = encoder_from_json(self.settings.get("encoder"), str(self.folder / FILE_NAME))
        if named is None or recorded.matches(named):
            return recorded
        raise MismatchError(
            f"{self.folder} was embedded by '{identity_text(recorded)}', as drsplat embed noted in {FILE_NAME}; named "
            f"was '{identity_text(named)}': name no encoder, or if other embeddings were put there, remove {FILE_NAME}"
        )

    def make_room(self, stem: str) -> None:
        """Forget a photo's files before they are replaced.

        An entry that outlives its files could match later ones. Maps must never lie beside embeddings of other masks,
        whenever the run is killed.
        """
        if stem in self.finished:
            self._change(stem, None)
        for ending in _ENDINGS:
            (self.folder / f"{stem}{ending}").unlink(missing_ok=True)

    def add(self, stem: str, photo: str, masks: Mapping[str, int], empty_masks: int, form: Form) -> None:
        """Add an entry, once the files are written."""
        compact, maps, rows = (self.folder / f"{stem}{e}" for e in (COMPACT, MAPS, EMBEDDINGS))
        digest = hash_file(compact if form == "compact" else rows)
        size = None if form == "compact" else maps.stat().st_size
        self._change(stem, Finished(photo, digest, size, masks, empty_masks))

    def write(self) -> str:
        """Write the document with all entries, and return its checksum."""
        photos = {stem: asdict(entry) for stem, entry in sorted(self.finished.items())}
        document = sealed({"format": FORMAT, "settings": self.settings, "photos": photos})
        write_json(self.folder / FILE_NAME, document, overwrite=True, end="")
        return str(document[DOCUMENT])

    def close(self) -> None:
        """Move the journal's entries into the document, if anything has changed. Do not use the record afterwards."""
        if self._journal is not None:
            self._journal.close()
            self.write()
            self._journal.path.unlink()

    def _change(self, stem: str, entry: Finished | None) -> None:
        """Append to the journal that a photo is finished, or no longer is (None)."""
        if self._journal is None:
            self._journal = Journal(self.folder / JOURNAL, self.write())
        self._journal.add({"stem": stem, "finished": entry and asdict(entry)})
        self.finished.pop(stem, None)
        if entry is not None:
            self.finished[stem] = entry


def open_record(folder: Path, settings: Mapping[str, object], overwrite: bool = False) -> EmbeddingRecord:
    """Open the record of a folder for files with these settings; create folder and record if they are missing.

    If the folder's settings differ, nothing in it counts as finished. With `overwrite` nothing does either, and
    features without a record may be replaced.

    Raises: InputError: features of another program, settings that JSON cannot hold. FormatError: a damaged record.
    """
    if (folder.is_symlink() or folder.exists()) and not folder.is_dir():
        raise InputError(f"{folder} is no folder: name one for the features, or a new one")
    try:
        plain: dict[str, object] = json.loads(json.dumps(settings))
    except TypeError as error:
        raise InputError(f"an identity must hold text, numbers and lists of them: {error}") from None
    path, settings = folder / FILE_NAME, plain
    if path.is_file() and not overwrite:
        before, finished = _read(path)
        changes = tuple(_changed(before, settings))
        record = EmbeddingRecord(folder, settings, {} if changes else finished, changes)
        if changes:
            record.write()
        return record
    foreign = [stem for ending in _ENDINGS for stem in stems(folder, ending)]
    if foreign and not overwrite:
        raise InputError(
            f"{folder} has features that were not made here ({FILE_NAME} is missing): name another "
            f"folder, or pass overwrite=True to replace them: {listed(sorted(set(foreign)))}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    record = EmbeddingRecord(folder, settings, {})
    record.write()
    return record


def read_record(folder: Path) -> EmbeddingRecord | None:
    """Read the record of a folder's features; None without one. Raises: FormatError: damaged."""
    path = folder / FILE_NAME
    return EmbeddingRecord(folder, *_read(path)) if path.is_file() else None


def check_finished(entry: Finished, folder: Path, stem: str) -> None:
    """Compare a photo's files with its entry. Raises: FormatError: they differ, e.g. belong to another photo."""
    if not _fits(entry, folder, stem):
        raise FormatError(
            f"{folder / stem}: its features are not those that drsplat embed made of this photo: give the same "
            f"`drsplat embed` to make them again, or if other features were put there, remove {FILE_NAME}"
        )


def verify_embedding(folder: Path) -> list[str]:
    """Compare the files of a folder with the hashes in its record, and return the names of the files with a hash.

    Raises: FormatError: a file that has changed or is missing.
    """
    path = folder / FILE_NAME
    if not path.is_file():
        return []
    check_document(path)
    _, finished = _read(path)
    names = {f"{stem}{COMPACT if entry.form == 'compact' else EMBEDDINGS}": entry for stem, entry in finished.items()}
    for name, entry in names.items():
        if not (folder / name).is_file() or hash_file(folder / name) != entry.embeddings:
            raise FormatError(f"{folder / name}: damaged or missing: give the same `drsplat embed` to make it again")
    journal = [JOURNAL] if (folder / JOURNAL).is_file() else []
    return sorted([FILE_NAME, *journal, *names])


def encoder_from_json(identity: object, where: str) -> EncoderIdentity:
    """Return the identity that `identity_json` wrote.

    Raises: FormatError: not an object of name, dim and weights.
    """
    encoder: EncoderIdentity = as_kind(identity, EncoderIdentity, f"{where}: the encoder")
    if encoder.dim < 1:
        raise FormatError(f"{where}: the encoder: dim: expected 1 or more, got {encoder.dim}")
    return encoder


def _read(path: Path) -> tuple[dict[str, object], dict[str, Finished]]:
    document = as_document(read_json(path), str(path), FORMAT, cure=_CURE)
    settings, photos = as_fields(document, str(path), settings=dict[str, object], photos=dict[str, object]).values()
    check_seal(document, f"{path}", cure=_CURE)
    for change in changes_to(path.with_name(JOURNAL), str(document.get(DOCUMENT)), _CURE):
        photos[str(change.get("stem"))] = change.get("finished")
    entries = {stem: _entry(value) for stem, value in photos.items()}
    return settings, {stem: entry for stem, entry in entries.items() if entry is not None}


def _entry(value: object) -> Finished | None:
    """Return an entry, or None if it is malformed: its photo is then embedded again."""
    try:
        return as_kind(value, Finished, "")  # type: ignore[no-any-return]
    except FormatError:
        return None


def _fits(entry: Finished, folder: Path, stem: str) -> bool:
    if entry.form == "compact":
        hashed = folder / f"{stem}{COMPACT}"
        return hashed.is_file() and hash_file(hashed) == entry.embeddings
    maps, embeddings = folder / f"{stem}{MAPS}", folder / f"{stem}{EMBEDDINGS}"
    if not maps.is_file() or maps.stat().st_size != entry.map_bytes or not embeddings.is_file():
        return False
    return hash_file(embeddings) == entry.embeddings


def _listed_stems(folder: Path) -> list[str]:
    return sorted({*stems(folder, MAPS), *stems(folder, COMPACT)})


def _changed(before: object, now: object, name: str = "") -> Iterator[str]:
    """Yield each setting that differs, with its value before and now."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in [*before, *(key for key in now if key not in before)]:
            yield from _changed(before.get(key), now.get(key), f"{name}.{key}" if name else key)
    elif before != now:
        yield f"{name}: {json.dumps(before)} -> {json.dumps(now)}"


def changes_to(path: Path, document: str, cure: str) -> Iterator[dict[str, object]]:
    """Yield the changes that the journal at `path` holds of a document with this checksum, in their order.

    cure: what to do about damage, a sentence.

    Raises: FormatError: a line that is not what was written. InputError: a folder or a pipe is in its place.
    """
    try:
        with open_file(path) as file:
            *lines, _ = file.read().split(b"\n")
    except FileNotFoundError:
        return
    for number, line in enumerate(lines):
        where = f"{path}: line {number + 1}"
        change = document_in(line, where)
        if not isinstance(change, dict) or json.dumps(change).encode() != line:
            raise FormatError(f"{where}: damaged or edited: expected an object as it was written. {cure}")
        check_seal(change, where, cure=cure)
        if number > 0:
            yield change
        elif change.get(CONTINUES) != document:
            return
