"""Catalogue of many scenes, searched at once."""

from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

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
from .changes import PATIENCE_S, index, remove_scene, replace_scene
from .entries import CatalogueAnswer, Conditions, Entry, SceneEntry, checked_name
from .nearest import ANYWHERE, Search, nearest_objects
from .reading import SceneRules, entries_of, listed_of, thumbnail_of
from .rows import rows_of
from .snapshot import Snapshot, current

LARGE_ROWS = 100_000  # from here on an index is worth its time
MIN_INDEX_OBJECTS = 256  # that its centroids are trained on
MOST_TOP = 1000
MIN_CANDIDATES = 256  # objects of the highest cosines, to compare in full
USUAL_SAMPLE = 4096  # descriptors from which scores are calibrated
MAX_CHANGES, MIN_ROWS_PER_CHANGED_ROW = 100, 100  # of a large catalogue until the sample is drawn anew


@dataclass(eq=False)
class Catalogue:
    """Objects of many scenes, in a folder.

    `Catalogue.open(path)`; the first `add` makes a missing folder. Any number of threads and
    processes may ask while others add and remove: each answer is of one version. Writers take turns.

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
    _usual: tuple[Snapshot, Surroundings] | None = field(default=None, repr=False)
    _rules: SceneRules = field(init=False, repr=False)
    _current: Snapshot | None = field(default=None, repr=False)
    _opening: Lock = field(default_factory=Lock, repr=False)
    _lock: Lock = field(default_factory=Lock, repr=False)

    def __post_init__(self) -> None:
        self._rules = SceneRules(lambda: self._embedder(self._snapshot()))

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

        Raises: FormatError: the folder holds something else, or a damaged one.
        """
        opened = cls(Path(path), vocabulary, encoder, device, threads, load)
        opened._version()
        return opened

    def __len__(self) -> int:
        """Return the number of objects."""
        snapshot = self._version()
        return 0 if snapshot is None else len(snapshot.all_rows)

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
        """Add the objects of a scene, or replace those that it had, in one version.

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
        snapshot = self._version()
        if snapshot is not None:
            snapshot.check_encoder(opened.field.encoder)
            _check_folder(snapshot, called, folder)
        entry, arrays = rows_of(opened, called, folder, georeference, track)
        with claimed_output(self.path, PATIENCE_S):
            snapshot = self._version()
            if snapshot is not None:  # another writer may have come first
                snapshot.check_encoder(opened.field.encoder)
                _check_folder(snapshot, called, folder)
            replace_scene(self.path, entry, arrays, opened.field.encoder)
        if not arrays["thumbnail_bytes"].all():
            warn(f"{called}: no thumbnails: they need the scene's Gaussians and its photos")
        return entry

    def remove(self, name: str) -> int | None:
        """Remove a scene; return how many objects it had, None if it was removed before.

        Raises: InputError: there is none; as `add`.
        """
        with claimed_output(self.path, PATIENCE_S):
            snapshot = self._snapshot()
            if name in snapshot.contents.removed:
                return None
            count = _entry_of(snapshot, name).num_objects
            remove_scene(snapshot, name)
        return count

    def scenes(self) -> list[SceneEntry]:
        """Return the scenes by name, and whether their fields have changed. Raises: FormatError: damaged."""
        snapshot = self._version()
        return [] if snapshot is None else listed_of(snapshot)

    def scene(self, name: str) -> Scene:
        """Open a scene from where it was added. Raises: InputError: no such scene, or nothing is there any more."""
        entry = _entry_of(self._snapshot(), name)
        if not entry.folder or not Path(entry.folder).exists():
            was = f"was added from {entry.folder}, where nothing is any more"
            raise InputError(f"'{name}' {was if entry.folder else 'was not added from a folder'}: add it again")
        return self._opened(scene_files(entry.folder))

    @property
    def wants_index(self) -> bool:
        """True where the catalogue has no index and is so large that every answer takes long."""
        snapshot = self._version()
        return snapshot is not None and len(snapshot.all_rows) > LARGE_ROWS and snapshot.contents.codebook is None

    def build_index(self) -> int:
        """Build an index, which makes answers about 100,000 objects and more quick; return the number of objects.

        `add` takes later objects into it. Reading and writing go on meanwhile.

        Raises: InputError: fewer than 256 objects, which no index can be trained on; another process builds it.
        """
        with claimed_output(self.path.with_name(f"{self.path.name}.index"), PATIENCE_S):
            snapshot = self._snapshot()
            objects = len(snapshot.all_rows)
            if objects < MIN_INDEX_OBJECTS:
                raise InputError(
                    f"an index takes {MIN_INDEX_OBJECTS} objects or more, there are {objects:,}: asking is quick "
                    "without"
                )
            index(snapshot)
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
        query, snapshot = Query(query) if isinstance(query, str) else query, self._snapshot(coded=not exact)
        surroundings = self._surroundings(snapshot)
        vector = surroundings.vector(query)
        nearest = nearest_objects(snapshot, Search(vector, where, max(MIN_CANDIDATES, 4 * top), self.threads), exact)
        ranked = surroundings.rank(query, vector, nearest.described)
        entries = entries_of(snapshot, nearest, ranked, query, self._rules, top)
        return CatalogueAnswer(
            entries, ranked.measure, ranked.threshold, ranked.rule, len(nearest.rows), nearest.is_exact
        )  # fmt: skip

    def thumbnail(self, scene: str, object_id: int, tile: int = 0) -> bytes:
        """Return the JPEG of one object. Raises: InputError: no such object, or it has none. FormatError: damaged."""
        return thumbnail_of(self._snapshot(), scene, object_id, tile)

    def verify(self) -> list[str]:
        """Compare every byte with its checksum; return the names of the files that have one.

        Raises: FormatError: damage.
        """
        snapshot = self._version()
        return [] if snapshot is None else snapshot.verify()

    # --- private ---

    def _version(self, coded: bool = False) -> Snapshot | None:
        """Return the current version, opened once by one thread; None if nothing was added yet. coded: with codes."""
        with self._opening:
            self._current = current(self.path, self._current, coded)
            return self._current

    def _snapshot(self, coded: bool = False) -> Snapshot:
        """Return the current version. Raises: InputError: nothing was added yet."""
        snapshot = self._version(coded)
        if snapshot is None:
            raise InputError(f"{self.path}: no catalogue is here: `drsplat catalogue add {self.path} SCENE` makes one")
        return snapshot

    def _opened(self, files: SceneFiles) -> Scene:
        return open_scene(
            files, encoder=self.encoder_name, vocabulary=self.vocabulary, device=self.device, threads=self.threads,
            load=self.load,
        )  # fmt: skip

    def _surroundings(self, snapshot: Snapshot) -> Surroundings:
        """Return the calibration of a version, or of an earlier one if a large catalogue has hardly changed since.

        One thread makes it and the others wait, as all need it.
        """
        with self._lock:
            if self._usual is None or not _hardly_changed(self._usual[0], snapshot):
                # The first descriptors of objects spread over all
                described = snapshot.spread(USUAL_SAMPLE)
                firsts = described.starts[:-1][np.diff(described.starts) > 0]
                surroundings = Surroundings(snapshot, lambda: self._embedder(snapshot), described.descriptors[firsts])
                self._usual = snapshot, surroundings
            return self._usual[1]

    def _embedder(self, snapshot: Snapshot) -> Encoder:
        """Return the encoder of words, loaded once: a catalogue keeps its encoder for life."""
        if self._encoder is None:
            self._encoder = encoder_for(snapshot, self.vocabulary, self.encoder_name, self.device, self.load)
        return self._encoder


def _hardly_changed(before: Snapshot, now: Snapshot) -> bool:
    """Return whether what is usual among the objects of a version still is: of a large one after few changes."""
    former, count = len(before.all_rows), len(now.all_rows)
    changes = abs(now.contents.changes - before.contents.changes)
    is_recent = changes <= (MAX_CHANGES if count > LARGE_ROWS else 0)
    return is_recent and now.encoder == before.encoder and abs(count - former) * MIN_ROWS_PER_CHANGED_ROW <= former


def _entry_of(snapshot: Snapshot, name: str) -> SceneEntry:
    """Return what is known of a scene. Raises: InputError: there is none of that name."""
    entry = snapshot.scene_entry(name)
    if entry is None:
        raise InputError(f"{snapshot.path}: there is no scene {name!r}; `drsplat catalogue list` tells all")
    return entry


def _check_folder(snapshot: Snapshot, name: str, folder: str) -> None:
    """Check a name. Raises: InputError: it was added from another folder, which is still there."""
    entry = snapshot.scene_entry(name)
    former = "" if entry is None else entry.folder
    if former and folder and former != folder and Path(former).exists():
        raise InputError(f"'{name}' was added from {former}: pass name=NAME to keep both, or remove it first")
