"""Fields from disk: believed only as far as their files agree.

What a file holds is compared with its checksums when it is first used: comparing all at once would cost several times
what loading costs, and most of it is often not used. See docs/formats.md, Checksums.
"""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import FormatError, InputError, MismatchError
from ..formats.field_folder import MANIFEST, read_manifest
from ..formats.json_files import MAX_GAUSSIANS, as_vector, excerpt, is_text
from ..formats.scenes import Kind, mistaken
from ..formats.tensors import (
    DOCUMENT,
    check_checksums,
    check_document,
    check_seal,
    check_tensors,
    map_tensors,
    read_tensors,
)
from ..kernels import group_codes
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

FIRST_SEALED_VERSION = 3  # the first with checksums

LATER = (OBJECTS, GROWTH)  # read when they are first asked for: a search needs neither

CURE = "Restore the field from a copy, or register again"

_Manifest = dict[str, object]
_Tensors = dict[str, np.ndarray]
_ARRAYS = {"gaussian_ids": ("uint32", "r"), "coarse_ids": ("uint16", "r"), "inverse_norms": ("float32", "r")}
_OLD_CODES, _GROUPED_CODES = {"codes": ("uint8", "r L")}, {"grouped_codes": ("uint8", "g L k")}


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

    def compared_by(self, checks: Mapping[str, Callable[["StoredField"], None]]) -> "StoredField":
        """Return this field with checks to run once, before a file's arrays are used."""
        self.__dict__["_checks"] = dict(checks)
        return self

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
    manifest = _checked_manifest(path)
    files = {name: _tied(path, name, manifest) for name in _names(manifest) if name not in LATER}
    scene, count = manifest.get("scene"), manifest.get("num_gaussians")
    if not isinstance(scene, str) or type(count) is not int or not 0 < count <= MAX_GAUSSIANS:
        raise FormatError(f"{path}: expected the scene's fingerprint and its number of Gaussians")
    tensors = files[CODES].tensors
    code = _searched_on(_code(tensors, manifest, path), search_device)
    evidence, up = _evidence(files.get(EVIDENCE)), manifest.get("up")
    try:
        field = StoredField(
            tensors["gaussian_ids"],
            code,
            encoder_from_json(manifest.get("encoder"), str(path)),
            scene,
            count,
            evidence,
            _negatives(files.get(NEGATIVES), manifest, code.dim),
            record_from_json(manifest.get("aggregator"), str(path)),
            _contrast(files.get(CONTRAST), manifest, code.dim),
            None if up is None else as_vector(up, 3, f"{path}: up"),  # older versions have none
            _left_out(manifest.get("left_out", []), path),
        )
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error
    field.__dict__["fingerprint"] = str(manifest.get("field"))
    checks = {name: partial(_compare, file, evidence if name == EVIDENCE else None) for name, file in files.items()}
    for name in LATER:
        if name in _names(manifest):
            if not (path / name).exists():
                raise FormatError(f"{path}: incomplete: there is no {name}. {CURE}")
            checks[name] = partial(_LATER_READ[name], path, manifest)
    return field.compared_by(checks)


def verify_field(path: str | os.PathLike[str]) -> list[str]:
    """Compare every byte of a field's files with their checksums, then read all; return the names of the files.

    Fields of versions 1 and 2 have no checksums: they are read, and no names are returned.

    Raises: as `load_field`.
    """
    path = Path(path)
    manifest = read_manifest(path)
    names: list[str] = []
    try:
        if DOCUMENT in manifest or manifest.get("version") not in range(1, FIRST_SEALED_VERSION):
            check_document(path / MANIFEST)
            names = [name for name in _names(manifest) if (path / name).exists()]
        for name in names:
            read_tensors(path / name)
    except FormatError as error:
        raise FormatError(f"{error}. {CURE}") from error
    load_field(path).verify()
    return sorted([*names, MANIFEST]) if names else []


def _checked_manifest(path: Path) -> _Manifest:
    """Read a manifest of a version that can be read. Raises: as `load_field`."""
    if not (path / MANIFEST).exists():
        raise mistaken(path, Kind.FIELD)
    manifest = read_manifest(path)
    if manifest.get("format") != FORMAT:
        raise FormatError(f"{path}: expected a '{FORMAT}', got {ascii(manifest.get('format'))[:60]}")
    version = manifest.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        raise FormatError(
            f"{path}: version {ascii(version)[:20]} of drsplat {ascii(manifest.get('drsplat'))[:20]}; this one reads 1 "
            f"to {VERSION}: upgrade, or register again"
        )
    check_seal(manifest, f"{path / MANIFEST}", version >= FIRST_SEALED_VERSION, CURE)
    return manifest


class _File(NamedTuple):
    """One of a field's files. is_summed: whether it must have checksums."""

    path: Path
    tensors: _Tensors
    metadata: dict[str, str]
    is_summed: bool


def _compare(file: _File, evidence: Evidence | None, _: StoredField | None = None) -> None:
    try:
        check_checksums(file.tensors, file.metadata, str(file.path), file.is_summed)
        if evidence is not None:
            evidence.check_weights()
    except FormatError as error:
        raise FormatError(f"{error}. {CURE}") from error
    except InputError as error:
        raise FormatError(f"{file.path}: {error}. {CURE}") from error


def _left_out(document: object, path: Path) -> tuple[str, ...]:
    """Return the views that were left out, none for fields of older versions."""
    if not isinstance(document, list) or not all(map(is_text, document)):
        raise FormatError(f"{path}: left_out: expected a list of photos' names, got {excerpt(document)}")
    return tuple(document)


def _code(tensors: _Tensors, manifest: _Manifest, path: Path) -> Code:
    """Read a code of any kind; version 1 had product quantisation only, and wrote codes row by row."""
    where = str(path / CODES)
    old = manifest.get("version") == 1
    about = manifest.get("codebook" if old else "code")
    if not isinstance(about, dict):
        raise FormatError(f"{path}: expected how the features are coded")
    kind = PQCode.kind if old else about.get("kind")
    if kind == MixtureCode.kind:
        expected = {"gaussian_ids": _ARRAYS["gaussian_ids"]}
        check_tensors(tensors, expected, where)
        return mixture_from_tensors(tensors, where)
    if kind != PQCode.kind:
        raise FormatError(
            f"{path}: features kept as {ascii(kind)[:40]}; this version of drsplat reads '{PQCode.kind}' "
            f"and '{MixtureCode.kind}'"
        )
    expected_hash = about.get("hash" if old else "codebook")
    codebook = codebook_from_tensors(tensors, about.get("encoder"), expected_hash, where)
    expected = {k: v for k, v in _ARRAYS.items() if k != "coarse_ids" or k in tensors}
    check_tensors(tensors, expected | (_OLD_CODES if old else _GROUPED_CODES), where)
    grouped = group_codes(tensors["codes"]) if old else tensors["grouped_codes"]
    try:
        return PQCode(codebook, grouped, tensors.get("coarse_ids"), tensors["inverse_norms"])
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _searched_on(code: Code, device: str) -> Code:
    if device == "cpu":
        return code
    from .codes.device_code import searched_on

    return searched_on(code, device)


def _names(manifest: _Manifest) -> list[str]:
    """Return the names of the files that must be there."""
    files = manifest.get("files")
    listed = files if isinstance(files, list) else []
    return [CODES, *(name for name in (EVIDENCE, NEGATIVES, CONTRAST, *LATER) if name in listed)]


def _tied(path: Path, name: str, manifest: _Manifest) -> _File:
    """Return one file, if it was written together with the manifest."""
    try:
        tensors, metadata = map_tensors(path / name)
    except InputError as error:
        raise FormatError(f"{path}: incomplete: {error}") from None
    if metadata.get("field") != manifest.get("field"):
        raise MismatchError(f"{path / name} was written with another field: do not mix files of two fields")
    return _File(path / name, tensors, metadata, int(str(manifest["version"])) >= FIRST_SEALED_VERSION)


def _evidence(file: _File | None) -> Evidence | None:
    return file and evidence_from_tensors(file.tensors, file.metadata, str(file.path))


def _negatives(file: _File | None, manifest: _Manifest, dim: int) -> Negatives | None:
    if file is None:
        return None
    path, tensors = file.path, file.tensors
    expected = {"embeddings": ("float32", "n D"), "maxima": ("float32", "r")}
    check_tensors(tensors, expected, str(path))
    texts, embeddings = manifest.get("negatives"), tensors["embeddings"]
    if embeddings.shape[1] != dim:
        raise FormatError(f"{path}: expected embeddings (n, {dim}), got {embeddings.shape}")
    if not (np.isfinite(embeddings).all() and np.isfinite(tensors["maxima"]).all()):
        raise FormatError(f"{path}: expected finite embeddings and maxima. {CURE}")
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise FormatError(f"{path.parent}: negatives must be a list of texts")
    if texts and len(texts) != len(embeddings):
        raise FormatError(f"{path.parent}: {len(texts)} negative texts for {len(embeddings)} embeddings")
    return Negatives(tuple(texts), embeddings, tensors["maxima"])


def _contrast(file: _File | None, manifest: _Manifest, dim: int) -> WordList | None:
    if file is None:
        return None
    check_tensors(file.tensors, {"embeddings": ("float32", "n D")}, str(file.path))
    texts, embeddings = manifest.get("contrast"), file.tensors["embeddings"]
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise FormatError(f"{file.path.parent}: contrast must be a list of texts")
    if embeddings.shape != (len(texts), dim) or not texts:
        raise FormatError(f"{file.path}: expected ({len(texts)}, {dim}), got {embeddings.shape}")
    if not np.isfinite(embeddings).all():
        raise FormatError(f"{file.path}: expected finite embeddings. {CURE}")
    return WordList(tuple(texts), embeddings)


def _read_objects(path: Path, manifest: _Manifest, field: StoredField) -> None:
    """Read the objects of a field. Raises: as `load_field`."""
    file = _tied(path, OBJECTS, manifest)
    check_tensors(file.tensors, ARRAYS, str(file.path))
    try:
        objects = Objects(**{name: file.tensors[name] for name in ARRAYS}, votes=file.metadata.get("votes", ""))
        evidence = field.__dict__["evidence"]
        objects.check_field(len(field), field.encoder.dim, (None if evidence is None else len(evidence.masks)))
    except InputError as error:
        raise FormatError(f"{file.path}: {error}. {CURE}") from error
    _compare(file, None)
    field.__dict__["objects"] = objects


def _read_growth(path: Path, manifest: _Manifest, field: StoredField) -> None:
    """Read the growth of a field. Raises: as `load_field`."""
    file, evidence = _tied(path, GROWTH, manifest), field.__dict__["evidence"]
    if evidence is None:
        raise FormatError(f"{file.path}: belongs to evidence, and there is none. {CURE}")
    masks = evidence.masks
    try:
        growth = growth_from_tensors(file.tensors, file.metadata, manifest.get("growth"), len(masks), f"{file.path}")
        growth.check_field(len(field), field.num_gaussians, len(masks), len(masks.view_names))
        growth.check_code(field.__dict__["code"])
    except InputError as error:
        raise FormatError(f"{file.path}: {error}. {CURE}") from error
    _compare(file, None)
    field.__dict__["growth"] = growth


_LATER_READ = {OBJECTS: _read_objects, GROWTH: _read_growth}
