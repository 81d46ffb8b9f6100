"""Files of a catalogue, and one version of them to be read.

`catalogue.json` names the files of one version with their checksums; a change writes new files and replaces it. Each
part has some scenes: a file with the rows of their objects, and, where there is an index, one with codes of their
descriptors. docs/catalogue_layout.md has the arrays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from ...base.arrays import Array, Arrays, Embeddings, Indices, Int8, Numbers, OtherIndices
from ...base.contents import open_file
from ...errors import DrSplatError, FormatError, InputError, MismatchError
from ...field.codes import Codebook, PQCode, load_codebook
from ...formats.json_files import MAX_GAUSSIANS, as_document, as_kind, as_list, document_in, spans_of
from ...formats.tensors import check_checksums, check_document, check_seal, check_tensors, header_checksum, map_tensors
from ...scene.encoders import EncoderIdentity, identity_text
from ..ranking import Described
from .entries import Conditions, SceneEntry

T = TypeVar("T")
DOCUMENT, FORMAT, VERSION = "catalogue.json", "drsplat catalogue", 5
FORMER = "objects.lance"  # of catalogues of version 4 and before
SMALL_BYTES = 64 << 20  # arrays up to this size are compared with their checksums when they are opened
MAX_DIM = 1 << 16
AGAIN = "remove the folder and add its scenes again"
CURE = f"the catalogue is damaged: restore it from a copy, or {AGAIN}"
CODES_CURE = "`drsplat catalogue index` makes these files anew"

# Letters of axes: scenes, objects, coordinates, pieces (descriptors), numbers of these; bytes of records, of
# thumbnails and of sketches
ROWS = {
    "centers": ("float64", "o c"), "positions": ("float64", "o c"), "extents": ("float32", "o c"),
    "axes": ("float32", "o c c"), "descriptors": ("int8", "p d"), "descriptor_counts": ("uint32", "o"),
    "records": ("uint8", "r"), "record_bytes": ("uint32", "o"), "thumbnails": ("uint8", "t"),
    "thumbnail_bytes": ("uint32", "o"), "sketches": ("uint8", "k"), "sketch_bytes": ("uint32", "s"),
}  # fmt: skip
LENGTHS = {"p": "descriptor_counts", "r": "record_bytes", "t": "thumbnail_bytes", "k": "sketch_bytes"}
CODES = {"grouped_codes": ("uint8", "g L k"), "inverse_norms": ("float32", "p")}


@dataclass(frozen=True)
class FileEntry:
    """File of a version. crc32: of its header, which has the checksums of all arrays."""

    name: str
    crc32: str


@dataclass(frozen=True)
class PartEntry:
    """Files of some scenes. codes: None without an index. without: scenes that were removed or replaced since."""

    rows: FileEntry
    codes: FileEntry | None = None
    without: tuple[str, ...] = ()


@dataclass(frozen=True)
class Contents:
    """Contents of `catalogue.json`. changes: so many so far. removed: scenes that were, and not added again."""

    encoder: EncoderIdentity
    parts: tuple[PartEntry, ...] = ()
    codebook: FileEntry | None = None
    removed: tuple[str, ...] = ()
    changes: int = 0

    @property
    def files(self) -> list[FileEntry]:
        """All files of the version."""
        pairs = [file for part in self.parts for file in (part.rows, part.codes)]
        return [file for file in (self.codebook, *pairs) if file is not None]


class Record(NamedTuple):
    """Facts of an object that are shown and never searched; see `Entry`."""

    tile: int
    num_gaussians: int
    num_views: int
    sure: float
    label: str | None
    name: str | None
    photo: str | None
    mask: int | None


@dataclass(frozen=True, eq=False)
class Part:
    """Objects of some scenes, scene by scene. starts: per axis of `ROWS` where each scene or object begins."""

    where: str
    scenes: Sequence[SceneEntry]
    arrays: Arrays
    starts: Mapping[str, OtherIndices]

    @classmethod
    def read(cls, path: Path, file: FileEntry, dim: int) -> "Part":
        """Read a file of rows. Raises: FormatError: damaged, or arrays that do not fit each other."""
        where = str(path / file.name)
        try:
            arrays, about = read_arrays(path / file.name, file, ROWS)
            listed = as_list(document_in(about.get("scenes", ""), where), where)
            scenes: list[SceneEntry] = [as_kind(scene, _scene_entry, where) for scene in listed]
            lengths = {axis: arrays[name] for axis, name in LENGTHS.items()}
            lengths["o"] = np.array([scene.num_objects for scene in scenes], np.int64)
            starts = {axis: np.append(0, np.cumsum(counts, dtype=np.int64)) for axis, counts in lengths.items()}
            fits = all(len(arrays[name]) == starts.get(axis[0], [len(scenes)])[-1] for name, (_, axis) in ROWS.items())
            if not fits or (arrays["descriptors"].shape[1], arrays["centers"].shape[1]) != (dim, 3):
                raise FormatError(
                    f"{where}: expected boxes of the objects of {len(scenes)} scenes, and descriptors of {dim} numbers"
                )
        except (FormatError, InputError) as error:
            raise FormatError(f"{error}: {CURE}") from error
        return cls(where, scenes, arrays, starts)

    def __len__(self) -> int:
        return len(self.arrays["centers"])

    def scene(self, number: int) -> Arrays:
        """Return all arrays of one scene."""
        begin, end = self.starts["o"][number : number + 2].tolist()
        bounds = {axis: self.starts[axis][[begin, end]] for axis in "prt"}
        bounds |= {"o": np.array([begin, end]), "s": np.array([number, number + 1])}
        bounds["k"] = self.starts["k"][number : number + 2]
        return {name: self.arrays[name][slice(*bounds[axis[0]])] for name, (_, axis) in ROWS.items()}

    def row(self, scene: int, object_id: int) -> int | None:
        """Return the row of an object, None where the scene has none of that number."""
        begin, end = self.starts["o"][scene : scene + 2].tolist()
        return begin + object_id if 0 <= object_id < end - begin else None

    def bytes_of(self, name: str, number: int) -> bytes:
        """Return the record or thumbnail of an object, or the sketch of a scene."""
        return self.arrays[name][slice(*self.starts[ROWS[name][1]][number : number + 2])].tobytes()

    def record(self, row: int) -> Record:
        """Return what is shown of an object. Raises: FormatError: damaged."""
        record: Record = as_kind(document_in(self.bytes_of("records", row), self.where), Record, self.where)
        return record


def _scene_entry(scene: str, num_objects: int, num_agreed: int, added: str, field: str, folder: str) -> SceneEntry:
    try:
        moment = datetime.fromisoformat(added)
        moment.astimezone()
    except (ValueError, OverflowError) as error:
        raise FormatError(f"a scene that was added at {added!a:.40}") from error
    if not 0 <= num_objects <= MAX_GAUSSIANS:
        raise FormatError(f"a scene of {num_objects} objects")
    return SceneEntry(scene, num_objects, num_agreed, moment, field, folder, "unknown")


class Place(NamedTuple):
    """An object: its part, its row there, its scene there, and its number in that."""

    part: Part
    row: int
    scene: int
    object_id: int

    @property
    def entry(self) -> SceneEntry:
        """Scene that it is of."""
        return self.part.scenes[self.scene]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One version of a catalogue. content: of its document. opened: parts and codes that were read, by file."""

    path: Path
    content: bytes
    opened: dict[str, object] = field(default_factory=dict)

    @cached_property
    def contents(self) -> Contents:
        """Checked document. Raises: FormatError: damaged, edited or of another version."""
        where = str(self.path / DOCUMENT)
        document = as_document(document_in(self.content, where), where, FORMAT, VERSION, f"{AGAIN}, with this drsplat")
        check_seal(document, where, cure=CURE)
        contents: Contents = as_kind(document, Contents, where)
        if not 1 <= contents.encoder.dim <= MAX_DIM or any(Path(one.name).name != one.name for one in contents.files):
            raise FormatError(f"{where}: expected an encoder of 1 to {MAX_DIM} dimensions and names of files. {CURE}")
        return contents

    @property
    def encoder(self) -> EncoderIdentity:
        """Encoder of all descriptors."""
        return self.contents.encoder

    def check_encoder(self, identity: EncoderIdentity) -> None:
        """Refuse an encoder with incompatible embeddings. Raises: MismatchError."""
        if not self.encoder.matches(identity):
            raise MismatchError(
                f"{self.path}: the descriptors of this catalogue are of {identity_text(self.encoder)}, given was "
                f"{identity_text(identity)}: a catalogue has one encoder; use that one, or another catalogue"
            )

    @cached_property
    def parts(self) -> list[Part]:
        """Parts of the version, in order. Raises: FormatError: damaged."""
        return [
            self._open(part.rows, lambda file: Part.read(self.path, file, self.encoder.dim))
            for part in self.contents.parts
        ]

    @cached_property
    def codebook(self) -> Codebook | None:
        """Codebook of the index; None without one. Raises: FormatError: damaged."""
        file = self.contents.codebook
        if file is None:
            return None
        try:
            codebook = self._open(file, lambda file: load_codebook(self.path / file.name))
        except (FormatError, InputError) as error:
            raise FormatError(f"{error}: {CODES_CURE}") from error
        if not self.encoder.matches(codebook.encoder):
            raise FormatError(
                f"{file.name}: a codebook of {codebook.encoder.name}, not of this catalogue's encoder: {CODES_CURE}"
            )
        return codebook

    @cached_property
    def codes(self) -> list[PQCode] | None:
        """Codes of each part's descriptors; None without an index. Raises: FormatError: damaged."""
        codebook = self.codebook
        if codebook is None:
            return None
        try:
            pairs = zip(self.contents.parts, self.parts, strict=True)
            return [self._codes_of(entry.codes, codebook, part) for entry, part in pairs]
        except (FormatError, InputError) as error:
            raise FormatError(f"{error}: {CODES_CURE}") from error

    def _open(self, file: FileEntry, read: Callable[[FileEntry], T]) -> T:
        if file.name not in self.opened:
            self.opened[file.name] = read(file)
        return self.opened[file.name]  # type: ignore[return-value]

    def _codes_of(self, file: FileEntry | None, codebook: Codebook, part: Part) -> PQCode:
        if file is None:
            raise FormatError(f"{part.where}: a part without codes")
        arrays, _ = self._open(file, lambda file: read_arrays(self.path / file.name, file, CODES))
        if len(arrays["inverse_norms"]) != part.starts["p"][-1]:
            raise FormatError(f"{file.name}: codes of other descriptors than those of {part.where}")
        return PQCode(codebook, arrays["grouped_codes"], None, arrays["inverse_norms"])

    @cached_property
    def firsts(self) -> Indices:
        """Number of each part's first row among the rows of all parts, and the number of all."""
        return np.append(0, np.cumsum([len(part) for part in self.parts], dtype=np.int64))

    @cached_property
    def scenes(self) -> dict[str, tuple[int, int]]:
        """Per scene of this version, by name, the numbers of its part and of its place there."""
        return {
            scene.scene: (at, number)
            for at, (entry, part) in enumerate(zip(self.contents.parts, self.parts, strict=True))
            for number, scene in enumerate(part.scenes)
            if scene.scene not in entry.without
        }

    @cached_property
    def all_rows(self) -> Indices:
        """Rows of all objects."""
        return self.rows(Conditions())

    def scene_entry(self, name: str) -> SceneEntry | None:
        """Return what is known of a scene, None where there is none of that name."""
        at, number = self.scenes.get(name, (-1, 0))
        return None if at < 0 else self.parts[at].scenes[number]

    def rows(self, where: Conditions) -> Indices:
        """Return the rows of the objects that meet conditions, ascending."""
        rows = [np.empty(0, np.int64)]
        for at, part in enumerate(self.parts):
            scenes = [self.scenes.get(one.scene) == (at, k) and where.admit(one) for k, one in enumerate(part.scenes)]
            is_in = np.repeat(np.array(scenes, np.bool_), np.diff(part.starts["o"]))
            rows.append(self.firsts[at] + np.flatnonzero(is_in & where.hold(part.arrays)))
        return np.concatenate(rows)

    def place(self, row: int) -> Place:
        """Return where a row is."""
        at = int(np.searchsorted(self.firsts, row, "right")) - 1
        part, own = self.parts[at], int(row - self.firsts[at])
        scene = int(np.searchsorted(part.starts["o"], own, "right")) - 1
        return Place(part, own, scene, own - int(part.starts["o"][scene]))

    def described(self, rows: Indices) -> Described:
        """Return the descriptors of ascending rows, of unit length. Raises: FormatError: some have no direction."""
        numbers, starts = self.stored(rows)
        vectors = numbers.astype(np.float32)
        return Described(vectors / lengths_of(vectors, self.path)[:, None], starts)

    def stored(self, rows: Indices) -> tuple[Int8[Array, "P D"], OtherIndices]:
        """Return the descriptors of ascending rows as files have them; row i has those from starts[i] to [i + 1]."""
        runs = [np.empty((0, self.encoder.dim), np.int8)]
        counts = [np.empty(0, np.int64)]
        bounds = np.searchsorted(rows, self.firsts)
        for at, part in enumerate(self.parts):
            own, starts = rows[bounds[at] : bounds[at + 1]] - self.firsts[at], part.starts["p"]
            runs += [part.arrays["descriptors"][starts[begin] : starts[end]] for begin, end in spans_of(own).tolist()]
            counts.append(starts[own + 1] - starts[own])
        return np.concatenate(runs), np.append(0, np.cumsum(np.concatenate(counts)))

    def spread(self, count: int) -> Described:
        """Return the descriptors of some objects, evenly spread over all."""
        last = len(self.all_rows) - 1
        return self.described(self.all_rows[np.unique(np.linspace(0, last, min(count, last + 1)).astype(np.int64))])

    def verify(self) -> list[str]:
        """Compare every byte with its checksum; return the names of the files. Raises: FormatError: damage."""
        check_document(self.path / DOCUMENT)
        for file in self.contents.files:
            read_arrays(self.path / file.name, file, {}, whole=True)
        return [DOCUMENT, *sorted(file.name for file in self.contents.files)]


def lengths_of(vectors: Embeddings, path: Path) -> Numbers:
    """Return the length of each vector. Raises: FormatError: some have none."""
    lengths = np.sqrt(np.einsum("pd,pd->p", vectors, vectors))
    if not (lengths > 0).all():
        raise FormatError(f"{path}: descriptors without a direction: {CURE}")
    return np.asarray(lengths)


def read_arrays(
    path: Path, file: FileEntry, expected: Mapping[str, tuple[str, str]], whole: bool = False
) -> tuple[Arrays, dict[str, str]]:
    """Return the arrays of a file and its metadata. whole: compare also large ones with their checksums.

    Raises: InputError: it is missing. FormatError: another file than was written, or other arrays than expected.
    """
    arrays, about = map_tensors(path)
    if header_checksum(about) != file.crc32:
        raise FormatError(f"{path}: damaged: it is not what was written")
    check_tensors(arrays, expected, str(path))
    if whole or sum(array.nbytes for array in arrays.values()) <= SMALL_BYTES:
        check_checksums(arrays, about, str(path))
    return arrays, about


def current(path: Path, before: Snapshot | None = None, coded: bool = False) -> Snapshot | None:
    """Open the current version; None if there is none yet. before: an earlier one, whose files are not read again.

    coded: open its codes, too.

    Raises: FormatError: the folder holds something else, or is damaged.
    """
    while True:
        content = _document_bytes(path)
        if content is None:
            return None
        snapshot = before
        if before is None or before.content != content:
            snapshot = Snapshot(path, content)
            names = {file.name for file in snapshot.contents.files}
            opened = {} if before is None else before.opened
            snapshot.opened.update({name: file for name, file in opened.items() if name in names})
        assert snapshot is not None
        try:
            _ = snapshot.parts, coded and snapshot.codes
            return snapshot
        except DrSplatError:
            if _document_bytes(path) == content:
                raise  # else it was replaced meanwhile, and its files removed


def _document_bytes(path: Path) -> bytes | None:
    try:
        with open_file(path / DOCUMENT) as file:
            return file.read()
    except (FileNotFoundError, NotADirectoryError):
        if not path.exists() or (path.is_dir() and all(name.suffix == ".tmp" for name in path.iterdir())):
            return None
        raise _no_catalogue(path) from None


def _no_catalogue(path: Path) -> FormatError:
    if (path / FORMER).exists():
        return FormatError(f"{path}: a catalogue that an earlier drsplat made: {AGAIN}")
    return FormatError(f"{path}: expected a catalogue, a folder with {DOCUMENT}: `drsplat catalogue add` makes one")
