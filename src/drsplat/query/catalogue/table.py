"""Changes of a catalogue's table: scenes come and go, files are put together, the index is built.

The table is in LanceDB's layout; docs/catalogue.md has its columns. Every change is one version, and readers see one
version: never half of a change.

Codes of a catalogue's descriptors are written: those that are missing, and those of rows that were put together.
"""

import math
import os
import shutil
from collections.abc import Iterable
from contextlib import AbstractContextManager, ExitStack, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, InputError, warn
from ...field.codes import PQ, Codebook, Codes, load_codebook, pq_code, save_codebook, train_codebook
from ...formats.replacing import claimed_output
from ...formats.tensors import read_tensors, write_tensors
from ...scene.encoders import EncoderIdentity
from .codes import (
    CODEBOOK,
    CURE,
    FOLDER,
    FORMAT,
    SUFFIX,
    Part,
    among,
    codebook_of,
    files_of,
    has_codebook,
    joined,
    listed,
    read_part,
)
from .entries import of_scene
from .record import RECORD, Fragment, read_record, verify_record, write_record
from .snapshot import HEAD, NAME, Snapshot, current, folder_of, latest, libraries, reading, schema_of, writing

TRAINING_ROWS = 8192  # objects whose descriptors a codebook is trained on
ROWS_AT_ONCE = 8192  # of which descriptors are in memory while they are encoded


def trained(snapshot: Snapshot, threads: int = 0) -> Codebook:
    """Train a codebook on the descriptors of objects spread over the table."""
    sample = snapshot.spread(TRAINING_ROWS).descriptors
    return train_codebook(sample, PQ().parts(snapshot.encoder.dim), encoder=snapshot.encoder, threads=threads)


def write_missing(snapshot: Snapshot, codebook: Codebook, most_rows: int, anew: bool = False) -> None:
    """Encode the fragments of a version that have no codes yet, of up to `most_rows` each; `anew`: all of them.

    Several processes may do so at once: each file is written whole, and both write the same.
    """
    folder = snapshot.path / FOLDER / codebook.hash
    folder.mkdir(parents=True, exist_ok=True)
    files = files_of(snapshot.path, codebook.hash, snapshot.version)
    for fragment in snapshot.fragments or ():
        if anew or (fragment.data not in files and fragment.num_rows <= most_rows):
            _write(snapshot, fragment, _encoded(snapshot, fragment, codebook))


def carry(before: Snapshot, after: Snapshot, codebook: Codebook) -> None:
    """Write the codes of fragments that were put together from those of others, if the rows are the same in one order.

    What this cannot do, `write_missing` does: it takes the time of encoding anew.
    """
    files, there = (files_of(one.path, codebook.hash, one.version) for one in (before, after))
    former, present = before.fragments or [], after.fragments or []
    gone = [one for one in former if one not in present]
    new = [one for one in present if one not in former and one.data not in there]
    if not new or not gone or any(one.data not in files for one in gone):
        return
    (old_ids, old_heads), (new_ids, new_heads) = before.heads(gone), after.heads(new)
    if not old_heads.equals(new_heads):
        return
    part = joined(codebook, [read_part(codebook, one, files[one.data]) for one in gone])
    alive = np.flatnonzero(among(part.row_ids, old_ids))
    row_ids = new_ids[np.searchsorted(old_ids, part.row_ids[alive])]
    for fragment in new:
        own = (row_ids >= fragment.first) & (row_ids < fragment.first + fragment.num_rows)
        _write(after, fragment, Part(part.code.rows(alive[own]), row_ids[own]))


def publish(path: Path, codebook: Codebook) -> None:
    """Write the codebook, from when on its codes are searched."""
    save_codebook(codebook, path / FOLDER / CODEBOOK, overwrite=True)


def is_whole(snapshot: Snapshot) -> bool:
    """Return whether all fragments of a version have codes, or there is no index."""
    if not has_codebook(snapshot.path):
        return True
    files = files_of(snapshot.path, codebook_of(snapshot.path, snapshot).hash, snapshot.version)
    return all(fragment.data in files for fragment in snapshot.fragments or ())


def sweep(path: Path, codebook: Codebook, data: Path) -> None:
    """Remove codes of other codebooks, and of rows that are no longer there; only one process may do so at a time."""
    for folder in (path / FOLDER).iterdir():
        if folder.is_dir() and folder.name != codebook.hash:
            shutil.rmtree(folder, ignore_errors=True)
    there = {file.name for file in data.iterdir()}
    _remove(file for file, name, _ in listed(path / FOLDER / codebook.hash) if name not in there)


def verify_codes(path: Path) -> list[str]:
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


def _write(snapshot: Snapshot, fragment: Fragment, part: Part) -> None:
    """Write the codes of all rows of a fragment that a version has, in place of others."""
    code = part.code
    folder = snapshot.path / FOLDER / code.codebook.hash
    written = folder / f"{fragment.data}.{snapshot.version}{SUFFIX}"
    rows = (part.row_ids - fragment.first).astype(np.uint32)
    tensors = {"grouped_codes": code.grouped, "inverse_norms": code.inverse_norms, "rows": rows}
    about = {"format": FORMAT, "codebook": code.codebook.hash, "data": fragment.data}
    write_tensors(written, tensors, about, overwrite=True)
    _remove(path for path in folder.glob(f"{fragment.data}.*{SUFFIX}") if path != written)


def _encoded(snapshot: Snapshot, fragment: Fragment, codebook: Codebook) -> Part:
    codes, rows = [np.empty((0, codebook.num_subvectors), np.uint8)], [np.empty(0, np.int64)]
    for begin in range(fragment.first, fragment.first + fragment.num_rows, ROWS_AT_ONCE):
        end = min(begin + ROWS_AT_ONCE, fragment.first + fragment.num_rows)
        row_ids, described = snapshot.described(np.arange(begin, end))
        codes.append(codebook.encode(described.descriptors).codes)
        rows.append(np.repeat(row_ids, np.diff(described.starts)))
    return Part(pq_code(codebook, Codes(np.concatenate(codes))), np.concatenate(rows))


FORMER_INDEX = "descriptors_idx"  # of LanceDB, that earlier versions have built
ADDED_ROWS = 65_536  # of files whose codes are written with them; those of larger ones by `tidy`
MAX_FRAGMENTS = 24  # small files of rows until they are merged; more in large tables
CONFLICT = "Retryable commit conflict"  # LanceDB's message where another change was quicker
OUTDATED = timedelta(hours=1)  # age of versions to delete
PATIENCE_S = 60.0  # that one writer waits for another
ALL_ROWS = 1 << 32  # more than a file has


def state_of(path: Path) -> object:
    """Return what differs after every change of a catalogue, of its record or of its codebook; quick."""
    versions = folder_of(path) / "_versions"
    names = sorted(os.listdir(versions)) if versions.is_dir() else []
    return names, [_identity_of(file) for file in (path / RECORD, path / FOLDER / CODEBOOK)]


def _identity_of(file: Path) -> tuple[int, ...]:
    try:
        status = file.stat()
    except OSError:
        return ()
    return status.st_ino, status.st_size, status.st_mtime_ns


def verify(path: Path) -> list[str]:
    """Compare every byte of a catalogue with its record; return the names of the files. Raises: as `current`."""
    snapshot = current(path)
    return [] if snapshot is None else verify_record(path, folder_of(path))


def record(path: Path, added: str = "", removed: str = "") -> None:
    """Record the latest version of the table; the caller must hold the writer's lock.

    added, removed: the scene that was added or removed.
    """
    before, snapshot = read_record(path), latest(path)
    if snapshot is not None:
        gone = {*(before.removed if before else ()), removed} - {added, ""}
        write_record(path, folder_of(path), snapshot.version, gone)


def was_removed(path: Path, name: str) -> bool:
    """Return whether a scene of this name was removed, and not added since."""
    before = read_record(path)
    return before is not None and name in before.removed


def replace_scene(path: Path, name: str, rows: Any, encoder: EncoderIdentity) -> None:
    """Replace all rows of a scene, in one version; make the table if there is none."""
    lancedb, _ = libraries()
    snapshot = current(path)
    with writing(path):
        if snapshot is None:
            lancedb.connect(path).create_table(NAME, data=rows, schema=schema_of(encoder))
        else:
            merge = snapshot.table.merge_insert(list(HEAD)).when_matched_update_all().when_not_matched_insert_all()
            merge.when_not_matched_by_source_delete(of_scene(name)).execute(rows)
    _write_codes(path, ADDED_ROWS)
    record(path, added=name)


def _write_codes(path: Path, most_rows: int, before: Snapshot | None = None) -> None:
    """Write the codes that the latest version lacks, if there is an index. before: has codes of moved rows."""
    snapshot = latest(path)
    if snapshot is not None and has_codebook(path):
        codebook = codebook_of(path, snapshot)
        if before is not None:
            carry(before, snapshot, codebook)
        write_missing(snapshot, codebook, most_rows)


def remove_scene(path: Path, name: str) -> None:
    """Delete all rows of a scene. The name is recorded first, so that a kill at any moment does not lose it."""
    record(path, removed=name)
    snapshot = latest(path)
    assert snapshot is not None
    with writing(path):
        snapshot.table.delete(of_scene(name))
    record(path, removed=name)


def tidy(path: Path) -> None:
    """Merge small files of rows, write codes that are missing, and delete old versions, when due.

    It rewrites up to a million rows, so it is due once in every root of the rows / 4 changes. No writer waits for it: a
    change that is made meanwhile is kept, and where both have the same rows this is left to the next one. Other
    failures are warnings: the change before it has been made.
    """
    snapshot = current(path)
    if snapshot is None or (not _is_scattered(snapshot) and is_whole(snapshot)):
        return
    with ExitStack() as stack:
        try:
            stack.enter_context(arranging(path))
        except InputError:  # another process does it
            return
        try:
            before = latest(path)  # the other one goes on to later versions
            if _is_scattered(snapshot):
                _put_together(snapshot)
            _write_codes(path, ALL_ROWS, before)
            _record_arranged(path)
            if has_codebook(path):
                sweep(path, codebook_of(path, snapshot), folder_of(path) / "data")
        except InputError as error:
            warn(f"files were not put together: {error}", 3)


def _record_arranged(path: Path) -> None:
    """Record the merged files; writers wait while they are read."""
    with claimed_output(path, PATIENCE_S):
        record(path)


def arranging(path: Path, patience: float = 0.0) -> AbstractContextManager[None]:
    """Take the lock for merging files and building the index; other processes can add and remove.

    Raises: InputError: another process has it.
    """
    return claimed_output(path.with_name(f"{path.name}.tidy"), patience)


def _is_scattered(snapshot: Snapshot) -> bool:
    with reading(snapshot.path):
        small = int(snapshot.table.stats()["fragment_stats"]["num_small_fragments"])
    return small > max(MAX_FRAGMENTS, math.isqrt(snapshot.num_rows) // 4)


def _put_together(snapshot: Snapshot) -> None:
    try:
        with writing(snapshot.path):
            snapshot.table.optimize(cleanup_older_than=OUTDATED)
    except InputError as error:
        if CONFLICT not in str(error):
            raise


def index(path: Path) -> None:
    """Merge files of rows, write codes of all descriptors by a new codebook, and build the index of scenes' names.

    A query reads rows of many files more slowly. Others write meanwhile: what they have written is coded in their turn,
    before the codebook takes the place of a former one.
    """
    before = latest(path)
    assert before is not None
    _put_together(before)
    with suppress(FormatError):  # damaged codes, which are written anew
        _write_codes(path, ALL_ROWS, before)
    _record_arranged(path)
    snapshot = current(path)
    assert snapshot is not None
    codebook = trained(snapshot)
    write_missing(snapshot, codebook, ALL_ROWS, anew=True)
    _index_names(path)
    with claimed_output(path, PATIENCE_S):
        now = latest(path)
        assert now is not None
        write_missing(now, codebook, ALL_ROWS)
        publish(path, codebook)
        record(path)
    sweep(path, codebook, folder_of(path) / "data")


def _index_names(path: Path) -> None:
    from lancedb.index import BTree

    snapshot = latest(path)
    assert snapshot is not None
    with writing(path):
        snapshot.table.create_index("scene", config=BTree(), replace=True)
        if any(index.name == FORMER_INDEX for index in snapshot.table.list_indices()):
            snapshot.table.drop_index(FORMER_INDEX)
