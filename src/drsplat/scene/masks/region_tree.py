"""A photo in small regions, and the orders in which they merge into things: its hierarchy of candidates for masks."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ...base.arrays import Doubles, Indices, Int32, MaskIds, Numbers

MIN_AREA_SHARE, MAX_AREA_SHARE = 0.0008, 0.6  # of the photo, of a node that is a candidate


class Bounds(NamedTuple):
    """Bounds of candidates, a value each.

    outlines: mean strength of the outline along the border; 0 for what has none. framed: share of the border that is
    the photo's frame.
    """

    outlines: Numbers
    framed: Numbers


@dataclass(frozen=True, eq=False)
class RegionTree:
    """Regions of a photo with one binary tree over them, or several.

    labels: region of each pixel, from 0, every number in use. pairs: numbers of the two nodes that become one: regions
    first, then unions in their order, tree after tree. touching: regions that touch. lengths: of their border.
    strengths: sum of the outline's strength, 0 to 1, along it.
    """

    labels: MaskIds
    pairs: Int32[np.ndarray, "k 2"]
    touching: Int32[np.ndarray, "n 2"]
    lengths: Doubles
    strengths: Doubles

    def __len__(self) -> int:
        """Return the number of regions."""
        return len(self.areas)

    @property
    def areas(self) -> Indices:
        """Pixels of each region."""
        return np.bincount(self.labels.ravel())

    @cached_property
    def candidates(self) -> csr_array:
        """Return which regions are in each candidate, (c, n) of 0 and 1: nodes of MIN_ to MAX_AREA_SHARE, each once."""
        areas, inside = self.areas, [np.array([region]) for region in range(len(self))]
        inside += [np.empty(0, np.int64)] * len(self.pairs)
        for node, (one, other) in enumerate(self.pairs.tolist(), len(self)):
            inside[node] = np.sort(np.concatenate([inside[one], inside[other]]))
        total = self.labels.size
        sized = (some for some in inside if MIN_AREA_SHARE * total < areas[some].sum() < MAX_AREA_SHARE * total)
        kept = {some.tobytes(): some for some in sized}.values()  # two trees have nodes in common
        rows = np.repeat(np.arange(len(kept)), [len(some) for some in kept])
        columns = np.concatenate([np.empty(0, np.int64), *kept])
        return csr_array((np.ones(len(columns), np.float32), (rows, columns)), shape=(len(kept), len(self)))

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of the candidates."""
        one, other = (self.candidates[:, side] for side in self.touching.T)
        across = one + other - 2 * one.multiply(other)
        lengths = across @ self.lengths
        edges = (self.labels[0], self.labels[-1], self.labels[:, 0], self.labels[:, -1])
        frame = self.candidates @ np.bincount(np.concatenate(edges), minlength=len(self))
        found = across @ self.strengths / np.maximum(lengths, 1), frame / np.maximum(lengths + frame, 1)
        return Bounds(*(np.asarray(values, np.float32) for values in found))
