"""Votes of photos: pieces that their outlines hold together are joined, and what is stronger alone is not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.sparse import csr_array

from drsplat.field.forest import PART, THING, check_forest
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.voting import Vote, Worth, _chosen, with_voted
from drsplat.scene.masks.region_tree import RegionTree

SIZE = 40
# four regions around each other: ground 0, the rest of a sheet 1, a print on it 2, a cup beside it 3
SHEET, PRINT, CUP = np.s_[10:24, 10:30], np.s_[14:19, 15:24], np.s_[28:34, 12:18]


def photo_of(rng: np.random.Generator, sheet: float = 0.9, inner: float = 0.4, cup: float = 0.9) -> RegionTree:
    """Strengths of the outlines of sheet, print and cup."""
    labels = np.zeros((SIZE, SIZE), np.int32)
    shift = rng.integers(-4, 5, 2)
    labels[SHEET], labels[PRINT], labels[CUP] = 1, 2, 3
    labels = np.roll(labels, shift, (0, 1))
    pairs = np.int32([[1, 2], [0, 3], [5, 4]])
    touching = np.int32([[0, 1], [0, 3], [1, 2]])
    lengths = np.array([68.0, 24, 28])
    return RegionTree(labels, pairs, touching, lengths, lengths * (sheet, cup, inner))


def votes_of(trees: list[RegionTree]) -> Callable[[], list[Vote]]:
    """Ten Gaussians for each region, which see an equal share of its pixels."""
    votes = []
    for number, tree in enumerate(trees):
        weights = np.kron(np.diag(tree.areas / 10), np.ones((10, 1))).astype(np.float32)
        votes.append(Vote(f"{number}.jpg", tree, csr_array(weights)))
    return lambda: votes


def pieces() -> Tree:
    """Each region is a thing."""
    levels = np.full(4, THING, np.uint8)
    return Tree(np.repeat(np.arange(4, dtype=np.int32), 10), np.full(4, -1, np.int32), levels, np.ones(4, np.float32))


def things_of(tree: Tree) -> list[set[int]]:
    """Regions of each thing with parts."""
    check_forest(tree.node_of, tree.parents, tree.levels)
    first = tree.node_of[::10]
    wholes = np.flatnonzero((tree.levels == THING) & np.isin(np.arange(len(tree.parents)), tree.parents))
    return [{region for region in range(4) if tree.parents[first[region]] == whole} for whole in wholes]


def test_a_print_and_the_rest_of_its_sheet_are_one_thing():
    rng = default_rng(0)
    tree = with_voted(pieces(), votes_of([photo_of(rng) for _ in range(6)]))
    assert things_of(tree) == [{1, 2}]
    assert (tree.levels == PART).sum() == 2
    whole = int(tree.parents[tree.node_of[10]])
    assert tree.sure[whole] == pytest.approx(0.9)  # every photo has the sheet, outlined as strongly


def test_what_is_outlined_more_strongly_by_itself_stays_a_thing():
    rng = default_rng(0)
    strong = with_voted(pieces(), votes_of([photo_of(rng, sheet=0.5, inner=0.9) for _ in range(6)]))
    assert things_of(strong) == []


def test_a_thing_and_the_ground_are_not_joined():
    """Their union is a node too, and reaches the photo's frame."""
    rng = default_rng(0)
    tree = with_voted(pieces(), votes_of([photo_of(rng, sheet=0.2, inner=0.2, cup=0.1) for _ in range(6)]))
    assert things_of(tree) == []


def test_most_photos_decide():
    """In some the sheet's outline is taken for the print's: there its union is that of print and ground."""

    def misled(tree):
        pairs = np.int32([[0, 1], [4, 3], [5, 2]])
        return RegionTree(tree.labels, pairs, tree.touching, tree.lengths, tree.strengths)

    for wrong, joined in ((2, [{1, 2}]), (5, [])):
        rng = default_rng(1)
        trees = [
            misled(tree) if number < wrong else tree for number, tree in enumerate(photo_of(rng) for _ in range(7))
        ]
        assert things_of(with_voted(pieces(), votes_of(trees))) == joined


def test_what_one_order_of_merging_misses_another_may_find():
    """In every photo the learned order takes the print with the ground, and that of outlines with the sheet."""
    rng = default_rng(5)
    right = [photo_of(rng) for _ in range(6)]
    wrong = [replace(tree, pairs=np.int32([[0, 2], [4, 3], [5, 1]])) for tree in right]
    after = [[node + 3 if node >= 4 else node for node in pair] for pair in right[0].pairs.tolist()]
    both = [replace(tree, pairs=np.concatenate([tree.pairs, np.int32(after)])) for tree in wrong]
    for trees, joined in ((wrong, []), (right, [{1, 2}]), (both, [{1, 2}])):
        assert things_of(with_voted(pieces(), votes_of(trees))) == joined


def test_the_order_of_photos_does_not_matter():
    rng = default_rng(2)
    trees = [photo_of(rng, *rng.uniform(0.3, 0.9, 3)) for _ in range(8)]
    one, other = (with_voted(pieces(), votes_of(some)) for some in (trees, trees[::-1]))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_photos_that_show_nothing_do_not_vote():
    rng = default_rng(3)
    votes = votes_of([photo_of(rng) for _ in range(4)])()
    blind = [vote._replace(weights=csr_array(vote.weights.shape, dtype=np.float32)) for vote in votes[:2]]
    assert things_of(with_voted(pieces(), lambda: [*votes, *blind, *blind])) == [{1, 2}]
    assert things_of(with_voted(pieces(), lambda: blind)) == []


def test_of_sets_that_share_a_piece_the_one_that_gains_most_is_taken():
    sets = [(0, 1), (1, 2), (3, 4)]
    found = Worth(np.array([0.6, 0.9, 0.5]), np.zeros(3))
    alone = Worth(np.full(6, 0.2), np.zeros(6))
    weight = np.array([1.0, 1, 1, 1, 1, 20])
    assert [joined.members for joined in _chosen(sets, found, alone, weight)] == [[1, 2], [3, 4]]
    assert _chosen(sets, found._replace(framed=np.ones(3)), alone, weight) == []
    assert _chosen(sets[:1], Worth(*np.array([[0.9], [0.0]])), alone, weight[:2]) == []  # the whole room
