"""A field for the same scene in another file: compressing moves Gaussians a little and puts them in another order."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ..base.arrays import Doubles, Float32, FloatRows, IndexRows, Indices, OtherIndices, OtherPoints, Points, Quats
from ..errors import InputError, MismatchError
from ..formats.json_files import ids_of
from ..scene.gaussians import SH_C0, Gaussians
from .labels import Label
from .language_field import LanguageField

MAX_DISTANCE_SHARE = 0.5  # of the median distance between neighbouring Gaussians
MAX_LOST_SHARE = 0.01  # of the Gaussians with a feature
CANDIDATE_NEIGHBOURS = 8  # of the new scene that are compared with one of the old
BLOCK_GAUSSIANS = 1 << 16
SPACING_SAMPLE = 1 << 16  # Gaussians whose distances to their neighbours are measured


@dataclass(frozen=True, eq=False)
class Assignment:
    """rows: per Gaussian of the old scene its row in the new one, -1 for none; no row comes twice.

    distances: how far it has moved, in scene units. reach: how far it could have.
    """

    rows: Indices
    distances: Doubles
    reach: float
    scene: str
    num_gaussians: int


def assign(old: Gaussians, new: Gaussians, *, threads: int = 0) -> Assignment:
    """Find each Gaussian of a scene again in a changed copy of it.

    It is the one of the eight nearest that is most like it in place, opacity and colour, no further away than half the
    usual distance between neighbours. Each is given away once, to the one that is most like it. Memory is linear in
    the Gaussians.

    Raises: InputError: a scene without Gaussians.
    """
    if not len(old) or not len(new):
        raise InputError(f"expected two scenes with Gaussians, got {len(old):,} and {len(new):,}")
    here, there = old.positions - old.origin, new.positions - old.origin
    reach = MAX_DISTANCE_SHARE * _spacing(here, threads)
    found, costs = _candidates(here, there, reach, _looks(old), _looks(new), threads)
    # give each row of the new scene to one Gaussian: the most alike first, of equal ones the lower row
    rows, taken = np.full(len(found), -1), np.zeros(len(new), bool)
    for choice in range(found.shape[1]):
        (waiting,) = np.nonzero((rows < 0) & np.isfinite(costs[:, choice]))
        wanted = found[waiting, choice]
        waiting, wanted = waiting[~taken[wanted]], wanted[~taken[wanted]]
        best = np.lexsort((waiting, costs[waiting, choice], wanted))
        first = best[np.append(True, np.diff(wanted[best]) > 0)] if len(best) else best
        rows[waiting[first]] = wanted[first]
        taken[wanted[first]] = True
    distances = np.linalg.norm(there[np.maximum(rows, 0)] - here, axis=1)
    return Assignment(rows, np.where(rows < 0, np.inf, distances), reach, new.fingerprint, len(new))


def carry_field(field: LanguageField, assignment: Assignment) -> LanguageField:
    """Return the field for the new scene of an assignment: the same features, evidence and objects at its rows.

    Gaussians that are not found again lose their feature; up to a hundredth may.

    Raises: InputError: an assignment of another scene. MismatchError: too many are not found again.
    """
    if len(assignment.rows) != field.num_gaussians:
        raise InputError(
            f"the field is of {field.num_gaussians:,} Gaussians, the assignment of {len(assignment.rows):,}"
        )
    rows = assignment.rows[field.gaussian_ids]
    lost = int(np.count_nonzero(rows < 0))
    if lost > MAX_LOST_SHARE * len(rows):
        raise MismatchError(
            f"{lost:,} of {len(rows):,} Gaussians with a feature ({lost / len(rows):.1%}) have none of their own in "
            f"the new scene within {assignment.reach:.3g} units, half the usual distance between neighbours; at most "
            f"{MAX_LOST_SHARE:.0%} may. It is another scene, or was moved, thinned out or compressed too coarsely: "
            "give the file that was made of the old scene, or register the new one"
        )
    order, ids = _ascending(rows)
    evidence, negatives, objects, growth = field.evidence, field.negatives, field.objects, field.growth
    if growth is not None:
        rest, rest_ids = _ascending(assignment.rows[growth.rest_ids])
        growth = replace(growth, rest_ids=rest_ids.astype(np.uint32), rest=csr_array(growth.rest[rest]))
    return LanguageField(
        ids.astype(np.uint32), field.code.rows(order), field.encoder, assignment.scene, assignment.num_gaussians,
        evidence=None if evidence is None else replace(evidence, weights=csr_array(evidence.weights[order])),
        negatives=None if negatives is None else replace(negatives, maxima=negatives.maxima[order]),
        aggregator=field.aggregator, contrast=field.contrast, up=field.up, left_out=field.left_out,
        objects=None if objects is None else replace(objects, node_of=objects.node_of[order]),
        growth=growth,
    )  # fmt: skip


def carry_label(label: Label, assignment: Assignment) -> Label | None:
    """Return the label for the new scene; None where none of its Gaussians is found again."""
    ids = ids_of(np.minimum(label.spans, len(assignment.rows)))
    rows = np.sort(assignment.rows[ids])
    rows = rows[rows >= 0]
    return Label.of(label.name, assignment.scene, rows, label.center) if len(rows) else None


def _spacing(points: Points, threads: int) -> float:
    """Return the median distance of a Gaussian to the nearest other one."""
    some = points[:: max(1, len(points) // SPACING_SAMPLE)]
    distances, _ = cKDTree(points).query(some, 2, workers=threads or -1)
    away = distances[:, 1]
    return float(np.median(away[away > 0])) if np.isfinite(away).all() and (away > 0).any() else 0.0


def _looks(gaussians: Gaussians) -> Quats:
    """Return opacity and colour, each from about 0 to 1."""
    return np.column_stack([gaussians.opacities, 0.5 + np.float32(SH_C0) * gaussians.sh[:, 0]])


def _candidates(
    here: Points, there: OtherPoints, reach: float, old: Quats, new: Float32[np.ndarray, "m 4"], threads: int
) -> tuple[IndexRows, FloatRows]:
    """Return rows of the new scene near each Gaussian, the most alike first, and how unlike: infinite out of reach."""
    tree, count = cKDTree(there), min(CANDIDATE_NEIGHBOURS, len(there))
    found, costs = np.empty((len(here), count), np.int64), np.empty((len(here), count), np.float32)
    for begin in range(0, len(here), BLOCK_GAUSSIANS):
        part = slice(begin, begin + BLOCK_GAUSSIANS)
        far, rows = tree.query(here[part], np.arange(1, count + 1), workers=threads or -1)
        unlike = np.abs(old[part, None] - new[rows]).sum(2)
        cost = np.where(far <= reach, far / max(reach, np.finfo(np.float64).tiny) + unlike, np.inf)
        order = np.argsort(cost, axis=1, kind="stable")
        found[part], costs[part] = (np.take_along_axis(values, order, axis=1) for values in (rows, cost))
    return found, costs


def _ascending(rows: OtherIndices) -> tuple[Indices, Indices]:
    """Return which rows are found again, in the order of their new ones, and these."""
    (kept,) = np.nonzero(rows >= 0)
    order = kept[np.argsort(rows[kept])]
    return order, rows[order]
