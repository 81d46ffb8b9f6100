"""Hierarchies of a photo's regions: their candidates, and how these are outlined and framed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from drsplat.scene.masks import region_tree
from drsplat.scene.masks.region_tree import RegionTree


def tree_of(seed: int, height: int = 12, width: int = 15, count: int = 9) -> tuple[RegionTree, np.ndarray]:
    """Regions at random with a random tree over them, and the strength of the outline between pixels."""
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, count, (height, width)).astype(np.int32)
    labels.ravel()[:count] = np.arange(count)  # every number in use
    pairs = pairs_of(rng, count)
    strength = rng.random((count, count))
    strength += strength.T
    sides = [(labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])]
    lengths = np.zeros((count, count))
    for one_side, other_side in sides:
        np.add.at(lengths, (one_side, other_side), 1)
    lengths += lengths.T
    touching = np.argwhere(np.triu(lengths, 1) > 0)
    along = lengths[tuple(touching.T)]
    tree = RegionTree(labels, pairs, touching.astype(np.int32), along, along * strength[tuple(touching.T)])
    return tree, strength


def pairs_of(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unions of a binary tree at random."""
    alive, pairs = list(range(count)), []
    while len(alive) > 1:
        one, other = rng.choice(len(alive), 2, replace=False)
        pairs.append((alive[one], alive[other]))
        alive = [node for place, node in enumerate(alive) if place not in (one, other)] + [count + len(pairs) - 1]
    return np.array(pairs, np.int32)


@pytest.fixture(autouse=True)
def any_size(monkeypatch) -> None:
    monkeypatch.setattr(region_tree, "MIN_AREA_SHARE", -1.0)
    monkeypatch.setattr(region_tree, "MAX_AREA_SHARE", 2.0)


@given(st.integers(0, 10**6))
def test_candidates_are_the_nodes_of_the_tree(seed):
    tree, _ = tree_of(seed)
    found = [set(row.nonzero()[0].tolist()) for row in tree.candidates.toarray()]
    expected = [{region} for region in range(len(tree))]
    for one, other in tree.pairs.tolist():
        assert expected[one].isdisjoint(expected[other])
        expected.append(expected[one] | expected[other])
    assert found == expected


@given(st.integers(0, 10**6))
def test_candidates_of_two_trees_are_the_nodes_of_both_each_once(seed):
    first, _ = tree_of(seed, count=6)
    second = replace(first, pairs=pairs_of(np.random.default_rng(seed + 1), 6))
    later = np.where(second.pairs < 6, second.pairs, second.pairs + len(first.pairs))
    both = replace(first, pairs=np.concatenate([first.pairs, later]))
    one, other, found = (
        [tuple(row) for row in tree.candidates.toarray().tolist()] for tree in (first, second, both)
    )  # fmt: skip
    assert found == [*one, *(row for row in other if row not in one)]


@given(st.integers(0, 10**6))
def test_outlines_and_frames_are_those_of_plain_loops(seed):
    tree, strength = tree_of(seed)
    candidates = tree.candidates
    outlines, framed = tree.bounds
    for number, row in enumerate(candidates.toarray()):
        inside = row[tree.labels] > 0
        across = []
        for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            cut = inside[one] != inside[other]
            across.append(strength[tree.labels[one][cut], tree.labels[other][cut]])
        border = np.concatenate(across)
        frame = sum(int(edge.sum()) for edge in (inside[0], inside[-1], inside[:, 0], inside[:, -1]))
        assert_allclose(outlines[number], border.sum() / max(len(border), 1), rtol=1e-6)
        assert_allclose(framed[number], frame / max(len(border) + frame, 1), rtol=1e-6)


def test_specks_and_whole_photos_are_no_candidates(monkeypatch):
    monkeypatch.undo()
    labels = np.zeros((100, 100), np.int32)
    labels[:, 50:], labels[0, :3] = 1, 2
    pairs, touching = np.int32([[0, 2], [3, 1]]), np.int32([[0, 1], [0, 2]])
    tree = RegionTree(labels, pairs, touching, np.ones(2), np.ones(2))
    assert [set(row.nonzero()[0].tolist()) for row in tree.candidates.toarray()] == [{0}, {1}, {0, 2}]
