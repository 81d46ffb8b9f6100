"""Codes of a catalogue's descriptors, in files beside the table: all are scanned, and the best compared exactly.

`codes/codebook.safetensors` has the codebook, and its presence says that there is an index; `codes/HASH`, of the
codebook's hash, a file for each of the table's files of rows, NAME.VERSION.safetensors: the codes of all rows that were
not deleted in that version. A file of rows is never changed, so neither are its codes; a codebook is written after the
codes that it needs. docs/catalogue.md has the layout.

The objects of the highest cosines with a query: by codes, of which the best are compared exactly, or all.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Embedding, Flags, Indices, OtherIndices
from ...errors import FormatError, InputError
from ...field.codes import Codebook, Codes, PQCode, load_codebook, pq_code
from ...formats.tensors import check_checksums, check_tensors, map_tensors
from ..ranking import Described
from .record import Fragment
from .snapshot import ROW_ID, Snapshot, cosines_of, described_of, libraries

FOLDER, CODEBOOK, FORMAT, SUFFIX = "codes", "codebook.safetensors", "drsplat catalogue codes 1", ".safetensors"
ROWS_OF_PART = 65_536  # rows of files that are scanned as one
ROWS_OF_THREADS = 1 << 16  # descriptors of a part from which a second thread is worth its start
SMALL_BYTES = 64 << 20  # files of codes up to this size are compared whole when they are opened
DESCRIPTORS_PER_WANTED = 3  # that are looked at for an object that is wanted, at first
GROWTH = 4  # times as many, if those were too few
CURE = "`drsplat catalogue index` makes these files anew"
ARRAYS = {"grouped_codes": ("uint8", "g L k"), "inverse_norms": ("float32", "n"), "rows": ("uint32", "n")}


class Part(NamedTuple):
    """Codes of descriptors that are scanned as one. row_ids: of the row that each is of."""

    code: PQCode
    row_ids: Indices


class Found(NamedTuple):
    """Rows of the best codes, best first. is_all: no others are left."""

    row_ids: Indices
    is_all: bool


Key = tuple[Fragment, ...]  # of a part


@dataclass(frozen=True, eq=False)
class Coded:
    """Codes of one version of a table. without: fragments that have none."""

    codebook: Codebook
    parts: Mapping[Key, Part]
    without: tuple[Fragment, ...]

    def nearest(self, query: Embedding, count: int, allowed: Indices | None, threads: int) -> Found:
        """Return `count` rows of the highest codes; deleted ones may be among them. allowed: ids, ascending."""
        most = sum(len(part.row_ids) for part in self.parts.values())
        looked_at = DESCRIPTORS_PER_WANTED * count * (1 if allowed is None else most // max(len(allowed), 1) + 1)
        while True:
            ids = self._top(query, min(looked_at, most), threads)
            ids = ids if allowed is None else ids[among(ids, allowed)]
            distinct = ids[np.sort(np.unique(ids, return_index=True)[1])]
            if len(distinct) >= count or looked_at >= most:
                return Found(distinct[:count], looked_at >= most and len(distinct) <= count)
            looked_at *= GROWTH

    def _top(self, query: Embedding, count: int, threads: int) -> Indices:
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


def among(ids: Indices, allowed: OtherIndices) -> Flags:
    if not len(allowed):
        return np.zeros(len(ids), np.bool_)
    return allowed[np.minimum(np.searchsorted(allowed, ids), len(allowed) - 1)] == ids


@dataclass(eq=False)
class CodeReader:
    """Codes of a catalogue, whatever version is asked for; what both versions need is read once. For several threads.

    Args: path: of the catalogue.
    """

    path: Path
    _lock: Lock = field(default_factory=Lock, repr=False)
    _last: Coded | None = field(default=None, repr=False)
    _snapshot: Snapshot | None = field(default=None, repr=False)

    def of(self, snapshot: Snapshot) -> Coded | None:
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

    def _read(self, snapshot: Snapshot, fragments: Sequence[Fragment]) -> Coded:
        """Read what the last version has not; anew where files were replaced meanwhile."""
        codebook = codebook_of(self.path, snapshot)
        files = files_of(self.path, codebook.hash, snapshot.version)
        last = self._last.parts if self._last and self._last.codebook.hash == codebook.hash else {}
        keys = _keys(one for one in fragments if one.data in files)
        try:
            parts = {key: last[key] if key in last else _part(codebook, key, files) for key in keys}
        except FormatError:
            now = codebook_of(self.path, snapshot)
            if (now.hash, files_of(self.path, now.hash, snapshot.version)) == (codebook.hash, files):
                raise
            return self._read(snapshot, fragments)
        return Coded(codebook, parts, tuple(one for one in fragments if one.data not in files))


def has_codebook(path: Path) -> bool:
    return (path / FOLDER / CODEBOOK).exists()


def codebook_of(path: Path, snapshot: Snapshot) -> Codebook:
    """Read the codebook of a catalogue. Raises: FormatError: damaged, or of another encoder."""
    file = path / FOLDER / CODEBOOK
    try:
        codebook = load_codebook(file)
    except (FormatError, InputError) as error:
        raise FormatError(f"{error}: {CURE}") from error
    if not snapshot.encoder.matches(codebook.encoder):
        raise FormatError(f"{file}: a codebook of {codebook.encoder.name}, not of this table's encoder: {CURE}")
    return codebook


def listed(folder: Path) -> Iterator[tuple[Path, str, int]]:
    """Yield each file of codes, the name of its rows' file, and the version of which it has all rows."""
    for name in sorted(os.listdir(folder) if folder.is_dir() else ()):
        stem, _, version = name.removesuffix(SUFFIX).rpartition(".")
        if name.endswith(SUFFIX) and version.isdecimal():
            yield folder / name, stem, int(version)


def files_of(path: Path, codebook: str, version: int) -> dict[str, Path]:
    """Return the file of codes by the name of its rows' file, of those that have all rows of a version."""
    return {name: file for file, name, first in listed(path / FOLDER / codebook) if first <= version}


def _keys(fragments: Iterable[Fragment]) -> list[Key]:
    """Return fragments in groups: a large one alone, small ones that follow each other."""
    keys: list[list[Fragment]] = []
    for fragment in fragments:
        if not keys or sum(one.num_rows for one in keys[-1]) + fragment.num_rows > ROWS_OF_PART:
            keys.append([])
        keys[-1].append(fragment)
    return [tuple(key) for key in keys]


def _part(codebook: Codebook, key: Key, files: Mapping[str, Path]) -> Part:
    """Read the codes of some fragments; those of one are mapped, those of several are put together in memory."""
    parts = [read_part(codebook, fragment, files[fragment.data]) for fragment in key]
    return parts[0] if len(parts) == 1 else joined(codebook, parts)


def joined(codebook: Codebook, parts: Sequence[Part]) -> Part:
    plain = Codes(np.concatenate([part.code.codes().codes for part in parts]))
    norms = np.concatenate([part.code.inverse_norms for part in parts])
    return Part(pq_code(codebook, plain, norms), np.concatenate([part.row_ids for part in parts]))


def read_part(codebook: Codebook, fragment: Fragment, file: Path) -> Part:
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


REFINE_FACTOR = 4  # candidates compared exactly, per wanted object; of large tables more
LARGE_ROWS = 750_000  # from here on the factor grows with the root of the rows
FEW_ROWS = 20_000  # that meet a condition: comparing them all is quicker than the codes of all


class Search(NamedTuple):
    """Search for objects. vector: of unit length; where: SQL, "" for all; wanted: number of objects."""

    vector: Embedding
    where: str
    wanted: int
    threads: int


class Nearest(NamedTuple):
    """Objects of the highest cosines, as an Arrow table, and their descriptors. is_exact: all were compared."""

    rows: Any
    described: Described
    is_exact: bool


def nearest_objects(snapshot: Snapshot, codes: Coded | None, search: Search) -> Nearest:
    """Return the objects of the highest cosines, by codes where there are some and many objects are looked at."""
    allowed = snapshot.row_ids(search.where) if codes and search.where else None
    if codes is None or (allowed is not None and len(allowed) <= FEW_ROWS):
        rows = snapshot.nearest(search.vector, search.where, search.wanted)
        return Nearest(rows, described_of(rows["descriptors"], snapshot.path), is_exact=True)
    parts = [_by_codes(snapshot, codes, search, allowed)]
    if codes.without:
        own = " OR ".join(fragment.sql for fragment in codes.without)
        parts.append(snapshot.nearest(search.vector, f"({own}) AND {search.where or 'true'}", search.wanted))
    rows, described = _best(snapshot, parts, search)
    return Nearest(rows, described, is_exact=False)


def _by_codes(snapshot: Snapshot, codes: Coded, search: Search, allowed: Indices | None) -> Any:
    """Return the rows of the best codes, several for each that is wanted; codes of deleted ones are passed over."""
    least = count = refine_factor(snapshot.num_rows) * search.wanted
    while True:
        found = codes.nearest(search.vector, count, allowed, search.threads)
        rows = snapshot.take(found.row_ids)
        if found.is_all or rows.num_rows >= least:
            return rows
        count *= 2


def refine_factor(rows: int) -> int:
    """Return how many candidates are compared for each wanted object: of more rows codes put more before the best."""
    return max(REFINE_FACTOR, round(REFINE_FACTOR * math.sqrt(rows / LARGE_ROWS)))


def _best(snapshot: Snapshot, parts: list[Any], search: Search) -> tuple[Any, Described]:
    _, pa = libraries()
    rows = pa.concat_tables(parts)
    row_ids = np.asarray(rows[ROW_ID]).astype(np.int64)
    cosines = cosines_of(rows["descriptors"], search.vector, snapshot.path)
    rows = rows.take(np.lexsort((row_ids, -cosines))[: search.wanted])
    return rows, described_of(rows["descriptors"], snapshot.path)
