"""Objects of a scene in blocks beside those of the scene in one piece: how many Gaussians belong to the same object.

    python benchmarks/study_blocks.py room.field=scene.ply [...] [--parts 2 4 8]

Same: each object of the one is paired with one of the other, pairs of the largest IoU first; a Gaussian is the same
where its two objects are a pair, or where it has none in both. Whole: objects with the same Gaussians, to the last one.
parts: blocks are of this part of the weights at most. To compare with: what changes where one photo is left out, and
where the weight at which a view counts half (`soft`) is a thousandth larger; in one piece.
"""

import argparse
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from scipy.sparse import csr_array

import drsplat as ds
from drsplat.field.evidence.changing import without_views
from drsplat.field.evidence.evidence import Evidence
from drsplat.field.forest import THING
from drsplat.field.objects import finding
from drsplat.field.objects.choosing import NONE, _owners
from drsplat.field.objects.finding import tree_of


def things(evidence: Evidence, points: np.ndarray) -> np.ndarray:
    """The node of the thing that each row belongs to, -1 for none."""
    tree = tree_of(evidence, points).tree
    return np.append(_owners(tree.parents, tree.levels == THING), NONE)[tree.node_of]


def compared(one: np.ndarray, other: np.ndarray) -> tuple[float, int, int, int]:
    """Share of rows with the same object, objects that are the same to the last row, and the numbers of objects."""
    shape = int(one.max(initial=NONE)) + 2, int(other.max(initial=NONE)) + 2
    both = csr_array((np.ones(len(one)), (one + 1, other + 1)), shape=shape).toarray()
    sizes = both.sum(axis=1), both.sum(axis=0)
    iou = (both / np.maximum(sizes[0][:, None] + sizes[1] - both, 1))[1:, 1:]
    a, b = np.nonzero(iou)
    taken, same, whole = (set[int](), set[int]()), both[0, 0], 0
    for k in np.argsort(-iou[a, b], kind="stable").tolist():
        if a[k] not in taken[0] and b[k] not in taken[1]:
            taken[0].add(int(a[k]))
            taken[1].add(int(b[k]))
            same += both[a[k] + 1, b[k] + 1]
            whole += iou[a[k], b[k]] == 1
    return same / len(one), int(whole), *(int((size[1:] > 0).sum()) for size in sizes)


def in_blocks(evidence: Evidence, points: np.ndarray, parts: int) -> tuple[int, np.ndarray]:
    weights = evidence.weights.nnz
    with (
        patch.object(finding, "MAX_WEIGHTS", 0),
        patch.object(finding, "WEIGHTS_PER_ROW", weights),
        patch.object(finding, "BLOCK_WEIGHTS", int(1.02 * weights / parts)),
    ):
        return len(finding.divided(evidence, points).blocks), things(evidence, points)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="FIELD=SCENE")
    parser.add_argument("--parts", type=int, nargs="+", default=[2, 4, 8])
    given = parser.parse_args()
    print("| field | Gaussians | weights | what is changed | same | whole | objects, before and now |")
    print("|---|--:|--:|---|--:|--:|--:|")
    for pair in given.scenes:
        name, scene = pair.split("=")
        field, gaussians = ds.load_field(name), ds.read_gaussians(scene)
        evidence, points = field.evidence, gaussians.means[field.gaussian_ids]
        assert evidence is not None
        whole, views = things(evidence, points), evidence.masks.view_names
        shown = f"| {name} | {len(evidence):,} | {evidence.weights.nnz:,} |"

        def show(what: str, other: np.ndarray, shown: str = shown, whole: np.ndarray = whole) -> None:
            same, equal, before, now = compared(whole, other)
            print(f"{shown} {what} | {same:.3f} | {equal} | {before}, {now} |", flush=True)

        show("one photo less", things(without_views(evidence, np.arange(len(views)) == len(views) // 2), points))
        rule = finding._rule
        with patch.object(
            finding, "_rule", lambda *sums, rule=rule: replace(rule(*sums), soft=1.001 * rule(*sums).soft)
        ):
            show("soft", things(evidence, points))
        for parts in given.parts:
            blocks, found = in_blocks(evidence, points, parts)
            show(f"{blocks} blocks", found)


if __name__ == "__main__":
    main()
