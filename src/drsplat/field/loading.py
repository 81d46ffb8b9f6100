"""Fields from disk: mapped, not copied, and believed only as far as their files agree."""

import os
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from ..aggregation import record_from_json
from ..codes import Code, PQCode, codebook_from_tensors, encoder_from_json
from ..codes.mixture import MixtureCode, mixture_from_tensors
from ..errors import FormatError, InputError, MismatchError
from ..evidence import Evidence, evidence_from_tensors
from ..formats.field_folder import read_manifest
from ..formats.json_files import as_vector
from ..formats.tensors import check_tensors, map_tensors
from ..kernels import group_codes
from .language_field import (
    CODES,
    EVIDENCE,
    FORMAT,
    NEGATIVES,
    VERSION,
    LanguageField,
    Negatives,
)

MAX_GAUSSIANS = (1 << 31) - 1  # what the native core can count

_Tensors = dict[str, np.ndarray]
_ARRAYS = {
    "gaussian_ids": ("uint32", "r"),
    "coarse_ids": ("uint16", "r"),
    "inverse_norms": ("float32", "r"),
}
_CODES = {1: {"codes": ("uint8", "r L")}, 2: {"grouped_codes": ("uint8", "g L k")}}


def load_field(path: str | os.PathLike[str]) -> LanguageField:
    """Read what `LanguageField.save` wrote. Arrays are read-only memory maps.

    Raises: InputError: there is no such field. FormatError: damaged, or written by a newer version.
    MismatchError: files of different fields are mixed.
    """
    path = Path(path)
    manifest = read_manifest(path)
    if manifest.get("format") != FORMAT:
        raise FormatError(
            f"{path}: expected a '{FORMAT}', got {ascii(manifest.get('format'))[:60]}"
        )
    version = manifest.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        raise FormatError(
            f"{path}: version {ascii(version)[:20]} of drsplat "
            f"{ascii(manifest.get('drsplat'))[:20]}; this one reads 1 to {VERSION}: upgrade, or register "
            "again"
        )
    tensors, _ = _tied(path, CODES, manifest)
    scene, count = manifest.get("scene"), manifest.get("num_gaussians")
    if not isinstance(scene, str) or type(count) is not int or not 0 < count <= MAX_GAUSSIANS:
        raise FormatError(f"{path}: expected the scene's fingerprint and its number of Gaussians")
    code = _code(tensors, manifest, path)
    try:
        return LanguageField(
            tensors["gaussian_ids"],
            code,
            encoder_from_json(manifest.get("encoder"), str(path)),
            scene,
            count,
            _evidence(path, manifest),
            _negatives(path, manifest, code.dim),
            record_from_json(manifest.get("aggregator"), str(path)),
            _up(manifest.get("up"), path),
        )
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


def _up(document: object, path: Path) -> Float64[np.ndarray, " 3"] | None:
    """Fields of older versions have none."""
    return None if document is None else as_vector(document, 3, f"{path}: up")


def _code(tensors: _Tensors, manifest: dict[str, object], path: Path) -> Code:
    """Of any kind; version 1 knew product quantisation only, and wrote codes row by row."""
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
    check_tensors(tensors, expected | _CODES[1 if old else 2], where)
    grouped = group_codes(tensors["codes"]) if old else tensors["grouped_codes"]
    try:
        return PQCode(codebook, grouped, tensors.get("coarse_ids"), tensors["inverse_norms"])
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _has(manifest: dict[str, object], name: str) -> bool:
    files = manifest.get("files")
    return isinstance(files, list) and name in files


def _tied(path: Path, name: str, manifest: dict[str, object]) -> tuple[_Tensors, dict[str, str]]:
    """The arrays of one file, if it was written together with the manifest."""
    try:
        tensors, metadata = map_tensors(path / name)
    except InputError as error:
        raise FormatError(f"{path}: incomplete: {error}") from None
    if metadata.get("field") != manifest.get("field"):
        raise MismatchError(
            f"{path / name} was written with another field: do not mix files of two fields"
        )
    return tensors, metadata


def _evidence(path: Path, manifest: dict[str, object]) -> Evidence | None:
    if not _has(manifest, EVIDENCE):
        return None
    tensors, metadata = _tied(path, EVIDENCE, manifest)
    return evidence_from_tensors(tensors, metadata, str(path / EVIDENCE))


def _negatives(path: Path, manifest: dict[str, object], dim: int) -> Negatives | None:
    if not _has(manifest, NEGATIVES):
        return None
    tensors, _ = _tied(path, NEGATIVES, manifest)
    expected = {"embeddings": ("float32", "n D"), "maxima": ("float32", "r")}
    check_tensors(tensors, expected, str(path / NEGATIVES))
    texts, embeddings = manifest.get("negatives"), tensors["embeddings"]
    if embeddings.shape[1] != dim:
        raise FormatError(
            f"{path / NEGATIVES}: expected embeddings (n, {dim}), got {embeddings.shape}"
        )
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise FormatError(f"{path}: negatives must be a list of texts")
    if texts and len(texts) != len(embeddings):
        raise FormatError(f"{path}: {len(texts)} negative texts for {len(embeddings)} embeddings")
    return Negatives(tuple(texts), embeddings, tensors["maxima"])
