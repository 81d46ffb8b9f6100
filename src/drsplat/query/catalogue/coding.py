"""Codes of a catalogue's descriptors are written: those that are missing, and those of rows that were put together."""

import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...field.codes import PQ, Codebook, Codes, load_codebook, pq_code, save_codebook, train_codebook
from ...formats.tensors import read_tensors, write_tensors
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
)  # fmt: skip
from .record import Fragment
from .snapshot import Snapshot

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
