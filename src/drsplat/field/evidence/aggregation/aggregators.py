"""Aggregators by name: rules for the weights of a row of W, put together."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.sparse import csr_array

from ....base.arrays import Embeddings, Flags, Ids, WholeNumbers
from ....errors import InputError, MismatchError
from ....scene.gaussians import Gaussians
from ..evidence import Evidence
from .entries import canonical
from .outliers import OutlierRejection
from .record import MEAN_RECORD, AggregatorRecord, Sampling
from .trust import MaskTrust
from .voting import ModeVoting

Step = Callable[[Evidence, int], Evidence]
"""Other weights for the same votes: (evidence, threads) -> evidence. Adds no entry. A dataclass of numbers, which are
its parameters; a step of several such has them as `parts`."""


@dataclass(frozen=True, eq=False)
class Aggregated:
    """Features of all rows, computed on demand.

    evidence: the votes that count, with the weights that they count with. donors: for each row the row of
    `evidence` whose feature it has, or -1; None: its own. record: what made them.
    """

    evidence: Evidence
    donors: Ids | None = None
    record: AggregatorRecord = MEAN_RECORD

    def __len__(self) -> int:
        return len(self.evidence) if self.donors is None else len(self.donors)

    @property
    def weights(self) -> csr_array:
        """Weights of the votes that count."""
        return self.evidence.weights

    @cached_property
    def present(self) -> Flags:
        """Mask of the rows that any vote is left for."""
        has_votes: np.ndarray = np.diff(self.evidence.weights.indptr) > 0
        if self.donors is None:
            return has_votes
        return (self.donors >= 0) & has_votes[self.donors]

    def features(self, begin: int, end: int, *, threads: int = 0) -> Embeddings:
        """Return the unit features of rows [begin, end); zero where there is none."""
        if self.donors is None:
            return self.evidence.features(begin, end, threads=threads)
        wanted, at = np.unique(self.donors[begin:end], return_inverse=True)
        held = self.evidence.rows(np.maximum(wanted, 0).astype(np.int64))
        features = held.features(0, len(wanted), threads=threads)
        features[wanted < 0] = 0
        return features[at]

    def rows(self, index: WholeNumbers) -> "Aggregated":
        """Return the features of some rows, in that order."""
        if self.donors is None:
            return replace(self, evidence=self.evidence.rows(index))
        return replace(self, donors=self.donors[index])


@dataclass(frozen=True)
class Aggregator:
    """Rule that makes features of votes.

    sampling: that of the W it is meant for, None for any. steps: in order. voting: after them, if any.
    """

    name: str
    sampling: Sampling | None = None
    steps: tuple[Step, ...] = ()
    voting: ModeVoting | None = None

    def __call__(self, evidence: Evidence, gaussians: Gaussians | None = None, *, threads: int = 0) -> Aggregated:
        """Weigh the votes of all rows anew; the same to the bit for any number of threads.

        gaussians: those of the rows, for aggregators that look at neighbours.

        Raises: InputError: this aggregator needs the Gaussians. MismatchError: not one per row.
        """
        weighed = canonical(evidence) if self.steps else evidence
        for step in self.steps:
            weighed = step(weighed, threads)
        if self.voting is None:
            return Aggregated(weighed, record=self.record())
        if gaussians is None:
            raise InputError(f"aggregator '{self.name}' looks at neighbouring Gaussians: pass gaussians")
        if len(gaussians) != len(evidence):
            raise MismatchError(f"{len(gaussians)} Gaussians for evidence of {len(evidence)}: pass those registered")
        seen = np.flatnonzero(np.diff(evidence.weights.indptr) > 0)
        donors = self.voting.donors(weighed, gaussians, seen, threads)
        return Aggregated(weighed, donors, self.record())

    @property
    def parameters(self) -> dict[str, int | float]:
        """Numbers of all steps by name, such as "MaskTrust.sharpness"."""
        parts = [part for step in self.steps for part in getattr(step, "parts", (step,))]
        parts += [self.voting] if self.voting else []
        return {
            f"{type(part).__name__}.{name}": value
            for part in parts
            for name, value in asdict(part).items()  # type: ignore[arg-type]
        }

    def record(self, sampling: Sampling | None = None) -> AggregatorRecord:
        """Return the record for the field's files. sampling: that of the aggregated W, where it is known."""
        return AggregatorRecord(self.name, self.parameters, sampling or self.sampling)


MEAN = Aggregator("mean")
_ALL = (
    MEAN,
    Aggregator("official", Sampling(45, 100)),
    Aggregator("inliers", steps=(OutlierRejection(),)),
    Aggregator("trusted", steps=(MaskTrust(),)),
    Aggregator("robust", steps=(MaskTrust(),), voting=ModeVoting()),
)
AGGREGATORS: Mapping[str, Aggregator] = MappingProxyType({a.name: a for a in _ALL})
"""Aggregators by name."""


def aggregator(name: str) -> Aggregator:
    """Return the aggregator of that name. Raises: InputError: there is none in AGGREGATORS."""
    if name not in AGGREGATORS:
        raise InputError(f"no aggregator '{name}': there are {', '.join(AGGREGATORS)}")
    return AGGREGATORS[name]
