"""One version of a catalogue's table, to be read."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...base.arrays import Embedding, Indices, OtherIndices
from ...errors import FormatError, MismatchError
from ...scene.encoders import EncoderIdentity, identity_text
from ..ranking import Described
from .record import Fragment, fragments_of, manifest_of, read_record
from .schema import COMPARED, CURE, HEAD, cosines_of, described_of, encoder_of, libraries, reading, session

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
