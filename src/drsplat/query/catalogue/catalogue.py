"""Catalogue of many scenes, searched at once."""

from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np

from ...base.contents import AnyPath
from ...errors import InputError, warn
from ...field.codes import Track, untracked
from ...formats.georeference import read_georeference
from ...formats.replacing import claimed_output, refuse_missing_parent
from ...photos.models.loading import load_encoder
from ...scene.encoders import Encoder, EncoderIdentity
from .. import Query, Scene, encoder_for, open_scene
from ..encoding import Load
from ..opening import SceneFiles, scene_files
from ..ranking import Surroundings
from . import table
from .codes import CodeReader, Search, has_codebook, nearest_objects
from .entries import CatalogueAnswer, Conditions, Entry, SceneEntry, checked_name, of_scene
from .reading import SceneRules, entries_of, listed_of, thumbnail_of
from .rows import SceneRows, rows_of
from .snapshot import OF_OBJECTS, Snapshot, batch, current
from .table import verify_codes

LARGE_ROWS = 100_000  # from here on an index is worth its time
MIN_INDEX_OBJECTS = 256  # that its centroids are trained on
MOST_TOP = 1000
MIN_CANDIDATES = 256  # objects of the highest cosines, to compare in full
USUAL_SAMPLE = 4096  # descriptors from which scores are calibrated
MAX_CHANGES, MIN_ROWS_PER_CHANGED_ROW = 100, 100  # of a large table until the sample is drawn anew
ANYWHERE = Conditions()


@dataclass(eq=False)
class Catalogue:
    """Objects of many scenes, in a folder: one row each of a LanceDB table.

    `Catalogue.open(path)`; the first `add` makes a missing folder. Any number of threads and
    processes may ask while others add and remove: each answer is of one version of the table. Writers take turns.

    vocabulary, encoder, device: choose the encoder of words, as for `open_scene`; catalogues of the built-in encoders
    need none.
    """

    path: Path
    vocabulary: str | None = None
    encoder_name: str | None = None
    device: str = "auto"
    threads: int = 0
    load: Load = load_encoder
    _encoder: Encoder | None = field(default=None, repr=False)
    _usual: "_Calibration | None" = field(default=None, repr=False)
    _rules: SceneRules | None = field(default=None, repr=False)
    _codes: CodeReader = field(init=False, repr=False)
    _current: tuple[object, Snapshot] | None = field(default=None, repr=False)
    _opening: Lock = field(default_factory=Lock, repr=False)
    _lock: Lock = field(default_factory=Lock, repr=False)

    def __post_init__(self) -> None:
        self._codes = CodeReader(self.path)

    @classmethod
    def open(
        cls,
        path: AnyPath,
        *,
        encoder: str | None = None,
        vocabulary: str | None = None,
        device: str = "auto",
        threads: int = 0,
        load: Load = load_encoder,
    ) -> "Catalogue":
        """Open the catalogue in a folder, which need not exist yet.

        Raises: FormatError: the folder holds something else, or a damaged one. MissingExtraError: LanceDB is not
        installed.
        """
        opened = cls(Path(path), vocabulary, encoder, device, threads, load)
        current(opened.path)
        return opened

    def __len__(self) -> int:
        """Return the number of objects."""
        snapshot = current(self.path)
        return 0 if snapshot is None else snapshot.count(OF_OBJECTS)

    @property
    def encoder(self) -> EncoderIdentity:
        """Encoder of the descriptors. Raises: InputError: nothing was added yet."""
        return self._snapshot().encoder

    @property
    def query_encoder(self) -> Encoder:
        """Encoder of words, loaded when it is first needed. Raises: as `encoder_for`; as `encoder`."""
        return self._embedder(self._snapshot())

    # --- contents ---

    def add(
        self, scene: AnyPath | SceneFiles | Scene, *, name: str | None = None, track: Track = untracked
    ) -> SceneEntry:
        """Add the objects of a scene, or replace those that it had, in one version of the table.

        scene: opened, or what `open_scene` takes. name: in the catalogue, None for the scene's own.

        Raises: InputError: its objects were not searched for, another folder's scene has this name, or another writer
        does not end. MismatchError: a field of another encoder. FormatError: damaged files.
        """
        if isinstance(scene, Scene):
            opened, folder, georeference = scene, "", None
        else:
            files = scene if isinstance(scene, SceneFiles) else scene_files(scene)
            # the folder that a scene was added from if it has the field and the scene, else the field's path
            is_beside = any(path.parent == files.field.parent for path in files.scenes)
            opened, folder = self._opened(files), str((files.field.parent if is_beside else files.field).resolve())
            georeference = read_georeference(files.field.parent, files.capture)
        called = checked_name(name or opened.name)
        refuse_missing_parent(self.path)
        snapshot = current(self.path)
        if snapshot is not None:
            snapshot.check_encoder(opened.field.encoder)
            _check_folder(snapshot, called, folder)
        added = datetime.now(UTC).replace(microsecond=0)
        rows = rows_of(opened, called, folder, added, georeference, track)
        self._write(called, folder, rows, opened.field.encoder)
        if rows.pictured < len(rows):
            warn(f"{called}: no thumbnails: they need the scene's Gaussians and its photos")
        return SceneEntry(
            called, len(rows), int(opened.agreed.sum()), added, opened.field.fingerprint, folder, "current"
        )

    def remove(self, name: str) -> int | None:
        """Remove a scene; return how many objects it had, None if it was removed before.

        Raises: InputError: there is none; as `add`.
        """
        with claimed_output(self.path, table.PATIENCE_S):
            snapshot = self._snapshot()
            listed = snapshot.rows(of_scene(name), ["object_id"]).num_rows
            if not listed and table.was_removed(self.path, name):
                return None
            if not listed:
                raise InputError(f"{self.path}: there is no scene {name!r}; `drsplat catalogue list` tells all")
            table.remove_scene(self.path, name)
        table.tidy(self.path)
        return int(listed) - 1

    def scenes(self) -> list[SceneEntry]:
        """Return the scenes by name, and whether their fields have changed. Raises: FormatError: damaged."""
        snapshot = current(self.path)
        return [] if snapshot is None else listed_of(snapshot)

    def scene(self, name: str) -> Scene:
        """Open a scene from where it was added. Raises: InputError: no such scene, or nothing is there any more."""
        snapshot = self._snapshot()
        rows = snapshot.rows(f"{of_scene(name)} AND object_id = -1", ["folder"])["folder"].to_pylist()
        if not rows:
            raise InputError(f"{self.path}: there is no scene {name!r}; `drsplat catalogue list` tells all")
        if not rows[0] or not Path(rows[0]).exists():
            where = f"was added from {rows[0]}, where nothing is any more" if rows[0] else "was not added from a folder"
            raise InputError(f"'{name}' {where}: add it again")
        return self._opened(scene_files(rows[0]))

    @property
    def wants_index(self) -> bool:
        """True where the table has no index and is so large that every answer takes long."""
        snapshot = current(self.path)
        return snapshot is not None and snapshot.num_rows > LARGE_ROWS and not has_codebook(self.path)

    def build_index(self) -> int:
        """Build an index, which makes answers about 100,000 objects and more quick; return the number of objects.

        `add` takes later objects into it. Reading and writing go on meanwhile.

        Raises: InputError: fewer than 256 objects, which no index can be trained on; files are being put together.
        """
        with table.arranging(self.path, table.PATIENCE_S):
            snapshot = self._snapshot()
            objects = snapshot.count(OF_OBJECTS)
            if objects < MIN_INDEX_OBJECTS:
                raise InputError(
                    f"an index takes {MIN_INDEX_OBJECTS} objects or more, there are {objects:,}: asking is quick "
                    "without"
                )
            table.index(self.path)
        return objects

    # --- asking ---

    def ask(
        self, query: Query | str, where: Conditions = ANYWHERE, *, top: int = 10, exact: bool = False
    ) -> list[Entry]:
        """Return the objects that a query means, best first, up to `top`; [] if nothing is like it.

        The 256 objects of the highest cosines (4 `top`, if that is more) are measured and cut as objects of one scene
        are. exact: compare all descriptors though there is an index.

        Raises: InputError: nothing was added yet, words that the encoder does not know, no encoder. MismatchError: a
        vector of another dimension, another encoder. FormatError: a damaged table.
        """
        return self.answer(query, where, top=top, exact=exact).entries

    def answer(
        self, query: Query | str, where: Conditions = ANYWHERE, *, top: int = 10, exact: bool = False
    ) -> CatalogueAnswer:
        """Return what `ask` returns, with how it was measured and cut. Raises: as `ask`."""
        if not 1 <= top <= MOST_TOP:
            raise InputError(f"top: expected 1 to {MOST_TOP:,}, got {top}")
        query, snapshot = Query(query) if isinstance(query, str) else query, self._snapshot()
        surroundings = self._surroundings(snapshot)
        vector, codes = surroundings.vector(query), None if exact else self._codes.of(snapshot)
        search = Search(vector, where.sql, max(MIN_CANDIDATES, 4 * top), self.threads)
        nearest = nearest_objects(snapshot, codes, search)
        ranked = surroundings.rank(query, vector, nearest.described)
        entries = entries_of(snapshot, nearest.rows, ranked, query, self._scene_rules(snapshot), top)
        count = nearest.rows.num_rows
        return CatalogueAnswer(entries, ranked.measure, ranked.threshold, ranked.rule, count, nearest.is_exact)

    def thumbnail(self, scene: str, object_id: int, tile: int = 0) -> bytes:
        """Return the JPEG of one object. Raises: InputError: no such object, or it has none. FormatError: damaged."""
        return thumbnail_of(self._snapshot(), scene, object_id, tile)

    def verify(self) -> list[str]:
        """Compare every byte with its checksum; return the names of the files that have one.

        Raises: FormatError: damage.
        """
        return [*table.verify(self.path), *verify_codes(self.path)]

    # --- private ---

    def _snapshot(self) -> Snapshot:
        """Return the current version, opened once by one thread: every query needs it."""
        with self._opening:
            state = table.state_of(self.path)
            if self._current is None or self._current[0] != state:
                snapshot = current(self.path)
                if snapshot is None:
                    raise InputError(
                        f"{self.path}: no catalogue is here: `drsplat catalogue add {self.path} SCENE` makes one"
                    )
                self._current = (state, snapshot)
            return self._current[1]

    def _opened(self, files: SceneFiles) -> Scene:
        return open_scene(
            files, encoder=self.encoder_name, vocabulary=self.vocabulary, device=self.device, threads=self.threads,
            load=self.load,
        )  # fmt: skip

    def _write(self, name: str, folder: str, rows: SceneRows, encoder: EncoderIdentity) -> None:
        """Write the rows of a scene in turn with other writers; checks are repeated after the wait."""
        with claimed_output(self.path, table.PATIENCE_S):
            snapshot = current(self.path)
            if snapshot is not None:
                snapshot.check_encoder(encoder)
                _check_folder(snapshot, name, folder)
                encoder = snapshot.encoder
            table.replace_scene(self.path, name, batch(rows.columns, rows.descriptors, encoder), encoder)
        table.tidy(self.path)

    def _surroundings(self, snapshot: Snapshot) -> Surroundings:
        """Return the calibration of a version of the table, or of an earlier one if a large table has hardly changed.

        One thread makes it and the others wait, as all need it.
        """
        with self._lock:
            if self._usual is None or not self._usual.serves(snapshot):
                # The first descriptors of objects spread over the table
                described = snapshot.spread(USUAL_SAMPLE)
                firsts = described.starts[:-1][np.diff(described.starts) > 0]
                surroundings = Surroundings(snapshot, lambda: self._embedder(snapshot), described.descriptors[firsts])
                self._usual = _Calibration(snapshot.version, snapshot.num_rows, surroundings)
            return self._usual.surroundings

    def _scene_rules(self, snapshot: Snapshot) -> SceneRules:
        """Return the rules of the scenes of a version of the table, with their cached sketches."""
        with self._lock:
            if self._rules is None or self._rules.version != snapshot.version:
                self._rules = SceneRules(snapshot, lambda: self._embedder(snapshot))
            return self._rules

    def _embedder(self, snapshot: Snapshot) -> Encoder:
        """Return the encoder of words, loaded once: a table keeps its encoder for life."""
        if self._encoder is None:
            self._encoder = encoder_for(snapshot, self.vocabulary, self.encoder_name, self.device, self.load)
        return self._encoder


class _Calibration(NamedTuple):
    """Scores that are usual among the objects of a version of the table, and its number of rows."""

    version: int
    num_rows: int
    surroundings: Surroundings

    def serves(self, snapshot: Snapshot) -> bool:
        """Return whether it still holds for a table.

        It does for the same version, and for a large table of the same encoder that has hardly changed since.
        """
        if snapshot.encoder != self.surroundings.embedded.encoder:
            return False  # another table
        changes = abs(snapshot.version - self.version)
        allowed = 0 if snapshot.num_rows <= LARGE_ROWS else MAX_CHANGES
        return changes <= allowed and abs(snapshot.num_rows - self.num_rows) * MIN_ROWS_PER_CHANGED_ROW <= self.num_rows


def _check_folder(snapshot: Snapshot, name: str, folder: str) -> None:
    """Check a name. Raises: InputError: it was added from another folder, which is still there."""
    (former,) = snapshot.rows(f"{of_scene(name)} AND object_id = -1", ["folder"])["folder"].to_pylist()[:1] or [""]
    if former and folder and former != folder and Path(former).exists():
        raise InputError(f"'{name}' was added from {former}: pass name=NAME to keep both, or remove it first")
