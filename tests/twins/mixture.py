"""The float64 twins of `kernels.mixture`: slow, plain, and what the native kernels must compute."""

import numpy as np

from drsplat.base.arrays import ByteRows, Doubles, Float, Float64, Ids, IndexRows, Indices, Int32, Int64
from drsplat.kernels.mixture import Blocks, Candidates, Dictionary, Encoded

DEPENDENT = 1e-4  # an atom adds nothing if its squared sine to the chosen ones is below
LEAST_GAIN = 1e-8  # of the feature's squared norm


def atoms(dictionary: Dictionary) -> Float64[np.ndarray, "a D"]:
    """What the bytes stand for."""
    return dictionary.values * dictionary.scales.astype(np.float64)[:, None]


def mixture_encode(
    features: Float[np.ndarray, "n D"], dictionary: Dictionary, candidates: Candidates, atoms_per_row: int
) -> Encoded:
    """Of every row, what `encode_row` chooses."""
    table, rows = atoms(dictionary), len(features)
    ids, weights = np.zeros((rows, atoms_per_row), np.int32), np.zeros((rows, atoms_per_row))
    for i, feature in enumerate(features.astype(np.float64)):
        own = candidates.columns[candidates.indptr[i] : candidates.indptr[i + 1]]
        possible = np.concatenate([own, candidates.further[i]])
        places, found = encode_row(table[possible], feature, atoms_per_row)
        order = np.argsort(-found, kind="stable")
        if len(places):
            ids[i] = possible[places[order[0]]]
            ids[i, : len(places)], weights[i, : len(places)] = possible[places[order]], found[order]
    heaviest = weights.max(axis=1, keepdims=True, initial=0)
    ratios = np.divide(weights, heaviest, out=np.zeros_like(weights), where=heaviest > 0)
    whole = np.floor(ratios * 255 + 0.5).astype(np.uint8)
    norms = np.linalg.norm(np.einsum("nk,nkd->nd", whole.astype(np.float64), table[ids]), axis=1)
    scales = np.divide(1, norms, out=np.zeros_like(norms), where=norms > 0)
    return Encoded(ids, whole, scales.astype(np.float32))


def encode_row(
    candidates: Float64[np.ndarray, "c D"], feature: Float64[np.ndarray, " D"], wanted: int
) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Places of the chosen candidates, and their weights."""
    chosen, barred = _greedy(candidates, feature, wanted)
    for _ in range(len(chosen)):
        old, rest = chosen[0], chosen[1:]
        best = _best(candidates, feature, rest, barred - {old})
        new = [*rest, old]
        if best not in (None, old):
            tried = [*rest, best]
            better = _explained(candidates, feature, tried) > _explained(candidates, feature, new)
            if better and (_solve(candidates, feature, tried) > 0).all():
                new, barred = tried, (barred - {old}) | {best}
        chosen = new
    _leave_positive(candidates, feature, chosen)
    return np.array(chosen, np.int64), _solve(candidates, feature, chosen)


def _greedy(candidates: np.ndarray, feature: np.ndarray, wanted: int) -> tuple[list[int], set[int]]:
    chosen: list[int] = []
    barred: set[int] = set()
    for _ in range(2 * wanted):
        best = _best(candidates, feature, chosen, barred) if len(chosen) < wanted else None
        if best is None:
            break
        chosen.append(best)
        barred.add(best)
        _leave_positive(candidates, feature, chosen)
    return chosen, barred


def _leave_positive(candidates: np.ndarray, feature: np.ndarray, chosen: list[int]) -> None:
    """Drop the least until all weights are above zero; ends, if not before, with none left."""
    while chosen and (weights := _solve(candidates, feature, chosen)).min() <= 0:
        del chosen[int(weights.argmin())]


def _best(candidates: np.ndarray, feature: np.ndarray, chosen: list[int], barred: set[int]) -> int | None:
    """The candidate that leaves least over together with the chosen ones."""
    basis = np.linalg.qr(candidates[chosen].T)[0]
    left = candidates @ (feature - basis @ (basis.T @ feature))
    norms = 1 - ((candidates @ basis) ** 2).sum(axis=1)
    possible = (left > 0) & (norms >= DEPENDENT)
    possible[list(barred)] = False
    gains = np.where(possible, left**2 / np.maximum(norms, DEPENDENT), 0)
    return int(gains.argmax()) if gains.max(initial=0) > LEAST_GAIN else None


def _solve(candidates: np.ndarray, feature: np.ndarray, chosen: list[int]) -> Float64[np.ndarray, " k"]:
    return np.asarray(np.linalg.lstsq(candidates[chosen].T, feature, rcond=None)[0])


def _explained(candidates: np.ndarray, feature: np.ndarray, chosen: list[int]) -> float:
    return float(((np.linalg.qr(candidates[chosen].T)[0].T @ feature) ** 2).sum())


def nearest_centres(points: Float[np.ndarray, "n D"], centres: Float[np.ndarray, "c D"]) -> Indices:
    """The centre of largest inner product with each point, ties to the lowest."""
    return np.asarray((points.astype(np.float64) @ centres.astype(np.float64).T).argmax(axis=1))


def nearest_members(
    points: Float[np.ndarray, "n D"],
    dictionary: Dictionary,
    groups: Ids,
    members: Int32[np.ndarray, "g m"],
    wanted: int,
) -> Int32[np.ndarray, "n w"]:
    """The `wanted` best members of each point's group, best first, ties to the earlier member."""
    table = atoms(dictionary)
    products = np.einsum("nd,nmd->nm", points.astype(np.float64), table[members[groups]])
    order = np.argsort(-products, axis=1, kind="stable")[:, :wanted]
    return np.take_along_axis(members[groups], order, axis=1)


def in_rows(blocks: Blocks) -> tuple[IndexRows, ByteRows]:
    """Ids and weights row by row."""
    count = len(blocks.scales)
    shape = (-1, blocks.ids.shape[1])
    ids, weights = (part.transpose(0, 2, 1).reshape(shape)[:count] for part in blocks[:2])
    return ids.astype(np.int64), weights


def mixture_scores(
    blocks: Blocks, dictionary: Dictionary, queries: Float[np.ndarray, "q D"]
) -> Float64[np.ndarray, "q n"]:
    """scale_i * sum_k weight_ik * <query, atom of id_ik>."""
    ids, weights = in_rows(blocks)
    products = queries.astype(np.float64) @ atoms(dictionary).T
    sums = (products[:, ids] * weights).sum(axis=2)
    return np.asarray(sums * blocks.scales.astype(np.float64))


def mixture_best(
    blocks: Blocks, dictionary: Dictionary, queries: Float[np.ndarray, "c D"]
) -> tuple[Indices, Doubles, Doubles]:
    """Index and score of the best query of each row, and the second best score (-inf for one query)."""
    scores = mixture_scores(blocks, dictionary, queries)
    ranked = np.sort(scores, axis=0)
    second = ranked[-2] if len(queries) > 1 else np.full(scores.shape[1], -np.inf)
    return scores.argmax(axis=0), ranked[-1], second
