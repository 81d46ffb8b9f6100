"""Codes of a catalogue's descriptors, in files beside the table: all are scanned, and the best compared exactly.

`codes/codebook.safetensors` has the codebook, and its presence says that there is an index; `codes/HASH`, of the
codebook's hash, a file for each of the table's files of rows, NAME.VERSION.safetensors: the codes of all rows that were
not deleted in that version. A file of rows is never changed, so neither are its codes; a codebook is written after the
codes that it needs. docs/catalogue.md has the layout.
"""

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...base.arrays import Bool, Float32, Int64
from ...errors import FormatError, InputError
from ...field.codes import PQ, Codebook, Codes, PQCode, load_codebook, pq_code, save_codebook, train_codebook
from ...formats.checksums import check_checksums
from ...formats.tensors import check_tensors, map_tensors, read_tensors, write_tensors
from .manifest import Fragment

if TYPE_CHECKING:
    from .table import Snapshot

FOLDER, CODEBOOK, FORMAT, SUFFIX = "codes", "codebook.safetensors", "drsplat catalogue codes 1", ".safetensors"
TRAINING_ROWS = 8192  # objects whose descriptors a codebook is trained on
ROWS_AT_ONCE = 8192  # of which descriptors are in memory while they are encoded
ROWS_OF_PART = 65_536  # rows of files that are scanned as one
ROWS_OF_THREADS = 1 << 16  # descriptors of a part from which a second thread is worth its start
SMALL_BYTES = 64 << 20  # files of codes up to this size are compared whole when they are opened
OFTEN = 3  # descriptors that are looked at for an object that is wanted, at first
MORE = 4  # times as many, if those were too few
CURE = "`drsplat catalogue index` makes these files anew"
ARRAYS = {"grouped_codes": ("uint8", "g L k"), "inverse_norms": ("float32", "n"), "rows": ("uint32", "n")}


class Part(NamedTuple):
    """Codes of descriptors that are scanned as one. row_ids: of the row that each is of."""

    code: PQCode
    row_ids: Int64[np.ndarray, " n"]


class Found(NamedTuple):
    """Rows of the best codes, best first. is_all: no others are left."""

    row_ids: Int64[np.ndarray, " h"]
    is_all: bool


Key = tuple[Fragment, ...]  # of a part


@dataclass(frozen=True, eq=False)
class Coded:
    """Codes of one version of a table. without: fragments that have none."""

    codebook: Codebook
    parts: Mapping[Key, Part]
    without: tuple[Fragment, ...]

    def nearest(
        self, query: Float32[np.ndarray, " D"], count: int, allowed: Int64[np.ndarray, " a"] | None, threads: int
    ) -> Found:
        """Return `count` rows of the highest codes; deleted ones may be among them. allowed: ids, ascending."""
        most = sum(len(part.row_ids) for part in self.parts.values())
        looked_at = OFTEN * count * (1 if allowed is None else most // max(len(allowed), 1) + 1)
        while True:
            ids = self._top(query, min(looked_at, most), threads)
            ids = ids if allowed is None else ids[_among(ids, allowed)]
            distinct = ids[np.sort(np.unique(ids, return_index=True)[1])]
            if len(distinct) >= count or looked_at >= most:
                return Found(distinct[:count], looked_at >= most and len(distinct) <= count)
            looked_at *= MORE

    def _top(self, query: Float32[np.ndarray, " D"], count: int, threads: int) -> Int64[np.ndarray, " h"]:
        """Return the rows of the `count` best descriptors, best first; the largest part sets what others must reach."""
        ids, scores = np.empty(0, np.int64), np.empty(0, np.float32)
        for code, row_ids in sorted(self.parts.values(), key=lambda part: -len(part.row_ids)):
            own = threads if len(row_ids) >= ROWS_OF_THREADS else 1
            is_full = len(scores) >= count > 0
            hits = code.select(query, scores[-1], threads=own) if is_full else code.top(query, count, threads=own)
            scores = np.concatenate([scores, hits.scores])
            best = np.argsort(-scores, kind="stable")[:count]
            ids, scores = np.concatenate([ids, row_ids[hits.rows]])[best], scores[best]
        return ids


def _among(ids: Int64[np.ndarray, " h"], allowed: Int64[np.ndarray, " a"]) -> Bool[np.ndarray, " h"]:
    if not len(allowed):
        return np.zeros(len(ids), np.bool_)
    return np.asarray(allowed[np.minimum(np.searchsorted(allowed, ids), len(allowed) - 1)] == ids)


@dataclass(eq=False)
class CodeReader:
    """Codes of a catalogue, whatever version is asked for; what both versions need is read once. For several threads.

    Args: path: of the catalogue.
    """

    path: Path
    _lock: Lock = field(default_factory=Lock, repr=False)
    _last: Coded | None = field(default=None, repr=False)
    _snapshot: "Snapshot | None" = field(default=None, repr=False)

    def of(self, snapshot: "Snapshot") -> Coded | None:
        """Return the codes of a version; None if there is no index.

        Raises: FormatError: damaged files, or codes of another encoder.
        """
        with self._lock:
            if self._snapshot is snapshot:
                return self._last
            fragments = snapshot.fragments if has_codebook(self.path) else None
            if fragments is None:
                return None
            self._last, self._snapshot = self._read(snapshot, fragments), snapshot
            return self._last

    def _read(self, snapshot: "Snapshot", fragments: Sequence[Fragment]) -> Coded:
        """Read what the last version has not; anew where files were replaced meanwhile."""
        codebook = codebook_of(self.path, snapshot)
        files = _files(self.path, codebook.hash, snapshot.version)
        last = self._last.parts if self._last and self._last.codebook.hash == codebook.hash else {}
        keys = _keys(one for one in fragments if one.data in files)
        try:
            parts = {key: last[key] if key in last else _part(codebook, key, files) for key in keys}
        except FormatError:
            now = codebook_of(self.path, snapshot)
            if (now.hash, _files(self.path, now.hash, snapshot.version)) == (codebook.hash, files):
                raise
            return self._read(snapshot, fragments)
        return Coded(codebook, parts, tuple(one for one in fragments if one.data not in files))


def has_codebook(path: Path) -> bool:
    return (path / FOLDER / CODEBOOK).exists()


def codebook_of(path: Path, snapshot: "Snapshot") -> Codebook:
    """Read the codebook of a catalogue. Raises: FormatError: damaged, or of another encoder."""
    file = path / FOLDER / CODEBOOK
    try:
        codebook = load_codebook(file)
    except (FormatError, InputError) as error:
        raise FormatError(f"{error}: {CURE}") from error
    if not snapshot.encoder.matches(codebook.encoder):
        raise FormatError(f"{file}: a codebook of {codebook.encoder.name}, not of this table's encoder: {CURE}")
    return codebook


def trained(snapshot: "Snapshot", threads: int = 0) -> Codebook:
    """Train a codebook on the descriptors of objects spread over the table."""
    sample = snapshot.spread(TRAINING_ROWS).descriptors
    return train_codebook(sample, PQ().parts(snapshot.encoder.dim), encoder=snapshot.encoder, threads=threads)


def write_missing(snapshot: "Snapshot", codebook: Codebook, most_rows: int, anew: bool = False) -> None:
    """Encode the fragments of a version that have no codes yet, of up to `most_rows` each; `anew`: all of them.

    Several processes may do so at once: each file is written whole, and both write the same.
    """
    folder = snapshot.path / FOLDER / codebook.hash
    folder.mkdir(parents=True, exist_ok=True)
    files = _files(snapshot.path, codebook.hash, snapshot.version)
    for fragment in snapshot.fragments or ():
        if anew or (fragment.data not in files and fragment.num_rows <= most_rows):
            _write(snapshot, fragment, _encoded(snapshot, fragment, codebook))


def carry(before: "Snapshot", after: "Snapshot", codebook: Codebook) -> None:
    """Write the codes of fragments that were put together from those of others, if the rows are the same in one order.

    What this cannot do, `write_missing` does: it takes the time of encoding anew.
    """
    files, there = (_files(one.path, codebook.hash, one.version) for one in (before, after))
    former, present = before.fragments or [], after.fragments or []
    gone = [one for one in former if one not in present]
    new = [one for one in present if one not in former and one.data not in there]
    if not new or not gone or any(one.data not in files for one in gone):
        return
    (old_ids, old_heads), (new_ids, new_heads) = before.heads(gone), after.heads(new)
    if not old_heads.equals(new_heads):
        return
    part = _joined(codebook, [_read(codebook, one, files[one.data]) for one in gone])
    alive = np.flatnonzero(_among(part.row_ids, old_ids))
    row_ids = new_ids[np.searchsorted(old_ids, part.row_ids[alive])]
    for fragment in new:
        own = (row_ids >= fragment.first) & (row_ids < fragment.first + fragment.num_rows)
        _write(after, fragment, Part(part.code.rows(alive[own]), row_ids[own]))


def publish(path: Path, codebook: Codebook) -> None:
    """Write the codebook, from when on its codes are searched."""
    save_codebook(codebook, path / FOLDER / CODEBOOK, overwrite=True)


def is_whole(snapshot: "Snapshot") -> bool:
    """Return whether all fragments of a version have codes, or there is no index."""
    if not has_codebook(snapshot.path):
        return True
    files = _files(snapshot.path, codebook_of(snapshot.path, snapshot).hash, snapshot.version)
    return all(fragment.data in files for fragment in snapshot.fragments or ())


def sweep(path: Path, codebook: Codebook, data: Path) -> None:
    """Remove codes of other codebooks, and of rows that are no longer there; only one process may do so at a time."""
    for folder in (path / FOLDER).iterdir():
        if folder.is_dir() and folder.name != codebook.hash:
            shutil.rmtree(folder, ignore_errors=True)
    there = {file.name for file in data.iterdir()}
    _remove(file for file, name, _ in _listed(path / FOLDER / codebook.hash) if name not in there)


def verify(path: Path) -> list[str]:
    """Compare every byte of all codes with its checksum; return the names of the files. Raises: FormatError: damage."""
    files = sorted((path / FOLDER).rglob(f"*{SUFFIX}"))
    for file in files:
        try:
            load_codebook(file) if file.name == CODEBOOK else read_tensors(file)
        except FormatError as error:
            raise FormatError(f"{error}: {CURE}") from error
    return [file.relative_to(path).as_posix() for file in files]


def _remove(files: Iterable[Path]) -> None:
    for file in files:
        with suppress(OSError):  # a process that searches it may hold it, until the next time
            file.unlink()


def _listed(folder: Path) -> Iterator[tuple[Path, str, int]]:
    """Yield each file of codes, the name of its rows' file, and the version of which it has all rows."""
    for name in sorted(os.listdir(folder) if folder.is_dir() else ()):
        stem, _, version = name.removesuffix(SUFFIX).rpartition(".")
        if name.endswith(SUFFIX) and version.isdecimal():
            yield folder / name, stem, int(version)


def _files(path: Path, codebook: str, version: int) -> dict[str, Path]:
    """Return the file of codes by the name of its rows' file, of those that have all rows of a version."""
    return {name: file for file, name, first in _listed(path / FOLDER / codebook) if first <= version}


def _keys(fragments: Iterable[Fragment]) -> list[Key]:
    """Return fragments in groups: a large one alone, small ones that follow each other."""
    keys: list[list[Fragment]] = []
    for fragment in fragments:
        if not keys or sum(one.num_rows for one in keys[-1]) + fragment.num_rows > ROWS_OF_PART:
            keys.append([])
        keys[-1].append(fragment)
    return [tuple(key) for key in keys]


def _write(snapshot: "Snapshot", fragment: Fragment, part: Part) -> None:
    """Write the codes of all rows of a fragment that a version has, in place of others."""
    code = part.code
    folder = snapshot.path / FOLDER / code.codebook.hash
    written = folder / f"{fragment.data}.{snapshot.version}{SUFFIX}"
    rows = (part.row_ids - fragment.first).astype(np.uint32)
    tensors = {"grouped_codes": code.grouped, "inverse_norms": code.inverse_norms, "rows": rows}
    about = {"format": FORMAT, "codebook": code.codebook.hash, "data": fragment.data}
    write_tensors(written, tensors, about, overwrite=True)
    _remove(path for path in folder.glob(f"{fragment.data}.*{SUFFIX}") if path != written)


def _part(codebook: Codebook, key: Key, files: Mapping[str, Path]) -> Part:
    """Read the codes of some fragments; those of one are mapped, those of several are put together in memory."""
    parts = [_read(codebook, fragment, files[fragment.data]) for fragment in key]
    return parts[0] if len(parts) == 1 else _joined(codebook, parts)


def _joined(codebook: Codebook, parts: Sequence[Part]) -> Part:
    plain = Codes(np.concatenate([part.code.codes().codes for part in parts]))
    norms = np.concatenate([part.code.inverse_norms for part in parts])
    return Part(pq_code(codebook, plain, norms), np.concatenate([part.row_ids for part in parts]))


def _read(codebook: Codebook, fragment: Fragment, file: Path) -> Part:
    try:
        tensors, about = map_tensors(file)
        check_tensors(tensors, ARRAYS, str(file))
        if (about.get("format"), about.get("codebook"), about.get("data")) != (FORMAT, codebook.hash, fragment.data):
            raise FormatError(f"{file}: expected the codes of {fragment.data} by the codebook beside them")
        if sum(array.nbytes for array in tensors.values()) <= SMALL_BYTES:
            check_checksums(tensors, about, str(file))
        if tensors["rows"].max(initial=0) >= fragment.num_rows > 0:
            raise FormatError(f"{file}: codes of more than {fragment.num_rows} rows")
        code = PQCode(codebook, tensors["grouped_codes"], None, tensors["inverse_norms"])
    except (FormatError, InputError) as error:
        raise FormatError(f"{error}: {CURE}") from error
    return Part(code, tensors["rows"].astype(np.int64) + fragment.first)


def _encoded(snapshot: "Snapshot", fragment: Fragment, codebook: Codebook) -> Part:
    codes, rows = [np.empty((0, codebook.num_subvectors), np.uint8)], [np.empty(0, np.int64)]
    for begin in range(fragment.first, fragment.first + fragment.num_rows, ROWS_AT_ONCE):
        end = min(begin + ROWS_AT_ONCE, fragment.first + fragment.num_rows)
        row_ids, described = snapshot.described(np.arange(begin, end))
        codes.append(codebook.encode(described.descriptors).codes)
        rows.append(np.repeat(row_ids, np.diff(described.starts)))
    return Part(pq_code(codebook, Codes(np.concatenate(codes))), np.concatenate(rows))
