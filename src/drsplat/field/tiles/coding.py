"""Rows of W to codes, a task for each run of tiles: as `field.building` codes all of them, to the bit.

What a code is learnt from are a few views, however many there are: it goes to all tasks. A row's code depends on that
and on its own row of W.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Bool, Float32, Int32, Int64
from ...base.contents import pieces
from ...formats.tensors import map_tensors
from ...kernels import default_isa, weighted_rows
from ...kernels.mixture import MAX_ATOMS, Encoded
from ...scene.gaussians import Gaussians
from ..building import AT_ONCE, encode_features
from ..codes import Codebook, Codes, Track, untracked
from ..codes.mixture import Mixed, SceneAtoms, assemble, atoms_by_use, encode_rows, left_in, plan_of
from ..evidence.aggregation import Aggregated, Aggregator
from ..evidence.evidence import Evidence
from .aggregating import EMBEDDINGS_FILE, OfTiles, TileAggregator, is_by_tasks
from .launching import Launcher, followed
from .seeing import Gallery
from .store import Store, make_once
from .transposing import Run, rows_name


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of W that have weights, and the embeddings of all columns: what codes are made of."""

    weights: csr_array
    embeddings: Float32[np.ndarray, "m d"]

    def __len__(self) -> int:
        return int(self.weights.shape[0])

    def features(self, begin: int, end: int, *, threads: int = 0) -> Float32[np.ndarray, "n d"]:
        w = self.weights
        return weighted_rows(w.indptr, w.indices, w.data, self.embeddings, begin, end, threads=threads)


Coding = Callable[[Rows, int], dict[str, np.ndarray]]
"""(rows, threads) -> arrays with an item for each row."""


@dataclass(frozen=True, eq=False)
class Mixing:
    """A `Coding`. columns: whose embeddings may be atoms; None: all. Ids are columns, then the scene's atoms."""

    atoms_per_row: int
    scene: SceneAtoms | None
    columns: Int32[np.ndarray, " c"] | None = None

    def __call__(self, rows: Rows, threads: int) -> dict[str, np.ndarray]:
        own = np.unique(rows.weights.indices)
        own = own if self.columns is None else np.intersect1d(own, self.columns, assume_unique=True)
        plan = plan_of(rows.embeddings, own, self.scene)
        encoded = encode_rows(rows, plan, self.atoms_per_row, threads=threads)
        of_scene = encoded.ids - np.int32(len(own)) + np.int32(len(rows.embeddings))
        ids = np.where(encoded.ids < len(own), np.append(own, 0)[np.minimum(encoded.ids, len(own))], of_scene)
        return encoded._replace(ids=ids.astype(np.int32))._asdict()

    def update(self, digest: "hashlib.blake2b") -> None:
        digest.update(f"mixture {self.atoms_per_row}".encode())
        for array in () if self.scene is None else (self.scene.vectors, self.scene.centres, self.scene.members):
            digest.update(array.tobytes())
        digest.update(b"all" if self.columns is None else self.columns.tobytes())


@dataclass(frozen=True, eq=False)
class Quantising:
    """A `Coding`."""

    codebook: Codebook

    def __call__(self, rows: Rows, threads: int) -> dict[str, np.ndarray]:
        (codes, coarse_ids), directed = encode_features(rows, self.codebook, threads, untracked)
        return {"codes": codes, "directed": directed} | ({} if coarse_ids is None else {"coarse_ids": coarse_ids})

    def update(self, digest: "hashlib.blake2b") -> None:
        digest.update(f"pq {self.codebook.hash}".encode())


@dataclass(frozen=True, eq=False)
class CodeTask:
    """Codes the rows of a run of tiles. folder: of the files of these. key: of all that decides how."""

    store: Store
    coding: Coding
    folder: str
    key: str
    threads: int

    def __call__(self, run: Run) -> bool:
        """Code a run of rows; return True if that was done now, and not before."""
        return make_once(self.store, self.name(run), self.key, lambda: self.coding(self._rows(run), self.threads))

    def name(self, run: Run) -> str:
        """Name the file of rows, which may be coded twice, with other atoms: the key tells these apart."""
        return f"codes/{run.name}.{self.key}.safetensors"

    def _rows(self, run: Run) -> Rows:
        tensors, _ = map_tensors(self.store.bring(rows_name(run, self.folder)))
        embeddings = np.load(self.store.bring(EMBEDDINGS_FILE), mmap_mode="r")
        starts = tensors["indptr"].astype(np.int32)
        starts = starts[np.append(True, np.diff(starts) > 0)]  # rows without any weight have no code
        matrix = csr_array((tensors["data"], tensors["indices"], starts), shape=(len(starts) - 1, len(embeddings)))
        return Rows(matrix, np.asarray(embeddings))


@dataclass(frozen=True, eq=False)
class TileCoder:
    """A `RowCoder` that lets a launcher work. evidence: that of the runs' files; other evidence is coded at once.

    key: of the weights. threads: of each worker. gallery: where the tiles are.
    """

    evidence: Evidence
    store: Store
    runs: Sequence[Run]
    launcher: Launcher
    key: str
    threads: int
    gallery: Gallery

    def aggregated(
        self, how: Aggregator, evidence: Evidence, gaussians: Gaussians | None, threads: int, track: Track
    ) -> Aggregated:
        """See RowCoder."""
        if evidence is self.evidence and is_by_tasks(how):
            return self._aggregator(how, track)
        if how.voting is not None and gaussians is None:
            gaussians = self.gallery.tiles.gaussians()
        return AT_ONCE.aggregated(how, evidence, gaussians, threads, track)

    def of_columns(self, features: Aggregated, kept: Bool[np.ndarray, " m"]) -> Aggregated:
        """See RowCoder."""
        if not isinstance(features, OfTiles):
            return AT_ONCE.of_columns(features, kept)
        return self._aggregator.of_columns(features, kept, untracked)

    @property
    def _aggregator(self) -> TileAggregator:
        made = self.evidence, self.store, self.runs, self.launcher, self.key, self.threads
        return TileAggregator(*made, self.gallery)

    def mixed(
        self, features: Aggregated, seen: Int64[np.ndarray, " s"], atoms_per_row: int, scene: SceneAtoms | None,
        threads: int, track: Track,
    ) -> Mixed:  # fmt: skip
        """See RowCoder."""
        if not isinstance(features, OfTiles):
            return AT_ONCE.mixed(features, seen, atoms_per_row, scene, threads, track)
        coding, masks = Mixing(atoms_per_row, scene), len(self.evidence.masks)
        while True:
            encoded = Encoded(**self._coded(features, coding, track))
            used = atoms_by_use(encoded)
            if len(used) <= MAX_ATOMS:
                return self._assembled(encoded, used, scene)
            coding = Mixing(atoms_per_row, scene, left_in(used, masks, scene))

    def _assembled(self, encoded: Encoded, used: Int64[np.ndarray, " u"], scene: SceneAtoms | None) -> Mixed:
        """Assemble with a plan of the columns alone that are used."""
        masks = len(self.evidence.masks)
        columns = np.sort(used[used < masks]).astype(np.int32)
        plan = plan_of(self.evidence.embeddings, columns, scene)
        number = np.append(plan.positions, np.arange(len(scene) if scene else 0, dtype=np.int32) + len(columns))
        placed = encoded._replace(ids=np.maximum(number[encoded.ids], 0).astype(np.int32))
        return assemble(placed, plan, columns, atoms_by_use(placed))

    def quantised(
        self, features: Aggregated, seen: Int64[np.ndarray, " s"], codebook: Codebook, threads: int, track: Track
    ) -> tuple[Codes, Bool[np.ndarray, " s"]]:
        """See RowCoder."""
        if not isinstance(features, OfTiles):
            return AT_ONCE.quantised(features, seen, codebook, threads, track)
        arrays = self._coded(features, Quantising(codebook), track)
        return Codes(arrays["codes"], arrays.get("coarse_ids")), arrays["directed"]

    def _coded(self, features: OfTiles, coding: Mixing | Quantising, track: Track) -> dict[str, np.ndarray]:
        """Return the coded arrays of all rows that have weights, one after another."""
        task = CodeTask(self.store, coding, features.folder, self._key_of(features, coding), self.threads)
        self.store.send(EMBEDDINGS_FILE)
        names = [run.name for run in self.runs]
        for _ in followed(self.launcher.results(task, self.runs), track, names, "coding Gaussians"):
            pass
        files: list[Mapping[str, np.ndarray]] = [map_tensors(self.store.bring(task.name(run)))[0] for run in self.runs]
        return {name: np.concatenate([file[name] for file in files]) for name in files[0]}

    def _key_of(self, features: OfTiles, coding: Mixing | Quantising) -> str:
        digest = hashlib.blake2b(f"{features.key} {default_isa()}".encode(), digest_size=16)
        for piece in pieces(self.evidence.embeddings):
            digest.update(piece)
        coding.update(digest)
        return digest.hexdigest()
