"""Growth: arrays beside a field's evidence that let views come and go (growth.safetensors, docs/growing.md)."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from ..base.arrays import Arrays, ArraysByName, OtherIds, Sparse, UnsignedIds
from ..errors import FormatError, InputError
from ..formats.json_files import as_fields, as_kind, document_in, excerpt
from ..formats.tensors import check_tensors
from .codes import PQ, Code, CodeSpecification, Mixture, PQCode, Smaller
from .codes.mixture import MixtureCode, SceneAtoms, quantised
from .codes.mixture.dictionary import SCENE_ATOM
from .evidence.evidence import check_starts, csr_of
from .evidence.provenance import Provenance

GIVEN = "codebook"

_ARRAYS = {
    "axes": ("float64", "v a k"), "keys": ("uint8", "v b"),
    "rest_ids": ("uint32", "q"), "rest_indptr": ("int32 int64", "q1"),
    "rest_indices": ("int32", "e"), "rest_data": ("float32", "e"),
}  # fmt: skip
_SCENE_ARRAYS = {
    "scene_vectors": ("float32", "a D"), "scene_centres": ("float32", "g D"),
    "scene_members": ("int32", "g m"), "scene_places": ("int32", "p"),
}  # fmt: skip


class _About(NamedTuple):
    """Part of the manifest that is of growth."""

    code: object
    isa: str
    level: str | None
    removed: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Growth:
    """How a field was made, as far as neither its features nor its evidence say.

    code: what was wished for; None: a codebook that was given, which is the field's. rest_ids, rest: Gaussians that
    masks see but that have no feature, ascending, and their rows of W. learnt_from: the views that the codebook or the
    scene's atoms were learnt from. scene_atoms: of a mixture, and scene_places: the numbers among them of the code's
    atoms that are no mask's. removed: views that people took out, and that come back only when they are asked back.

    Raises: InputError: arrays that do not fit each other.
    """

    provenance: Provenance
    code: PQ | Mixture | Smaller | None
    rest_ids: UnsignedIds
    rest: Sparse
    learnt_from: tuple[str, ...] = ()
    scene_atoms: SceneAtoms | None = None
    scene_places: OtherIds | None = None
    removed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        ids = self.rest_ids
        if ids.ndim != 1 or ids.dtype != np.uint32 or not (ids[1:] > ids[:-1]).all():
            raise InputError("rest_ids: expected ascending uint32 (q,)")
        if self.rest.shape[0] != len(ids):
            raise InputError(f"rest: expected {len(ids)} rows, got {self.rest.shape[0]}")
        data, indices = self.rest.data, self.rest.indices
        if len(data) and not (0 <= data.min() <= data.max() < np.inf and indices.min() >= 0):
            raise InputError("rest: expected finite weights of 0 or more, of columns")
        if len(indices) and indices.max() >= self.rest.shape[1]:
            raise InputError(f"rest: column {indices.max()} of {self.rest.shape[1]}")

    def specification(self, code: Code) -> CodeSpecification:
        """Return the specification to code with, given the code that the field has."""
        if self.code is not None:
            return self.code
        if not isinstance(code, PQCode):
            raise InputError("growth: expected the codebook that the field was coded with")
        return code.codebook

    def check_field(self, rows: int, count: int, masks: int, views: int) -> None:
        """Refuse those of another field. Raises: InputError."""
        if len(self.provenance) != views or self.rest.shape[1] != masks:
            raise InputError(
                f"growth: of {len(self.provenance)} views and {self.rest.shape[1]} masks in evidence of {views} "
                f"and {masks}"
            )
        if rows + len(self.rest_ids) > count or (len(self.rest_ids) and self.rest_ids[-1] >= count):
            raise InputError(f"growth: {len(self.rest_ids)} further rows of a scene of {count} Gaussians")

    def check_code(self, code: Code) -> None:
        """Refuse scene atoms or columns of another code. Raises: InputError."""
        masks = code.atoms.masks if isinstance(code, MixtureCode) else np.empty(0, np.int32)
        places = 0 if self.scene_places is None else len(self.scene_places)
        if np.count_nonzero(masks == SCENE_ATOM) != places:
            raise InputError(f"growth: {places} scene atoms, of which the code has others")
        if masks.max(initial=-1) >= self.rest.shape[1]:
            raise InputError(f"growth: atoms of mask {masks.max()} among {self.rest.shape[1]}")
        if self.scene_atoms is not None and self.scene_atoms.vectors.shape[1] != code.dim:
            raise InputError(f"growth: scene atoms of {self.scene_atoms.vectors.shape[1]} numbers, not {code.dim}")

    def tensors(self) -> Arrays:
        """Return its arrays by name, as they are written to files; `json` and `metadata` hold the rest."""
        come, rest = self.provenance, self.rest
        arrays = {
            "axes": come.axes, "keys": come.keys, "rest_ids": self.rest_ids,
            "rest_indptr": rest.indptr, "rest_indices": rest.indices, "rest_data": rest.data,
        }  # fmt: skip
        if come.cameras is not None:
            arrays["cameras"] = come.cameras
        if self.scene_atoms is None or self.scene_places is None:
            return arrays
        atoms = self.scene_atoms
        scene = (atoms.vectors, atoms.centres, atoms.members, self.scene_places)
        return arrays | dict(zip(_SCENE_ARRAYS, scene, strict=True))

    def metadata(self) -> dict[str, str]:
        return {"learnt_from": json.dumps(self.learnt_from)}

    def json(self) -> dict[str, object]:
        """Return what the manifest has of it."""
        come = self.provenance
        return {"code": _code_json(self.code), "isa": come.isa, "level": come.level, "removed": list(self.removed)}


def growth_from_tensors(
    tensors: ArraysByName, metadata: Mapping[str, str], document: object, masks: int, where: str
) -> Growth:
    """Read what `Growth.tensors`, `metadata` and `json` wrote. masks: number of masks of the field's evidence.

    Raises: FormatError: something is missing, of another type, or does not fit the rest.
    """
    check_tensors(tensors, _ARRAYS, where)
    has_scene = "scene_vectors" in tensors
    if has_scene:
        check_tensors(tensors, _SCENE_ARRAYS, where)
    try:
        about: _About = as_kind(document, _About, f"{where}: growth")
        learnt_from = as_kind(
            document_in(metadata.get("learnt_from", ""), where), tuple[str, ...], f"{where}: learnt_from"
        )
        provenance = Provenance(tensors["axes"], tensors["keys"], about.isa, about.level, tensors.get("cameras"))
        atoms, places = _scene(tensors) if has_scene else (None, None)
        code, rest = _code_from_json(about.code, f"{where}: growth: code"), _rest(tensors, masks)
        return Growth(provenance, code, tensors["rest_ids"], rest, learnt_from, atoms, places, about.removed)
    except FormatError:
        raise
    except ValueError as error:  # ours, or SciPy's
        raise FormatError(f"{where}: {error}") from error


def _rest(tensors: ArraysByName, masks: int) -> Sparse:
    indptr, indices, data = (tensors[f"rest_{name}"] for name in ("indptr", "indices", "data"))
    check_starts(indptr, len(indices))
    return csr_of(indptr, indices, data, masks)


def _scene(tensors: ArraysByName) -> tuple[SceneAtoms, np.ndarray]:
    vectors, centres, members, places = (tensors[name] for name in _SCENE_ARRAYS)
    for name, numbers in (("members", members), ("places", places)):
        if numbers.size and not 0 <= numbers.min() <= numbers.max() < len(vectors):
            raise InputError(f"scene_{name}: expected numbers among {len(vectors)} atoms")
    if not np.isfinite(centres).all() or not centres.size or not members.size:
        raise InputError("scene_centres: expected finite numbers, and members of each")
    return SceneAtoms(vectors, centres, members, quantised(vectors)), places


_KINDS: Mapping[str, type[PQ] | type[Mixture] | type[Smaller]] = {"pq": PQ, "mixture": Mixture, "auto": Smaller}


def _code_json(code: PQ | Mixture | Smaller | None) -> dict[str, object]:
    kinds = [kind for kind, made in _KINDS.items() if type(code) is made]
    return {"kind": GIVEN} if code is None else {"kind": kinds[0], **asdict(code)}


def _code_from_json(document: object, where: str) -> PQ | Mixture | Smaller | None:
    kind = as_fields(document, where, kind=str)["kind"]
    if kind == GIVEN:
        return None
    if kind not in _KINDS:
        raise FormatError(f"{where}: expected {', '.join(map(repr, _KINDS))} or '{GIVEN}', got {excerpt(kind)}")
    code: PQ | Mixture | Smaller = as_kind(document, _KINDS[kind], where)
    if any(count is not None and count < 1 for count in asdict(code).values()):
        raise FormatError(f"{where}: expected counts of 1 or more, got {code}")
    return code
