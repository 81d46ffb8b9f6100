"""Fields from disk: believed only as far as their files agree.

What a file holds is compared with its checksums when it is first used: comparing all at once would cost several times
what loading costs, and most of it is often not used. See docs/formats.md, Checksums.
"""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Embeddings, Vector3
from ..errors import FormatError, InputError, MismatchError
from ..formats.field_folder import MANIFEST, read_manifest
from ..formats.json_files import MAX_GAUSSIANS, as_kind
from ..formats.scenes import Kind, mistaken
from ..formats.tensors import check_checksums, check_document, check_seal, check_tensors, map_tensors, read_tensors
from .codes import Code, PQCode, codebook_from_tensors, encoder_from_json
from .codes.mixture import MixtureCode, mixture_from_tensors
from .evidence.aggregation import record_from_json
from .evidence.evidence import Evidence, evidence_from_tensors
from .forest import ARRAYS, Objects
from .growth import growth_from_tensors
from .language_field import (
    CODES,
    CONTRAST,
    EVIDENCE,
    FORMAT,
    GROWTH,
    NEGATIVES,
    OBJECTS,
    VERSION,
    LanguageField,
    Negatives,
    WordList,
)

LATER = (OBJECTS, GROWTH)  # read when they are first asked for: a search needs neither

CURE = "Restore the field from a copy, or register again"

_Tensors = dict[str, np.ndarray]
_PQ_ARRAYS = {
    "gaussian_ids": ("uint32", "r"), "coarse_ids": ("uint16", "r"), "inverse_norms": ("float32", "r"),
    "grouped_codes": ("uint8", "g L k"),
}  # fmt: skip


class _Code(NamedTuple):
    """kind: of the code. codebook, encoder: hash of a product-quantised one's codebook, and the codebook's encoder."""

    kind: str
    codebook: object = None
    encoder: object = None


class _Manifest(NamedTuple):
    """Manifest of a field, as far as it is read; `LanguageField` has the meanings."""

    field: str
    files: tuple[str, ...]
    scene: str
    num_gaussians: int
    encoder: object
    code: _Code
    aggregator: object
    up: Vector3 | None
    left_out: tuple[str, ...]
    negatives: tuple[str, ...]
    contrast: tuple[str, ...]
    growth: object

    @property
    def names(self) -> list[str]:
        """Names of the files that must be there."""
        return [CODES, *(name for name in (EVIDENCE, NEGATIVES, CONTRAST, *LATER) if name in self.files)]


def _guarded(name: str, file: str) -> property:
    def value(self: "StoredField") -> object:
        self._compare(file)
        return self.__dict__[name]

    def keep(self: "StoredField", value: object) -> None:
        self.__dict__[name] = value

    return property(value, keep)


class StoredField(LanguageField):
    """A field whose arrays are maps of files. Made by `load_field`.

    Attributes raise a FormatError where their file is damaged.
    """

    gaussian_ids = _guarded("gaussian_ids", CODES)  # type: ignore[assignment]
    code = _guarded("code", CODES)  # type: ignore[assignment]
    evidence = _guarded("evidence", EVIDENCE)  # type: ignore[assignment]
    negatives = _guarded("negatives", NEGATIVES)  # type: ignore[assignment]
    contrast = _guarded("contrast", CONTRAST)  # type: ignore[assignment]
    objects = _guarded("objects", OBJECTS)  # type: ignore[assignment]  # read as a whole when first used
    growth = _guarded("growth", GROWTH)  # type: ignore[assignment]  # so is this

    def verify(self) -> None:
        """See LanguageField."""
        for file in tuple(self.__dict__.get("_checks", ())):
            self._compare(file)

    def _compare(self, file: str) -> None:
        checks = self.__dict__.get("_checks", {})
        if file in checks:
            checks[file](self)
            checks.pop(file, None)


def load_field(path: str | os.PathLike[str], *, search_device: str = "cpu") -> LanguageField:
    """Read what `LanguageField.save` wrote. Arrays are read-only; those of large files are memory maps.

    What a file holds is compared with its checksums when it is first used, or by `verify`. search_device: "cpu";
    "cuda", a GPU, where the codes lie from the first search on; or "auto", a GPU where there is one.

    Raises: InputError: there is no such field, no such device, or no GPU searches such codes. FormatError: damaged, or
    written by a newer version. MismatchError: files of different fields are mixed. MissingExtraError: "cuda" without
    CuPy or a GPU.

    >>> ds.load_field("room.field").encoder.name
    'drsplat-words'
    """
    path = Path(path)
    manifest = _manifest(path)
    files = {name: _tied(path, name, manifest) for name in manifest.names if name not in LATER}
    evidence: Evidence | None = None
    negatives: Negatives | None = None
    contrast: WordList | None = None
    code = _code(files[CODES], manifest.code)
    if search_device != "cpu":
        from .codes.device_code import searched_on

        code = searched_on(code, search_device)
    if EVIDENCE in files:
        evidence = evidence_from_tensors(files[EVIDENCE].tensors, files[EVIDENCE].metadata, str(path / EVIDENCE))
    if NEGATIVES in files:
        embeddings = _embeddings(files[NEGATIVES], {"maxima": ("float32", "r")}, manifest.negatives, code.dim)
        negatives = Negatives(manifest.negatives, embeddings, files[NEGATIVES].tensors["maxima"])
    if CONTRAST in files:
        contrast = WordList(manifest.contrast, _embeddings(files[CONTRAST], {}, manifest.contrast, code.dim))
    try:
        field = StoredField(
            files[CODES].tensors["gaussian_ids"], code, encoder_from_json(manifest.encoder, str(path)), manifest.scene,
            manifest.num_gaussians, evidence, negatives, record_from_json(manifest.aggregator, str(path)), contrast,
            manifest.up, manifest.left_out,
        )  # fmt: skip
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error
    field.__dict__["fingerprint"] = manifest.field
    checks = {name: partial(_compare, file, evidence if name == EVIDENCE else None) for name, file in files.items()}
    for name in LATER:
        if name in manifest.names:
            if not (path / name).exists():
                raise FormatError(f"{path}: incomplete: there is no {name}. {CURE}")
            checks[name] = partial(_LATER_READ[name], path, manifest)
    field.__dict__["_checks"] = checks  # each is done once, before a file's arrays are used
    return field


def verify_field(path: str | os.PathLike[str]) -> list[str]:
    """Compare every byte of a field's files with their checksums, then read all; return the names of the files.

    Raises: as `load_field`.
    """
    path, names = Path(path), []
    try:
        if (path / MANIFEST).exists():  # else the next line says what lies there
            check_document(path / MANIFEST)
        names = [name for name in _manifest(path).names if (path / name).exists()]
        for name in names:
            read_tensors(path / name)
    except FormatError as error:
        raise FormatError(f"{error}. {CURE}") from error
    load_field(path).verify()
    return sorted([*names, MANIFEST])


def _manifest(path: Path) -> _Manifest:
    """Read the manifest of a field of this version. Raises: as `load_field`."""
    if not (path / MANIFEST).exists():
        raise mistaken(path, Kind.FIELD)
    document = read_manifest(path)
    if document.get("format") != FORMAT:
        raise FormatError(f"{path}: expected a '{FORMAT}', got {ascii(document.get('format'))[:60]}")
    version = document.get("version")
    if type(version) is not int or version != VERSION:
        raise FormatError(
            f"{path}: version {ascii(version)[:20]} of drsplat {ascii(document.get('drsplat'))[:20]}; this one reads "
            f"{VERSION}: upgrade, or register again"
        )
    check_seal(document, f"{path / MANIFEST}", cure=CURE)
    manifest: _Manifest = as_kind(document, _Manifest, str(path))
    if not 0 < manifest.num_gaussians <= MAX_GAUSSIANS:
        raise FormatError(f"{path}: num_gaussians: expected 1 to {MAX_GAUSSIANS:,}, got {manifest.num_gaussians:,}")
    return manifest


class _File(NamedTuple):
    """One of a field's files."""

    path: Path
    tensors: _Tensors
    metadata: dict[str, str]


def _compare(file: _File, evidence: Evidence | None = None, _: StoredField | None = None) -> None:
    try:
        check_checksums(file.tensors, file.metadata, str(file.path))
        if evidence is not None:
            evidence.check_weights()
    except FormatError as error:
        raise FormatError(f"{error}. {CURE}") from error
    except InputError as error:
        raise FormatError(f"{file.path}: {error}. {CURE}") from error


def _code(file: _File, about: _Code) -> Code:
    where, tensors = str(file.path), file.tensors
    if about.kind == MixtureCode.kind:
        check_tensors(tensors, {"gaussian_ids": _PQ_ARRAYS["gaussian_ids"]}, where)
        return mixture_from_tensors(tensors, where)
    if about.kind != PQCode.kind:
        raise FormatError(
            f"{file.path.parent}: features kept as {ascii(about.kind)[:40]}; this version of drsplat reads "
            f"'{PQCode.kind}' and '{MixtureCode.kind}'"
        )
    codebook = codebook_from_tensors(tensors, about.encoder, about.codebook, where)
    check_tensors(tensors, {k: v for k, v in _PQ_ARRAYS.items() if k != "coarse_ids" or k in tensors}, where)
    try:
        return PQCode(codebook, tensors["grouped_codes"], tensors.get("coarse_ids"), tensors["inverse_norms"])
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _tied(path: Path, name: str, manifest: _Manifest) -> _File:
    """Return one file, if it was written together with the manifest."""
    try:
        tensors, metadata = map_tensors(path / name)
    except InputError as error:
        raise FormatError(f"{path}: incomplete: {error}") from None
    if metadata.get("field") != manifest.field:
        raise MismatchError(f"{path / name} was written with another field: do not mix files of two fields")
    return _File(path / name, tensors, metadata)


def _embeddings(file: _File, more: Mapping[str, tuple[str, str]], texts: tuple[str, ...], dim: int) -> Embeddings:
    """Return the embeddings of a file that has one for each text, where there are texts. more: its other arrays."""
    check_tensors(file.tensors, {"embeddings": ("float32", "n D"), **more}, str(file.path))
    embeddings = file.tensors["embeddings"]
    if embeddings.shape != (len(texts) or len(embeddings), dim):
        raise FormatError(f"{file.path}: expected embeddings ({len(texts) or 'n'}, {dim}), got {embeddings.shape}")
    if not all(np.isfinite(array).all() for array in file.tensors.values()):
        raise FormatError(f"{file.path}: expected finite {' and '.join(['embeddings', *more])}. {CURE}")
    return embeddings


def _read_objects(path: Path, manifest: _Manifest, field: StoredField) -> None:
    """Read the objects of a field. Raises: as `load_field`."""
    file, evidence = _tied(path, OBJECTS, manifest), field.__dict__["evidence"]
    check_tensors(file.tensors, ARRAYS, str(file.path))
    try:
        objects = Objects(**{name: file.tensors[name] for name in ARRAYS}, votes=file.metadata.get("votes", ""))
        objects.check_field(len(field), field.encoder.dim, None if evidence is None else len(evidence.masks))
    except InputError as error:
        raise FormatError(f"{file.path}: {error}. {CURE}") from error
    _compare(file)
    field.__dict__["objects"] = objects


def _read_growth(path: Path, manifest: _Manifest, field: StoredField) -> None:
    """Read the growth of a field. Raises: as `load_field`."""
    file, evidence = _tied(path, GROWTH, manifest), field.__dict__["evidence"]
    if evidence is None:
        raise FormatError(f"{file.path}: belongs to evidence, and there is none. {CURE}")
    masks = evidence.masks
    try:
        growth = growth_from_tensors(file.tensors, file.metadata, manifest.growth, len(masks), f"{file.path}")
        growth.check_field(len(field), field.num_gaussians, len(masks), len(masks.view_names))
        growth.check_code(field.__dict__["code"])
    except InputError as error:
        raise FormatError(f"{file.path}: {error}. {CURE}") from error
    _compare(file)
    field.__dict__["growth"] = growth


_LATER_READ = {OBJECTS: _read_objects, GROWTH: _read_growth}
