"""The table of a catalogue: all that knows LanceDB and Arrow.

A folder in LanceDB's layout with one table, `objects`; docs/catalogue.md has its columns. Every change is one version,
and who reads looks at one version: nobody sees half of a change.
"""

import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Float32
from ..encoders import EncoderIdentity, identity_json, identity_said
from ..errors import DrSplatError, DrSplatWarning, FormatError, InputError, MismatchError, MissingExtraError
from ..formats.claiming import claimed_output
from .conditions import of_scene
from .record import read_record, verify_record, write_record

NAME, KEY = "objects", b"drsplat catalogue"
VERSION = 2
MOST_DIM = 1 << 16
INDEX = "descriptors_idx"
LEARNED_FROM = 64  # descriptors of each partition: a quarter of LanceDB's, and of its time
MOST_PARTITIONS, LEAST_PROBES = 512, 64  # of an index; of these half are looked into, as words are far from all
REFINED = 2  # candidates compared exactly, for each wanted
FRAGMENTS = 24  # small files of rows from which they are put together, of large tables more
PREEMPTED = "Retryable commit conflict"  # LanceDB's words where a change was quicker
PANICS = ("PanicException", "RustPanic")  # of Rust, on what its readers did not expect
OUTDATED = timedelta(hours=1)  # versions that nobody reads any more
OF_OBJECTS = "object_id >= 0"
PATIENCE_S = 60.0  # that one writer waits for another
INDEX_CACHE, METADATA_CACHE = 512 << 20, 256 << 20  # bytes that queries find in memory
HEAD = ("scene", "tile", "object_id")  # what a row is known by
ROW_ID = "_rowid"


def libraries() -> tuple[Any, Any]:
    """LanceDB and Arrow. Raises: MissingExtraError: they are not installed."""
    try:
        import lancedb
        import pyarrow
    except ImportError as error:
        raise MissingExtraError(f'a catalogue needs LanceDB ({error}): pip install "drsplat[catalogue]"') from error
    return lancedb, pyarrow


@cache
def _session() -> Any:
    """What all queries of this process find in memory: else each would read its part of the index anew."""
    lancedb, _ = libraries()
    return lancedb.Session(INDEX_CACHE, METADATA_CACHE)


def schema_of(encoder: EncoderIdentity) -> Any:
    """The columns of a catalogue of one encoder."""
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
    """Rows as Arrow has them; columns that are missing are null. descriptors: of each row (k, D) float16."""
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
    """One version of the table, which stays as it is. encoder: who made its descriptors."""

    path: Path
    table: Any
    encoder: EncoderIdentity

    def check_encoder(self, identity: EncoderIdentity) -> None:
        """Refuse an encoder whose embeddings mean something else. Raises: MismatchError."""
        if not self.encoder.matches(identity):
            raise MismatchError(
                f"{self.path}: the descriptors of this catalogue are of {identity_said(self.encoder)}, given was "
                f"{identity_said(identity)}: a catalogue has one encoder; use that one, or another catalogue"
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

    @property
    def has_index(self) -> bool:
        with reading(self.path):
            return any(index.name == INDEX for index in self.table.list_indices())

    def nearest(self, vector: Float32[np.ndarray, " D"], where: str, count: int, exact: bool) -> Any:
        """The rows of objects whose descriptors have the highest cosines with a unit vector, without their thumbnails.

        where: SQL that they meet, "" for all. exact: compare all of them, though there is an index.
        """
        columns = [name for name in schema_of(self.encoder).names if name not in ("thumbnail", "folder", "sketch")]
        with reading(self.path):
            search = self.table.search(vector, vector_column_name="descriptors", query_type="vector")
            # Rows of scenes have no descriptor and are not found: to look for them before takes as long as the search.
            search = search.where(f"{OF_OBJECTS} AND {where}" if where else OF_OBJECTS, prefilter=bool(where))
            search = search.distance_type("cosine").limit(count)
            search = search.bypass_vector_index() if exact else search.nprobes(self._probes).refine_factor(REFINED)
            return search.select([*columns, "_distance"]).with_row_id(True).to_arrow()

    @property
    def _probes(self) -> int:
        return max(LEAST_PROBES, partitions_for(self.num_rows) // 2)

    def spread(self, count: int) -> Any:
        """The descriptors of some rows, evenly spread over the table."""
        at = np.unique(np.linspace(0, self.num_rows - 1, min(count, self.num_rows)).astype(np.int64))
        with reading(self.path):
            return self.table.take_offsets(at.tolist()).select(["descriptors"]).to_arrow()

    def rows(self, where: str, columns: Sequence[str]) -> Any:
        with reading(self.path):
            return self.table.search().where(where).select(list(columns)).to_arrow()

    def thumbnails(self, row_ids: Sequence[int]) -> dict[int, bytes | None]:
        if not row_ids:
            return {}
        with reading(self.path):
            taken = self.table.take_row_ids(list(row_ids)).select(["thumbnail"]).with_row_id().to_arrow()
            return dict(zip(taken[ROW_ID].to_pylist(), taken["thumbnail"].to_pylist(), strict=True))


def opened(path: Path) -> Snapshot | None:
    """Return the table as it is now, compared with its record; None where there is none yet.

    Raises: FormatError: the folder holds something else, or is damaged. MissingExtraError.
    """
    while True:
        record = read_record(path)  # before the table is opened, so that it is never the newer one
        if record is None:
            return _opened(path)
        record.check_files(_folder(path))
        known = _opened(path)
        if known is None:
            raise FormatError(f"{path}: {CURE} (the versions of its table are missing)")
        try:
            record.check_version(_folder(path), known.version)
        except FormatError:
            again = _opened(path)
            if again is None or again.version == known.version:
                raise
            continue  # another version came meanwhile, and took files of this one away
        return known


def verify(path: Path) -> list[str]:
    """Compare every byte of a catalogue with its record; return the names of the files. Raises: as `opened`."""
    known = opened(path)
    return [] if known is None else verify_record(path, _folder(path))


def record(path: Path, added: str = "", removed: str = "") -> None:
    """Record the latest version of the table; the caller holds the writer's lock.

    added, removed: the scene that it is about.
    """
    before, known = read_record(path), _opened(path)
    if known is not None:
        gone = {*(before.removed if before else ()), removed} - {added, ""}
        write_record(path, _folder(path), known.version, gone)


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
    if _is_begun(_folder(path)):
        return None
    with reading(path):
        table = lancedb.connect(path, session=_session()).open_table(NAME)
        schema = table.schema
    return Snapshot(path, table, _checked(path, schema))


def _is_begun(table: Path) -> bool:
    """No version of it was finished: whoever made it was killed, and the next one makes it anew."""
    changes = (change.name for change in table.glob("_transactions/*"))
    return not any(table.glob("_versions/*.manifest")) and all(name.startswith("0-") for name in changes)


def replace_scene(path: Path, name: str, rows: Any, encoder: EncoderIdentity) -> None:
    """Put rows in place of all those of a scene, in one version; make the table where there is none."""
    lancedb, _ = libraries()
    known = opened(path)
    with writing(path):
        if known is None:
            lancedb.connect(path).create_table(NAME, data=rows, schema=schema_of(encoder))
        else:
            merge = known.table.merge_insert(list(HEAD)).when_matched_update_all().when_not_matched_insert_all()
            merge.when_not_matched_by_source_delete(of_scene(name)).execute(rows)
    record(path, added=name)


def remove_scene(path: Path, table: Any, name: str) -> None:
    """Delete all rows of a scene. The name is recorded before, so that a kill at any moment does not lose it."""
    record(path, removed=name)
    with writing(path):
        table.delete(of_scene(name))
    record(path, removed=name)


def tidy(path: Path) -> None:
    """Put small files of rows together, take new rows into the index, and let old versions go, where it is time.

    Rewrites up to a million rows, so it is time once in every root of the rows / 4 changes. Needs no writer to wait: a
    change that is made meanwhile is kept, and where both have the same rows this is left to the next one. What else
    goes wrong is a warning: the change before it has been made.
    """
    known = opened(path)
    if known is None or not _is_scattered(known):
        return
    with ExitStack() as stack:
        try:
            stack.enter_context(arranging(path))
        except InputError:  # somebody does it
            return
        try:
            _put_together(known)
            _record_arranged(path)
        except InputError as error:
            warnings.warn(f"files were not put together: {error}", DrSplatWarning, stacklevel=3)


def _record_arranged(path: Path) -> None:
    """Record what was put together; writers wait until its files have been read once more."""
    with claimed_output(path, PATIENCE_S):
        record(path)


def arranging(path: Path, patience: float = 0.0) -> AbstractContextManager[None]:
    """Who puts files together or builds the index: one at a time, while others add and remove. Raises: InputError."""
    return claimed_output(path.with_name(f"{path.name}.tidy"), patience)


def _is_scattered(known: Snapshot) -> bool:
    with reading(known.path):
        small = int(known.table.stats()["fragment_stats"]["num_small_fragments"])
    return small > max(FRAGMENTS, math.isqrt(known.num_rows) // 4)


def _put_together(known: Snapshot) -> None:
    try:
        with writing(known.path):
            known.table.optimize(cleanup_older_than=OUTDATED)
    except InputError as error:
        if PREEMPTED not in str(error):
            raise


def partitions_for(rows: int) -> int:
    """Of an index; more would take time to build that grows faster than the rows."""
    return min(math.isqrt(rows), MOST_PARTITIONS)


def index(known: Snapshot) -> None:
    """Build the index of this version's descriptors, a byte for each of their numbers, and that of scenes' names."""
    from lancedb.index import BTree, IvfSq

    partitions = partitions_for(known.num_rows)
    kind = IvfSq(distance_type="cosine", num_partitions=partitions, sample_rate=LEARNED_FROM)
    with writing(known.path):
        known.table.create_index("scene", config=BTree(), replace=True)
        known.table.create_index("descriptors", config=kind, name=INDEX, replace=True)
    _record_arranged(known.path)


def vectors_of(column: Any, path: Path) -> list[Float32[np.ndarray, "k D"]]:
    """The descriptors of each row, of unit length.

    Raises: FormatError: some that are not finite, or have no length.
    """
    lists = column.combine_chunks()
    lengths = np.asarray(lists.value_lengths().fill_null(0), np.int64)
    vectors = lists.flatten()
    flat = np.asarray(vectors.flatten(), np.float16).astype(np.float32).reshape(-1, vectors.type.list_size)
    norms = np.linalg.norm(flat, axis=1, keepdims=True)
    if len(flat) != lengths.sum() or not (np.isfinite(norms) & (norms > 0.5) & (norms < 2)).all():
        raise FormatError(f"{path}: descriptors that are no unit vectors: {CURE}")
    return np.split(flat / norms, np.cumsum(lengths)[:-1]) if len(lengths) else []


CURE = "the table is damaged: restore it from a copy, or remove the folder and add its scenes again"


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raises: FormatError: LanceDB cannot read what is there."""
    with _told(path):
        yield


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raises: InputError: LanceDB could not write; what was there is as it was."""
    try:
        with _told(path):
            yield
    except FormatError as error:
        raise InputError(f"{path}: nothing was changed: {error.__cause__!s:.300}") from error


@contextmanager
def _told(path: Path) -> Iterator[None]:
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
    """Who made the descriptors. Raises: FormatError: other columns than a catalogue has."""
    encoder = _identity(path, (schema.metadata or {}).get(KEY))
    expected = schema_of(encoder)
    if not schema.equals(expected):
        known = {column.name: column.type for column in schema}
        wrong = [column.name for column in expected if known.get(column.name) != column.type]
        raise FormatError(f"{path}: other columns than a catalogue's: {', '.join(wrong) or 'more of them'}")
    return encoder


def _identity(path: Path, about: bytes | None) -> EncoderIdentity:
    try:
        document = json.loads(about or b"null")
        given, version = document["encoder"], document["version"]
        texts = [given["name"], given["weights"], given.get("preprocessing", "")]
        if type(given["dim"]) is not int or not 1 <= given["dim"] <= MOST_DIM or not all(type(t) is str for t in texts):
            raise ValueError("encoder")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path}: a LanceDB table, but not of a catalogue that drsplat made") from error
    if version != VERSION:
        cure = "remove the folder and add its scenes again" if version == 1 else "install the drsplat that made it"
        raise FormatError(f"{path}: a catalogue of version {version!a:.20}; this drsplat reads {VERSION}: {cure}")
    return EncoderIdentity(texts[0], given["dim"], texts[1], texts[2])
