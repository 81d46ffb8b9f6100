"""Table of a catalogue: the only module that uses LanceDB and Arrow.

A folder in LanceDB's layout with one table, `objects`; docs/catalogue.md has its columns. Every change is one version,
and readers see one version: never half of a change.
"""

import json
import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Float32, Int64
from ...errors import DrSplatError, DrSplatWarning, FormatError, InputError, MismatchError, MissingExtraError
from ...formats.claiming import claimed_output
from ...scene.encoders import EncoderIdentity, identity_json, identity_text
from ..ranking import Described
from . import codes
from .conditions import of_scene
from .manifest import Fragment, fragments_of, manifest_of
from .record import RECORD, read_record, verify_record, write_record

NAME, KEY = "objects", b"drsplat catalogue"
VERSION = 2
MAX_DIM = 1 << 16
FORMER_INDEX = "descriptors_idx"  # of LanceDB, that earlier versions have built
ADDED_ROWS = 65_536  # of files whose codes are written with them; those of larger ones by `tidy`
MAX_FRAGMENTS = 24  # small files of rows until they are merged; more in large tables
CONFLICT = "Retryable commit conflict"  # LanceDB's message where another change was quicker
PANICS = ("PanicException", "RustPanic")  # of Rust, on unexpected contents
OUTDATED = timedelta(hours=1)  # age of versions to delete
OF_OBJECTS = "object_id >= 0"
PATIENCE_S = 60.0  # that one writer waits for another
INDEX_CACHE, METADATA_CACHE = 512 << 20, 256 << 20  # bytes
HEAD = ("scene", "tile", "object_id")  # key of a row
COMPARED = (*HEAD, "descriptors")  # columns that a search reads of every object that it compares
ALL_ROWS = 1 << 32  # more than a file has
ROW_ID = "_rowid"


def libraries() -> tuple[Any, Any]:
    """Import LanceDB and Arrow. Raises: MissingExtraError: they are not installed."""
    try:
        import lancedb
        import pyarrow
    except ImportError as error:
        raise MissingExtraError(f'a catalogue needs LanceDB ({error}): pip install "drsplat[catalogue]"') from error
    return lancedb, pyarrow


@cache
def _session() -> Any:
    """Return the cache that all queries of this process share; without it each would read the index anew."""
    lancedb, _ = libraries()
    return lancedb.Session(INDEX_CACHE, METADATA_CACHE)


def schema_of(encoder: EncoderIdentity) -> Any:
    """Return the columns of a catalogue of one encoder."""
    _, pa = libraries()
    vectors = pa.list_(pa.list_(pa.float16(), encoder.dim))
    texts = dict.fromkeys(("label", "name", "photo", "folder"), pa.string())
    places = dict.fromkeys(("x", "y", "z", "longitude", "latitude", "height"), pa.float64())
    columns = {
        "scene": pa.string(), "tile": pa.int32(), "object_id": pa.int32(), "field": pa.string(),
        "added": pa.timestamp("ms", tz="UTC"), **places, "axes": pa.list_(pa.float64(), 9),
        "extent": pa.list_(pa.float64(), 3), "num_gaussians": pa.int32(), "num_views": pa.int32(),
        "sure": pa.float32(), "mask": pa.int32(), **texts, "descriptors": vectors, "thumbnail": pa.binary(),
        "sketch": pa.binary(),
    }  # fmt: skip
    about = {"version": VERSION, "encoder": identity_json(encoder)}
    return pa.schema(list(columns.items()), metadata={KEY: json.dumps(about)})


def batch(columns: Mapping[str, Sequence[Any]], descriptors: Sequence[np.ndarray], encoder: EncoderIdentity) -> Any:
    """Return rows as an Arrow table; missing columns are null. descriptors: of each row (k, D) float16."""
    _, pa = libraries()
    schema = schema_of(encoder)
    flat = np.concatenate([np.empty((0, encoder.dim), np.float16), *descriptors])
    starts = np.append(0, np.cumsum([len(rows) for rows in descriptors]))
    vectors = pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), encoder.dim)
    arrays = {"descriptors": pa.ListArray.from_arrays(pa.array(starts, pa.int32()), vectors)}
    nothing = [None] * len(descriptors)
    for column in schema:
        if column.name not in arrays:
            arrays[column.name] = pa.array(columns.get(column.name, nothing), column.type)
    return pa.table([arrays[name] for name in schema.names], schema=schema)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One version of the table, which never changes. encoder: of its descriptors."""

    path: Path
    table: Any
    encoder: EncoderIdentity

    def check_encoder(self, identity: EncoderIdentity) -> None:
        """Refuse an encoder with incompatible embeddings. Raises: MismatchError."""
        if not self.encoder.matches(identity):
            raise MismatchError(
                f"{self.path}: the descriptors of this catalogue are of {identity_text(self.encoder)}, given was "
                f"{identity_text(identity)}: a catalogue has one encoder; use that one, or another catalogue"
            )

    @property
    def version(self) -> int:
        with reading(self.path):
            return int(self.table.version)

    @cached_property
    def num_rows(self) -> int:
        with reading(self.path):
            return int(self.table.count_rows())

    def count(self, where: str) -> int:
        with reading(self.path):
            return int(self.table.count_rows(where))

    @cached_property
    def fragments(self) -> list[Fragment] | None:
        """Fragments of this version; None if its row ids are no addresses in them. Raises: FormatError."""
        manifest = manifest_of(_folder(self.path), self.version)
        if manifest is None:
            raise FormatError(f"{self.path}: {CURE} (a manifest is missing)")
        return fragments_of(manifest)

    def nearest(self, vector: Float32[np.ndarray, " D"], where: str, count: int) -> Any:
        """Return the objects whose descriptors have the highest cosines with a unit vector, all compared.

        where: SQL that they meet, "" for all.
        """
        with reading(self.path):
            search = self.table.search(vector, vector_column_name="descriptors", query_type="vector")
            # Rows of scenes have no descriptor, so the search skips them; filtering first takes as long as the search.
            search = search.where(f"{OF_OBJECTS} AND {where}" if where else OF_OBJECTS, prefilter=bool(where))
            search = search.distance_type("cosine").limit(count).bypass_vector_index()
            found = search.select([*COMPARED, "_distance"]).with_row_id(True).to_arrow()
            return found.select([*COMPARED, ROW_ID])

    def row_ids(self, where: str) -> Int64[np.ndarray, " r"]:
        """Return the ids of the objects that meet a condition, ascending."""
        with reading(self.path):
            search = self.table.search().where(f"{OF_OBJECTS} AND {where}").select(["object_id"])
            return np.sort(np.asarray(search.with_row_id(True).to_arrow()[ROW_ID]).astype(np.int64))

    def take(self, row_ids: Int64[np.ndarray, " r"], columns: Sequence[str] = COMPARED) -> Any:
        """Return some columns of rows, and their ids, ascending; those that were deleted are left out."""
        with reading(self.path):
            if not len(row_ids):
                return self.table.search().where("false").select(list(columns)).with_row_id(True).to_arrow()
            return self.table.take_row_ids(row_ids.tolist()).select(list(columns)).with_row_id().to_arrow()

    def heads(self, fragments: Sequence[Fragment]) -> tuple[Int64[np.ndarray, " r"], Any]:
        """Return the ids of the rows of some fragments, ascending, and their keys."""
        with reading(self.path):
            search = self.table.search().where(" OR ".join(one.sql for one in fragments)).select(list(HEAD))
            found = search.with_row_id(True).to_arrow().sort_by(ROW_ID)
            return np.asarray(found[ROW_ID]).astype(np.int64), found.select(list(HEAD))

    def described(self, row_ids: Int64[np.ndarray, " r"]) -> tuple[Int64[np.ndarray, " t"], Described]:
        """Return the descriptors of rows, and the ids of those that were not deleted."""
        taken = self.take(row_ids, ["descriptors"])
        return np.asarray(taken[ROW_ID]).astype(np.int64), described_of(taken["descriptors"], self.path)

    def spread(self, count: int) -> Described:
        """Return the descriptors of some rows, evenly spread over the table."""
        at = np.unique(np.linspace(0, self.num_rows - 1, min(count, self.num_rows)).astype(np.int64))
        with reading(self.path):
            taken = self.table.take_offsets(at.tolist()).select(["descriptors"]).to_arrow()
        return described_of(taken["descriptors"], self.path)

    def rows(self, where: str, columns: Sequence[str]) -> Any:
        with reading(self.path):
            return self.table.search().where(where).select(list(columns)).to_arrow()


def opened(path: Path) -> Snapshot | None:
    """Return the current version of the table, compared with its record; None if there is none yet.

    Raises: FormatError: the folder holds something else, or is damaged. MissingExtraError.
    """
    while True:
        record = read_record(path)  # before the table is opened, so that the record is never newer
        if record is None:
            return _opened(path)
        record.check_files(_folder(path))
        snapshot = _opened(path)
        if snapshot is None:
            raise FormatError(f"{path}: {CURE} (the versions of its table are missing)")
        try:
            record.check_version(_folder(path), snapshot.version)
        except FormatError:
            again = _opened(path)
            if again is None or again.version == snapshot.version:
                raise
            continue  # another version was written meanwhile, and files of this one were deleted
        return snapshot


def state_of(path: Path) -> object:
    """Return what differs after every change of a catalogue, of its record or of its codebook; quick."""
    versions = _folder(path) / "_versions"
    names = sorted(os.listdir(versions)) if versions.is_dir() else []
    return names, [_identity_of(file) for file in (path / RECORD, path / codes.FOLDER / codes.CODEBOOK)]


def _identity_of(file: Path) -> tuple[int, ...]:
    try:
        status = file.stat()
    except OSError:
        return ()
    return status.st_ino, status.st_size, status.st_mtime_ns


def verify(path: Path) -> list[str]:
    """Compare every byte of a catalogue with its record; return the names of the files. Raises: as `opened`."""
    snapshot = opened(path)
    return [] if snapshot is None else verify_record(path, _folder(path))


def record(path: Path, added: str = "", removed: str = "") -> None:
    """Record the latest version of the table; the caller must hold the writer's lock.

    added, removed: the scene that was added or removed.
    """
    before, snapshot = read_record(path), _opened(path)
    if snapshot is not None:
        gone = {*(before.removed if before else ()), removed} - {added, ""}
        write_record(path, _folder(path), snapshot.version, gone)


def was_removed(path: Path, name: str) -> bool:
    """Return whether a scene of this name was removed, and not added since."""
    before = read_record(path)
    return before is not None and name in before.removed


def _folder(path: Path) -> Path:
    return path / f"{NAME}.lance"


def _opened(path: Path) -> Snapshot | None:
    lancedb, _ = libraries()
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return None
    if not _folder(path).is_dir():
        raise FormatError(
            f"{path}: expected a catalogue, a folder with {NAME}.lance: `drsplat catalogue add` makes one"
        )
    if _is_unfinished(_folder(path)):
        return None
    with reading(path):
        table = lancedb.connect(path, session=_session()).open_table(NAME)
        schema = table.schema
    return Snapshot(path, table, _checked(path, schema))


def _is_unfinished(table: Path) -> bool:
    """Return whether no version was finished: its writer was killed, and the next one starts anew."""
    changes = (change.name for change in table.glob("_transactions/*"))
    return not any(table.glob("_versions/*.manifest")) and all(name.startswith("0-") for name in changes)


def replace_scene(path: Path, name: str, rows: Any, encoder: EncoderIdentity) -> None:
    """Replace all rows of a scene, in one version; make the table if there is none."""
    lancedb, _ = libraries()
    snapshot = opened(path)
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
    snapshot = _opened(path)
    if snapshot is not None and codes.has_codebook(path):
        codebook = codes.codebook_of(path, snapshot)
        if before is not None:
            codes.carry(before, snapshot, codebook)
        codes.write_missing(snapshot, codebook, most_rows)


def remove_scene(path: Path, name: str) -> None:
    """Delete all rows of a scene. The name is recorded first, so that a kill at any moment does not lose it."""
    record(path, removed=name)
    snapshot = _opened(path)
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
    snapshot = opened(path)
    if snapshot is None or (not _is_scattered(snapshot) and codes.is_whole(snapshot)):
        return
    with ExitStack() as stack:
        try:
            stack.enter_context(arranging(path))
        except InputError:  # another process does it
            return
        try:
            before = _opened(path)  # the other one goes on to later versions
            if _is_scattered(snapshot):
                _put_together(snapshot)
            _write_codes(path, ALL_ROWS, before)
            _record_arranged(path)
            if codes.has_codebook(path):
                codes.sweep(path, codes.codebook_of(path, snapshot), _folder(path) / "data")
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


def index(snapshot: Snapshot) -> None:
    """Write codes of all descriptors by a new codebook, and build the index of scenes' names; others write meanwhile.

    What they have written is coded in their turn, before the codebook takes the place of a former one.
    """
    path, codebook = snapshot.path, codes.trained(snapshot)
    codes.write_missing(snapshot, codebook, ALL_ROWS, anew=True)
    _index_names(path)
    with claimed_output(path, PATIENCE_S):
        latest = _opened(path)
        assert latest is not None
        codes.write_missing(latest, codebook, ALL_ROWS)
        codes.publish(path, codebook)
        record(path)
    codes.sweep(path, codebook, _folder(path) / "data")


def _index_names(path: Path) -> None:
    from lancedb.index import BTree

    snapshot = _opened(path)
    assert snapshot is not None
    with writing(path):
        snapshot.table.create_index("scene", config=BTree(), replace=True)
        if any(index.name == FORMER_INDEX for index in snapshot.table.list_indices()):
            snapshot.table.drop_index(FORMER_INDEX)


def described_of(column: Any, path: Path) -> Described:
    """Return the descriptors of each row, of unit length.

    Raises: FormatError: some that are not finite, or have no length.
    """
    lists = column.combine_chunks()
    lengths = np.asarray(lists.value_lengths().fill_null(0), np.int64)
    vectors = lists.flatten()
    flat = np.asarray(vectors.flatten(), np.float16).astype(np.float32).reshape(-1, vectors.type.list_size)
    norms = np.sqrt(np.einsum("pd,pd->p", flat, flat))
    if len(flat) != lengths.sum() or not (np.isfinite(norms) & (norms > 0.5) & (norms < 2)).all():
        raise FormatError(f"{path}: descriptors that are no unit vectors: {CURE}")
    return Described(flat / norms[:, None], np.append(0, np.cumsum(lengths)))


CURE = "the table is damaged: restore it from a copy, or remove the folder and add its scenes again"


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn errors of LanceDB into FormatErrors."""
    with _lance_errors(path):
        yield


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors of LanceDB into InputErrors: it could not write, and nothing has changed."""
    try:
        with _lance_errors(path):
            yield
    except FormatError as error:
        raise InputError(f"{path}: nothing was changed: {error.__cause__!s:.300}") from error


@contextmanager
def _lance_errors(path: Path) -> Iterator[None]:
    """Turn errors of LanceDB, Arrow and Rust into FormatErrors."""
    try:
        yield
    except DrSplatError:
        raise
    except (ValueError, RuntimeError, OSError) as error:  # Arrow's are among these
        raise FormatError(f"{path}: {CURE} ({type(error).__name__}: {error!s:.300})") from error
    except BaseException as error:
        if type(error).__name__ not in PANICS:
            raise
        raise FormatError(f"{path}: {CURE} ({error!s:.300})") from error


def _checked(path: Path, schema: Any) -> EncoderIdentity:
    """Return the encoder of the descriptors. Raises: FormatError: other columns than a catalogue has."""
    encoder = _identity(path, (schema.metadata or {}).get(KEY))
    expected = schema_of(encoder)
    if not schema.equals(expected):
        types = {column.name: column.type for column in schema}
        wrong = [column.name for column in expected if types.get(column.name) != column.type]
        raise FormatError(f"{path}: other columns than a catalogue's: {', '.join(wrong) or 'more of them'}")
    return encoder


def _identity(path: Path, about: bytes | None) -> EncoderIdentity:
    try:
        document = json.loads(about or b"null")
        encoder, version = document["encoder"], document["version"]
        texts = [encoder["name"], encoder["weights"], encoder.get("preprocessing", "")]
        dim = encoder["dim"]
        if type(dim) is not int or not 1 <= dim <= MAX_DIM or not all(type(text) is str for text in texts):
            raise ValueError("encoder")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path}: a LanceDB table, but not of a catalogue that drsplat made") from error
    if version != VERSION:
        cure = "remove the folder and add its scenes again" if version == 1 else "install the drsplat that made it"
        raise FormatError(f"{path}: a catalogue of version {version!a:.20}; this drsplat reads {VERSION}: {cure}")
    return EncoderIdentity(texts[0], dim, texts[1], texts[2])
