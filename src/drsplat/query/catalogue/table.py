"""Changes of a catalogue's table: scenes come and go, files are put together, the index is built.

The table is in LanceDB's layout; docs/catalogue.md has its columns. Every change is one version, and readers see one
version: never half of a change.
"""

import math
import os
import warnings
from contextlib import AbstractContextManager, ExitStack, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

from ...errors import DrSplatWarning, FormatError, InputError
from ...formats.claiming import claimed_output
from ...scene.encoders import EncoderIdentity
from . import coding
from .codes import CODEBOOK, FOLDER, codebook_of, has_codebook
from .entries import of_scene
from .record import RECORD, read_record, verify_record, write_record
from .schema import HEAD, libraries, reading, schema_of, writing
from .snapshot import NAME, Snapshot, current, folder_of, latest

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
            coding.carry(before, snapshot, codebook)
        coding.write_missing(snapshot, codebook, most_rows)


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
    if snapshot is None or (not _is_scattered(snapshot) and coding.is_whole(snapshot)):
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
                coding.sweep(path, codebook_of(path, snapshot), folder_of(path) / "data")
        except InputError as error:
            warnings.warn(f"files were not put together: {error}", DrSplatWarning, stacklevel=3)


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
    codebook = coding.trained(snapshot)
    coding.write_missing(snapshot, codebook, ALL_ROWS, anew=True)
    _index_names(path)
    with claimed_output(path, PATIENCE_S):
        now = latest(path)
        assert now is not None
        coding.write_missing(now, codebook, ALL_ROWS)
        coding.publish(path, codebook)
        record(path)
    coding.sweep(path, codebook, folder_of(path) / "data")


def _index_names(path: Path) -> None:
    from lancedb.index import BTree

    snapshot = latest(path)
    assert snapshot is not None
    with writing(path):
        snapshot.table.create_index("scene", config=BTree(), replace=True)
        if any(index.name == FORMER_INDEX for index in snapshot.table.list_indices()):
            snapshot.table.drop_index(FORMER_INDEX)
