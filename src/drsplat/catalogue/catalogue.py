"""Many scenes, asked at once."""

import os
import warnings
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np

from ..arrays import Float32
from ..codes import Track, untracked
from ..encoders import Encoder, EncoderIdentity
from ..errors import DrSplatWarning, InputError
from ..formats.claiming import claimed_output
from ..formats.georeference import read_georeference
from ..formats.replacing import refuse_missing_parent
from ..models.loading import load_encoder
from ..query import Query, Scene, encoder_for, open_scene
from ..query.encoding import Load
from ..query.opening import SceneFiles, scene_files
from ..query.ranking import Described, Surroundings
from . import table
from .agreeing import SceneRules
from .conditions import Where, checked_name, of_scene
from .entries import CatalogueAnswer, Entry, Listed
from .reading import entries_of, listed_of, thumbnail_of
from .rows import SceneRows, rows_of
from .table import Snapshot

LARGE = 100_000  # rows from which an index is worth its time
LEAST_OF_INDEX = 256  # rows that its centroids are trained on
MOST_TOP = 1000
CANDIDATES = 256  # objects of the highest cosines, that are looked at closely
USUAL = 4096  # descriptors that say what is usual
FEW_CHANGES, HARDLY = 100, 100  # scenes that come or go in a large table before that is asked anew; a share of its rows
ANYWHERE = Where()


@dataclass(eq=False)
class Catalogue:
    """The objects of many scenes, in a folder: a row each of a LanceDB table.

    `Catalogue.open(path)`; a folder that is not there yet is made by the first `add`. Any number of threads and
    processes may ask while others add and remove: each answer is of one version of the table. Writers take turns.

    vocabulary, encoder, device: who embeds words, as for `open_scene`; catalogues of the built-in encoders need none.
    """

    path: Path
    vocabulary: str | None = None
    encoder_name: str | None = None
    device: str = "auto"
    threads: int = 0
    load: Load = load_encoder
    _encoder: Encoder | None = field(default=None, repr=False)
    _usual: "_Usual | None" = field(default=None, repr=False)
    _rules: SceneRules | None = field(default=None, repr=False)
    _lock: Lock = field(default_factory=Lock, repr=False)

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        encoder: str | None = None,
        vocabulary: str | None = None,
        device: str = "auto",
        threads: int = 0,
        load: Load = load_encoder,
    ) -> "Catalogue":
        """The catalogue in a folder, or one that is to be there.

        Raises: FormatError: the folder holds something else, or a damaged one. MissingExtraError: LanceDB is not
        installed.
        """
        opened = cls(Path(path), vocabulary, encoder, device, threads, load)
        table.opened(opened.path)
        return opened

    def __len__(self) -> int:
        """How many objects it has."""
        known = table.opened(self.path)
        return 0 if known is None else known.count(table.OF_OBJECTS)

    @property
    def encoder(self) -> EncoderIdentity:
        """Who made the descriptors. Raises: InputError: nothing was added yet."""
        return self._snapshot().encoder

    @property
    def query_encoder(self) -> Encoder:
        """Who embeds words here, loaded when it is first needed. Raises: as `encoder_for`; as `encoder`."""
        return self._embedder(self._snapshot())

    # --- what is in it ---

    def add(
        self, scene: str | os.PathLike[str] | SceneFiles | Scene, *, name: str | None = None, track: Track = untracked
    ) -> Listed:
        """Take the objects of a scene in, in place of those that it had here; in one step for all who read.

        scene: opened, or what `open_scene` takes. name: what it is called here, None for its own.

        Raises: InputError: nobody has looked for its objects, another folder's scene has this name, or another writer
        does not end. MismatchError: a field of another encoder. FormatError: damaged files.
        """
        if isinstance(scene, Scene):
            opened, folder, georeference = scene, "", None
        else:
            files = scene if isinstance(scene, SceneFiles) else scene_files(scene)
            opened, folder = self._opened(files), _folder_of(files)
            georeference = read_georeference(files.field.parent, files.capture)
        called = checked_name(name or opened.name)
        refuse_missing_parent(self.path)
        known = table.opened(self.path)
        if known is not None:
            known.check_encoder(opened.field.encoder)
            _check_folder(known, called, folder)
        added = datetime.now(UTC).replace(microsecond=0)
        rows = rows_of(opened, called, folder, added, georeference, track)
        self._write(called, folder, rows, opened.field.encoder)
        if rows.pictured < len(rows):
            warnings.warn(
                f"{called}: no thumbnails: they need the scene's Gaussians and its photos", DrSplatWarning, stacklevel=2
            )
        return Listed(called, len(rows), int(opened.agreed.sum()), added, opened.field.fingerprint, folder, "current")

    def remove(self, name: str) -> int | None:
        """Drop a scene; return how many objects it had, None if it was removed before.

        Raises: InputError: there is none; as `add`.
        """
        with claimed_output(self.path, table.PATIENCE_S):
            known = self._snapshot()
            listed = known.rows(of_scene(name), ["object_id"]).num_rows
            if not listed and table.was_removed(self.path, name):
                return None
            if not listed:
                raise InputError(f"{self.path}: there is no scene {name!r}; `drsplat catalogue list` tells all")
            table.remove_scene(self.path, known.table, name)
        table.tidy(self.path)
        return int(listed) - 1

    def scenes(self) -> list[Listed]:
        """The scenes by name, with whether their fields are those that were added. Raises: FormatError: damaged."""
        known = table.opened(self.path)
        return [] if known is None else listed_of(known)

    def scene(self, name: str) -> Scene:
        """A scene, opened from where it was added. Raises: InputError: no such scene, or nothing is there any more."""
        known = self._snapshot()
        rows = known.rows(f"{of_scene(name)} AND object_id = -1", ["folder"])["folder"].to_pylist()
        if not rows:
            raise InputError(f"{self.path}: there is no scene {name!r}; `drsplat catalogue list` tells all")
        if not rows[0] or not Path(rows[0]).exists():
            where = f"was added from {rows[0]}, where nothing is any more" if rows[0] else "was not added from a folder"
            raise InputError(f"'{name}' {where}: add it again")
        return self._opened(scene_files(rows[0]))

    @property
    def wants_index(self) -> bool:
        """Whether it is so large that every answer takes long without one, and has none."""
        known = table.opened(self.path)
        return known is not None and known.num_rows > LARGE and not known.has_index

    def build_index(self) -> int:
        """Make answers about 100,000 objects and more quick; returns how many partitions the index has.

        What is added later, or meanwhile, is compared one by one until `add` takes it into the index. Nobody who
        adds, removes or asks waits for it.

        Raises: InputError: fewer than 256 objects, which no index can be trained on; files are being put together.
        """
        with table.arranging(self.path, table.PATIENCE_S):
            known = self._snapshot()
            objects = known.count(table.OF_OBJECTS)
            if objects < LEAST_OF_INDEX:
                raise InputError(
                    f"an index takes {LEAST_OF_INDEX} objects or more, there are {objects:,}: asking is quick without"
                )
            table.index(known)
        return table.partitions_for(known.num_rows)

    # --- asking ---

    def ask(self, query: Query | str, where: Where = ANYWHERE, *, top: int = 10, exact: bool = False) -> list[Entry]:
        """The objects that a query means, best first, up to `top` of them; nothing like it is [].

        Of the 256 objects of the highest cosines (4 `top`, if that is more), measured and cut as objects of one scene
        are. exact: compare all descriptors though there is an index.

        Raises: InputError: nothing was added yet, words that the encoder does not know, no encoder. MismatchError: a
        vector of another dimension, another encoder. FormatError: a damaged table.
        """
        return self.answer(query, where, top=top, exact=exact).entries

    def answer(
        self, query: Query | str, where: Where = ANYWHERE, *, top: int = 10, exact: bool = False
    ) -> CatalogueAnswer:
        """The same, with how it was measured and cut. Raises: as `ask`."""
        if not 1 <= top <= MOST_TOP:
            raise InputError(f"top: expected 1 to {MOST_TOP:,}, got {top}")
        query, known = Query(query) if isinstance(query, str) else query, self._snapshot()
        surroundings = self._surroundings(known)
        vector, exact = surroundings.vector(query), exact or not known.has_index or _are_few(known, where)
        nearest = known.nearest(vector, where.sql, max(CANDIDATES, 4 * top), exact)
        objects = Described.of(table.vectors_of(nearest["descriptors"], self.path), known.encoder.dim)
        ranked = surroundings.rank(query, vector, objects)
        entries = entries_of(known, nearest, ranked, query, self._scene_rules(known), top)
        return CatalogueAnswer(entries, ranked.measure, ranked.threshold, ranked.rule, len(nearest), exact)

    def thumbnail(self, scene: str, object_id: int, tile: int = 0) -> bytes:
        """The JPEG of one object. Raises: InputError: no such object, or it has none. FormatError: damaged."""
        return thumbnail_of(self._snapshot(), scene, object_id, tile)

    def verify(self) -> list[str]:
        """Compare every byte with its checksum; return the names of the files that have one.

        Raises: FormatError: damage.
        """
        return table.verify(self.path)

    # --- within ---

    def _snapshot(self) -> Snapshot:
        known = table.opened(self.path)
        if known is None:
            raise InputError(f"{self.path}: no catalogue is here: `drsplat catalogue add {self.path} SCENE` makes one")
        return known

    def _opened(self, files: SceneFiles) -> Scene:
        return open_scene(
            files, encoder=self.encoder_name, vocabulary=self.vocabulary, device=self.device, threads=self.threads,
            load=self.load,
        )  # fmt: skip

    def _write(self, name: str, folder: str, rows: SceneRows, encoder: EncoderIdentity) -> None:
        """In turn with other writers; what was seen before one waited is looked at again."""
        with claimed_output(self.path, table.PATIENCE_S):
            known = table.opened(self.path)
            if known is not None:
                known.check_encoder(encoder)
                _check_folder(known, name, folder)
                encoder = known.encoder
            table.replace_scene(self.path, name, table.batch(rows.columns, rows.descriptors, encoder), encoder)
        table.tidy(self.path)

    def _surroundings(self, known: Snapshot) -> Surroundings:
        """Of a version of the table, made once; of a large one that of a version before, while it has hardly changed.

        One thread makes it and the others wait, as all need it.
        """
        with self._lock:
            if self._usual is None or not self._usual.serves(known):
                made = Surroundings(known, lambda: self._embedder(known), _spread(known))
                self._usual = _Usual(known.version, known.num_rows, made)
            return self._usual.surroundings

    def _scene_rules(self, known: Snapshot) -> SceneRules:
        """Return the rules of the scenes of a version of the table, with what is in memory of them."""
        with self._lock:
            if self._rules is None or self._rules.version != known.version:
                self._rules = SceneRules(known, lambda: self._embedder(known))
            return self._rules

    def _embedder(self, known: Snapshot) -> Encoder:
        """Loaded once: the table keeps its encoder for life."""
        if self._encoder is None:
            self._encoder = encoder_for(known, self.vocabulary, self.encoder_name, self.device, self.load)
        return self._encoder


class _Usual(NamedTuple):
    """What is usual among the objects of a version of the table that had so many rows."""

    version: int
    num_rows: int
    surroundings: Surroundings

    def serves(self, known: Snapshot) -> bool:
        """Whether it is of this version, or of a large one of the same encoder that has hardly changed since."""
        if known.encoder != self.surroundings.embedded.encoder:
            return False  # another table
        changes = abs(known.version - self.version)
        few = 0 if known.num_rows <= LARGE else FEW_CHANGES
        return changes <= few and abs(known.num_rows - self.num_rows) * HARDLY <= self.num_rows


def _are_few(known: Snapshot, where: Where) -> bool:
    """Whether so few objects are looked at that comparing them all is quicker than the index."""
    return bool(where.sql) and known.count(where.sql) <= LARGE


def _spread(known: Snapshot) -> Float32[np.ndarray, "s D"]:
    """The first descriptors of objects spread over the table."""
    parts = table.vectors_of(known.spread(USUAL)["descriptors"], known.path)
    return np.concatenate([np.empty((0, known.encoder.dim), np.float32), *(part[:1] for part in parts)])


def _folder_of(files: SceneFiles) -> str:
    """Where a scene was added from: the folder that has its field, else the field."""
    is_beside = any(path.parent == files.field.parent for path in files.scenes)
    return str((files.field.parent if is_beside else files.field).resolve())


def _check_folder(known: Snapshot, name: str, folder: str) -> None:
    """Raises: InputError: a scene of this name was added from another folder, which is still there."""
    (former,) = known.rows(f"{of_scene(name)} AND object_id = -1", ["folder"])["folder"].to_pylist()[:1] or [""]
    if former and folder and former != folder and Path(former).exists():
        raise InputError(f"'{name}' was added from {former}: pass name=NAME to keep both, or remove it first")
