"""Choice of an image's masks, and the mask maps that are stored."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...base.arrays import Array, Float64, Indices, Int32, Int64, MaskIds
from ...errors import InputError
from .masks import LEVELS, Masks

_MIN_INSIDE_SHARE = 0.85  # of the inner mask that lies in the outer one
_MAX_INNER_SHARE = 0.5  # of the outer mask that the inner one covers


@dataclass(frozen=True)
class MaskMaps:
    """Masks of one photo, ready to be embedded and stored.

    mask_ids: by level in the order of LEVELS; -1 for no mask, else the row in masks. masks: all
    that have a pixel in a map; row i of the embeddings is that of mask i.
    """

    mask_ids: Int32[Array, "4 h w"]
    masks: Masks


def mask_nms(masks: Masks, max_iou: float = 0.8, min_score: float = 0.7, inner: float = 0.5) -> Indices:
    """Return the indices of the masks that stay, ascending.

    A mask goes if it has no pixels; if its score is not above min_score; if its IoU with one of a
    higher score (of equal ones the earlier) is above max_iou; or if it lies inside a far larger
    one: at least 85 % of it, covering less than half of that one, whichever scores higher, and the
    product of the two shares is below `inner` (at 0.5 it always is). Every mask counts against the
    others, also one that goes itself: the result does not depend on an order of removal.

    Where no score is above min_score nothing stays; the published code fails there.
    Source: LangSplat preprocess.py, mask_nms (scores are stability times predicted IoU).
    """
    shared = overlaps(masks)
    areas = np.diag(shared)
    gone = (areas == 0) | ~(masks.scores > min_score)
    union = np.maximum(areas[:, None] + areas - shared, 1)
    rank = np.empty(len(masks), np.int64)
    rank[np.argsort(-masks.scores, kind="stable")] = np.arange(len(masks))
    better = rank[:, None] < rank
    gone |= (better & (shared / union > max_iou)).any(0)
    of_outer: Float64[Array, "n n"] = shared / np.maximum(areas, 1)[:, None]
    of_inner = of_outer.T
    inside = (of_outer < _MAX_INNER_SHARE) & (of_inner >= _MIN_INSIDE_SHARE)
    gone |= (inside & (1 - of_inner * of_outer > 1 - inner)).any(0)
    return np.flatnonzero(~gone).astype(np.int64)


def overlaps(masks: Masks) -> Int64[Array, "n n"]:
    """Count the pixels that each two masks share, exactly; the diagonal holds areas.

    Every row of the image is cut wherever any mask begins or ends; the pieces are then inside or
    outside of a mask as a whole, and the answer is a sparse product over pieces instead of pixels.
    """
    from scipy.sparse import csr_array  # which readers of features do without

    starts, ends, owners = _runs(masks)
    marks = np.zeros(masks.height * (masks.width + 1), bool)  # np.unique takes several times as long
    marks[starts] = marks[ends] = True
    cuts = np.flatnonzero(marks)
    first, last = np.searchsorted(cuts, starts), np.searchsorted(cuts, ends)
    counts = last - first
    pieces = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
    per_mask = np.bincount(owners, counts, minlength=len(masks)).astype(np.int64)
    rows = np.concatenate([[0], np.cumsum(per_mask)])
    inside = (pieces.astype(np.int32), rows.astype(np.int32))  # narrow: half the product's time
    shape = (len(masks), max(len(cuts), 1))
    member = csr_array((np.ones(len(pieces), np.int32), *inside), shape=shape)
    sized = csr_array((np.diff(cuts).astype(np.int32)[pieces], *inside), shape=shape)
    return (member @ sized.T).toarray().astype(np.int64)


def _runs(masks: Masks) -> tuple[Indices, Indices, Indices]:
    """Return starts and ends of the runs of pixels, y * (width + 1) + x, and the mask of each run."""
    none = np.empty(0, np.int64)
    edges = [none] + [_edges(masks, i) for i in range(len(masks))]
    joined = np.concatenate(edges)
    owners = np.repeat(np.arange(len(masks)), [len(ends) // 2 for ends in edges[1:]])
    return joined[::2], joined[1::2], owners.astype(np.int64)


def _edges(masks: Masks, index: int) -> Indices:
    """Return start, end, start, end... of the runs of one mask, row by row."""
    part, (x0, y0, _, _) = masks.parts[index], masks.boxes[index].astype(np.int64)
    fenced = np.zeros((part.shape[0], part.shape[1] + 2), bool)
    fenced[:, 1:-1] = part
    y, x = np.divmod(np.flatnonzero(fenced[:, 1:] != fenced[:, :-1]), part.shape[1] + 1)
    return (y + y0) * (masks.width + 1) + x + x0


def paint(masks: Masks) -> MaskIds:
    """Return for each pixel the number of the last mask that covers it, -1 where none does.

    Later masks paint over earlier ones. Source: LangSplat preprocess.py, which paints in the order
    in which the mask generator returns them.
    """
    ids = np.full((masks.height, masks.width), -1, np.int32)
    for i, ((x0, y0, x1, y1), part) in enumerate(zip(masks.boxes, masks.parts, strict=True)):
        ids[y0:y1, x0:x1][part] = i
    return ids


def mask_maps(levels: Mapping[str, Masks]) -> MaskMaps:
    """Return the four maps of a photo, ids counted on from level to level: default, small, medium, large.

    Masks of `large` alone serve as all four levels, with the same ids. A mask that later ones paint over completely is
    left out: no pixel would refer to its row, and it need not be embedded (LangSplat's own files keep such rows).

    Raises: InputError: other levels than these, levels of different sizes.
    Source: LangSplat preprocess.py; Dr. Splat preprocessing.py (one level in all four).
    """
    if set(levels) == {"large"}:
        ids, masks = _painted(levels["large"], 0)
        return MaskMaps(np.stack([ids] * len(LEVELS)), masks)
    if set(levels) != set(LEVELS):
        raise InputError(f"levels: expected {', '.join(LEVELS)} or large alone, got {set(levels)}")
    maps: list[MaskIds] = []
    shown: list[Masks] = []
    for level in LEVELS:
        ids, masks = _painted(levels[level], sum(map(len, shown)))
        maps.append(ids)
        shown.append(masks)
    sizes = {(masks.width, masks.height) for masks in shown}
    if len(sizes) != 1:
        raise InputError(f"levels: expected masks of one image, got sizes {sorted(sizes)}")
    joined = Masks(
        shown[0].height, shown[0].width, np.concatenate([masks.boxes for masks in shown]),
        tuple(part for masks in shown for part in masks.parts), np.concatenate([masks.scores for masks in shown]),
    )  # fmt: skip
    return MaskMaps(np.stack(maps), joined)


def _painted(masks: Masks, first_id: int) -> tuple[MaskIds, Masks]:
    """Return a level's map with ids from first_id on, and the masks that are seen in it."""
    ids = paint(masks)
    used = np.zeros(len(masks) + 1, bool)  # the last is that of -1
    used[ids] = True
    shown = np.flatnonzero(used[:-1]).astype(np.int64)
    renumbered = np.full(len(masks) + 1, -1, np.int32)
    renumbered[shown] = first_id + np.arange(len(shown), dtype=np.int32)
    return renumbered[ids], masks.subset(shown)
