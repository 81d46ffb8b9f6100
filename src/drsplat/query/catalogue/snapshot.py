"""One version of a catalogue's table, to be read.

Columns of a catalogue's table, rows of them, and descriptors in a byte for each number.

LanceDB and Arrow, imported where a catalogue needs them, and their errors in our words.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Array, Embedding, Embeddings, Indices, Int8, Numbers, OtherIndices
from ...errors import DrSplatError, FormatError, InputError, MismatchError, MissingExtraError, pip_install
from ...formats.json_files import as_fields, document_in
from ...scene.encoders import EncoderIdentity, identity_json, identity_text
from ..ranking import Described
from .record import Fragment, fragments_of, manifest_of, read_record

PANICS = ("PanicException", "RustPanic")  # of Rust, on unexpected contents
INDEX_CACHE_BYTES, METADATA_CACHE_BYTES = 512 << 20, 256 << 20
CURE = "the table is damaged: restore it from a copy, or remove the folder and add its scenes again"


def libraries() -> tuple[Any, Any]:
    """Import LanceDB and Arrow. Raises: MissingExtraError: they are not installed."""
    try:
        import lancedb
        import pyarrow
    except ImportError as error:
        raise MissingExtraError(f"a catalogue needs LanceDB ({error}): {pip_install('catalogue')}") from error
    return lancedb, pyarrow


@cache
def session() -> Any:
    """Return the cache that all queries of this process share; without it each would read the index anew."""
    lancedb, _ = libraries()
    return lancedb.Session(INDEX_CACHE_BYTES, METADATA_CACHE_BYTES)


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


KEY = b"drsplat catalogue"  # of the table's metadata
VERSION = 4
MAX_DIM = 1 << 16
LARGEST = 127  # of a descriptor's numbers, as it is stored
AT_ONCE = 128  # descriptors that are compared while they are in a processor's cache
HEAD = ("scene", "tile", "object_id")  # key of a row
COMPARED = ("scene", "object_id", "descriptors")  # columns that a search reads of every object that it compares


def schema_of(encoder: EncoderIdentity) -> Any:
    """Return the columns of a catalogue of one encoder."""
    _, pa = libraries()
    vectors = pa.list_(pa.list_(pa.int8(), encoder.dim))
    # Compressed, a sketch would be a twentieth smaller, and read twice as slowly.
    sketch = pa.field("sketch", pa.binary(), metadata={"lance-encoding:compression": "none"})
    texts = dict.fromkeys(("label", "name", "photo", "folder"), pa.string())
    places = dict.fromkeys(("x", "y", "z", "longitude", "latitude", "height"), pa.float64())
    columns = {
        "scene": pa.string(), "tile": pa.int32(), "object_id": pa.int32(), "field": pa.string(),
        "added": pa.timestamp("ms", tz="UTC"), **places, "axes": pa.list_(pa.float32(), 9),
        "extent": pa.list_(pa.float32(), 3), "num_gaussians": pa.int32(), "num_views": pa.int32(),
        "sure": pa.float32(), "mask": pa.int32(), **texts, "descriptors": vectors, "thumbnail": pa.binary(),
    }  # fmt: skip
    about = {"version": VERSION, "encoder": identity_json(encoder)}
    return pa.schema([*columns.items(), sketch], metadata={KEY: json.dumps(about)})


def batch(columns: Mapping[str, Sequence[Any]], descriptors: Sequence[Array], encoder: EncoderIdentity) -> Any:
    """Return rows as an Arrow table; missing columns are null. descriptors: of each row (k, D), of any length.

    Raises: InputError: a descriptor without a direction.
    """
    _, pa = libraries()
    schema = schema_of(encoder)
    flat = _stored(np.concatenate([np.empty((0, encoder.dim), np.float32), *descriptors], dtype=np.float32))
    starts = np.append(0, np.cumsum([len(rows) for rows in descriptors]))
    vectors = pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), encoder.dim)
    arrays = {"descriptors": pa.ListArray.from_arrays(pa.array(starts, pa.int32()), vectors)}
    nothing = [None] * len(descriptors)
    for column in schema:
        if column.name not in arrays:
            arrays[column.name] = pa.array(columns.get(column.name, nothing), column.type)
    return pa.table([arrays[name] for name in schema.names], schema=schema)


def _stored(vectors: Embeddings) -> Int8[Array, "n D"]:
    """Return directions in a byte for each number, the largest of a vector 127: their lengths need no room.

    Raises: InputError: numbers that are not finite, or a vector without a direction.
    """
    largest = np.abs(vectors).max(1, initial=0, keepdims=True)
    if not (np.isfinite(largest) & (largest > 0)).all():
        raise InputError("descriptors: expected finite vectors, none of them zero")
    return np.asarray(np.rint(vectors * (LARGEST / largest)), np.int8)


def described_of(column: Any, path: Path) -> Described:
    """Return the descriptors of each row, brought back to unit length. Raises: FormatError: some have no direction."""
    numbers, starts = _numbers_of(column, path)
    vectors = numbers.astype(np.float32)
    return Described(vectors / _lengths(vectors, path)[:, None], starts)


def cosines_of(column: Any, vector: Embedding, path: Path) -> Numbers:
    """Return the highest cosine of a unit vector with a descriptor of each row, -inf for rows without any.

    Raises: FormatError: some have no direction.
    """
    numbers, starts = _numbers_of(column, path)
    cosines = np.empty(len(numbers), np.float32)
    for begin in range(0, len(numbers), AT_ONCE):
        run = slice(begin, begin + AT_ONCE)
        vectors = numbers[run].astype(np.float32)
        cosines[run] = np.einsum("pd,d->p", vectors, vector) / _lengths(vectors, path)
    best = np.full(len(starts) - 1, -np.inf, np.float32)
    (shown,) = np.nonzero(np.diff(starts))
    if len(shown):
        best[shown] = np.maximum.reduceat(cosines, starts[shown])
    return best


def _numbers_of(column: Any, path: Path) -> tuple[Int8[Array, "P D"], Indices]:
    """Return the descriptors as they are stored; row i has those from starts[i] to starts[i + 1]."""
    _, pa = libraries()
    lists = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    lengths = np.asarray(lists.value_lengths().fill_null(0), np.int64)
    vectors = lists.flatten()
    numbers = np.asarray(vectors.flatten(), np.int8).reshape(-1, vectors.type.list_size)
    if len(numbers) != lengths.sum():
        raise _without_direction(path)
    return numbers, np.append(0, np.cumsum(lengths))


def _lengths(vectors: Embeddings, path: Path) -> Numbers:
    lengths = np.sqrt(np.einsum("pd,pd->p", vectors, vectors))
    if not (lengths > 0).all():
        raise _without_direction(path)
    return np.asarray(lengths)


def _without_direction(path: Path) -> FormatError:
    return FormatError(f"{path}: descriptors without a direction: {CURE}")


def encoder_of(path: Path, schema: Any) -> EncoderIdentity:
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
        document = as_fields(document_in(about or b"", str(path)), str(path), version=object, encoder=EncoderIdentity)
        encoder, version = document["encoder"], document["version"]
        if not 1 <= encoder.dim <= MAX_DIM:
            raise FormatError(f"encoder of {encoder.dim} dimensions")
    except FormatError as error:
        raise FormatError(f"{path}: a LanceDB table, but not of a catalogue that drsplat made") from error
    if version != VERSION:
        cure = (
            "remove the folder and add its scenes again"
            if version in range(1, VERSION)
            else "install the drsplat that made it"
        )
        raise FormatError(f"{path}: a catalogue of version {version!a:.20}; this drsplat reads {VERSION}: {cure}")
    return encoder  # type: ignore[no-any-return]


NAME = "objects"
OF_OBJECTS = "object_id >= 0"
ROW_ID = "_rowid"
ROWS_AT_ONCE = 8192  # of which descriptors are in memory while all are compared


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

    @cached_property
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
        manifest = manifest_of(folder_of(self.path), self.version)
        if manifest is None:
            raise FormatError(f"{self.path}: {CURE} (a manifest is missing)")
        return fragments_of(manifest)

    @cached_property
    def own_rows(self) -> dict[str, int]:
        """Per scene the id of its row that is of no object."""
        with reading(self.path):
            rows = self.table.search().where("object_id = -1").select(["scene"]).with_row_id(True).to_arrow()
            return dict(zip(rows["scene"].to_pylist(), rows[ROW_ID].to_pylist(), strict=True))

    def nearest(self, vector: Embedding, where: str, count: int) -> Any:
        """Return the objects whose descriptors have the highest cosines with a unit vector, all compared.

        where: SQL that they meet, "" for all.
        """
        ids, cosines = np.empty(0, np.int64), np.empty(0, np.float32)
        with reading(self.path):
            search = self.table.search().where(f"{OF_OBJECTS} AND {where}" if where else OF_OBJECTS)
            for rows in search.select(["descriptors"]).with_row_id(True).to_batches(ROWS_AT_ONCE):
                ids = np.append(ids, np.asarray(rows[ROW_ID]).astype(np.int64))
                cosines = np.append(cosines, cosines_of(rows["descriptors"], vector, self.path))
                best = np.lexsort((ids, -cosines))[:count]
                best = best[np.isfinite(cosines[best])]
                ids, cosines = ids[best], cosines[best]
        return self.take(np.sort(ids))

    def row_ids(self, where: str) -> Indices:
        """Return the ids of the objects that meet a condition, ascending."""
        with reading(self.path):
            search = self.table.search().where(f"{OF_OBJECTS} AND {where}").select(["object_id"])
            return np.sort(np.asarray(search.with_row_id(True).to_arrow()[ROW_ID]).astype(np.int64))

    def take(self, row_ids: Indices, columns: Sequence[str] = COMPARED) -> Any:
        """Return some columns of rows, and their ids, ascending; those that were deleted are left out."""
        with reading(self.path):
            if not len(row_ids):
                return self.table.search().where("false").select(list(columns)).with_row_id(True).to_arrow()
            return self.table.take_row_ids(row_ids.tolist()).select(list(columns)).with_row_id().to_arrow()

    def heads(self, fragments: Sequence[Fragment]) -> tuple[Indices, Any]:
        """Return the ids of the rows of some fragments, ascending, and their keys."""
        with reading(self.path):
            search = self.table.search().where(" OR ".join(one.sql for one in fragments)).select(list(HEAD))
            found = search.with_row_id(True).to_arrow().sort_by(ROW_ID)
            return np.asarray(found[ROW_ID]).astype(np.int64), found.select(list(HEAD))

    def described(self, row_ids: OtherIndices) -> tuple[Indices, Described]:
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


def current(path: Path) -> Snapshot | None:
    """Return the current version of the table, compared with its record; None if there is none yet.

    Raises: FormatError: the folder holds something else, or is damaged. MissingExtraError.
    """
    while True:
        record = read_record(path)  # before the table is opened, so that the record is never newer
        if record is None:
            return latest(path)
        record.check_files(folder_of(path))
        snapshot = latest(path)
        if snapshot is None:
            raise FormatError(f"{path}: {CURE} (the versions of its table are missing)")
        try:
            record.check_version(folder_of(path), snapshot.version)
        except FormatError:
            again = latest(path)
            if again is None or again.version == snapshot.version:
                raise
            continue  # another version was written meanwhile, and files of this one were deleted
        return snapshot


def folder_of(path: Path) -> Path:
    return path / f"{NAME}.lance"


def latest(path: Path) -> Snapshot | None:
    """Return the latest version of the table, whatever its record says; None if there is none. Raises: FormatError."""
    lancedb, _ = libraries()
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return None
    if not folder_of(path).is_dir():
        raise FormatError(
            f"{path}: expected a catalogue, a folder with {NAME}.lance: `drsplat catalogue add` makes one"
        )
    if _is_unfinished(folder_of(path)):
        return None
    with reading(path):
        table = lancedb.connect(path, session=session()).open_table(NAME)
        schema = table.schema
    return Snapshot(path, table, encoder_of(path, schema))


def _is_unfinished(table: Path) -> bool:
    """Return whether no version was finished: its writer was killed, and the next one starts anew."""
    changes = (change.name for change in table.glob("_transactions/*"))
    return not any(table.glob("_versions/*.manifest")) and all(name.startswith("0-") for name in changes)
