"""Gates: which views see a Gaussian well enough to have a say about it.

A gate looks at one view at a time, at the weights of all Gaussians in it.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from drsplat.base.arrays import Doubles, Flags, Indices, OtherFlags, WholeNumbers
from drsplat.field.evidence.aggregation.entries import view_runs, with_weights
from drsplat.field.evidence.evidence import Evidence


@dataclass(frozen=True, eq=False)
class ViewSums:
    """Sums of W, an element per Gaussian and view with weight, in the order of W's rows, then of views.

    weights: the sum over the view's columns, in pixels. entries: how many entries of W were added up.
    """

    rows: Indices
    views: WholeNumbers
    weights: Doubles
    entries: Indices

    def per_entry(self, kept: OtherFlags) -> Flags:
        """Repeat the value of each sum for every entry of W in it."""
        return np.repeat(kept, self.entries)


def view_sums(evidence: Evidence) -> ViewSums:
    """Add up W's columns of each view; the evidence has its columns in canonical order."""
    weights = evidence.weights
    views = evidence.masks.views[weights.indices]
    starts = view_runs(views, weights.indptr)
    if not len(starts):
        return ViewSums(starts, views, np.empty(0), starts)
    sums = np.add.reduceat(weights.data, starts, dtype=np.float64)
    rows = np.searchsorted(weights.indptr, starts, side="right") - 1
    return ViewSums(rows, views[starts], sums, np.diff(starts, append=len(views)))


@runtime_checkable
class Gate(Protocol):
    """Which Gaussians of one view pass, by their weights in it."""

    def passes(self, weights: Doubles) -> Flags: ...


@dataclass(frozen=True)
class MassGate:
    """The heaviest Gaussians that together hold `share` of the view, if of weight `floor` or more.

    Source: VALA (3DV 2026), Stage A.
    """

    share: float = 0.75
    floor: float = 0.13  # of one pixel

    def passes(self, weights: Doubles) -> Flags:
        order = np.argsort(-weights, kind="stable")
        held = np.cumsum(weights[order])
        enough = int(np.searchsorted(held, self.share * held[-1])) + 1
        passed = np.zeros(len(weights), np.bool_)
        passed[order[:enough]] = True
        return passed & (weights >= self.floor)


@dataclass(frozen=True)
class QuantileGate:
    """The Gaussians heavier than a quantile of the view's, and than `floor`. Source: VALA (3DV 2026), Stage B."""

    quantile: float = 0.85
    floor: float = 0.15  # of one pixel

    def passes(self, weights: Doubles) -> Flags:
        return np.asarray(weights > max(self.floor, float(np.quantile(weights, self.quantile))))


@dataclass(frozen=True)
class Gated:
    """Keep an entry of W where its Gaussian passes every gate in its view.

    Each gate sees the weights as they were before any gate.
    """

    gates: tuple[Gate, ...] = (MassGate(), QuantileGate())

    @property
    def parts(self) -> tuple[Gate, ...]:
        return self.gates

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:
        sums = view_sums(evidence)
        kept = sums.per_entry(passing(sums, self.gates))
        return with_weights(evidence, np.where(kept, evidence.weights.data, np.float32(0)))


@dataclass(frozen=True)
class Spared:
    """Gates that leave a Gaussian all its views where none would pass: nothing is pruned."""

    gated: Gated = Gated()

    @property
    def parts(self) -> tuple[Gate, ...]:
        return self.gated.gates

    def __call__(self, evidence: Evidence, threads: int = 0) -> Evidence:
        sums = view_sums(evidence)
        passed = passing(sums, self.gated.gates)
        any_passed = np.bincount(sums.rows[passed], minlength=len(evidence)) > 0
        kept = sums.per_entry(passed | ~any_passed[sums.rows])
        return with_weights(evidence, np.where(kept, evidence.weights.data, np.float32(0)))


def passing(sums: ViewSums, gates: tuple[Gate, ...]) -> Bool[np.ndarray, " g"]:
    """Which pairs of Gaussian and view pass all gates."""
    passed = np.ones(len(sums.views), np.bool_)
    order = np.argsort(sums.views, kind="stable")
    bounds = np.flatnonzero(np.diff(sums.views[order])) + 1
    for members in np.split(order, bounds) if len(order) else ():
        for gate in gates:
            passed[members] &= gate.passes(sums.weights[members])
    return passed
