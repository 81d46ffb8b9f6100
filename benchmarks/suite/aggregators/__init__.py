"""Aggregators that are measured beside the product's and are not in it: see docs/aggregators.md."""

from collections.abc import Mapping

from drsplat.field.evidence.aggregation import AGGREGATORS, Aggregator
from drsplat.field.evidence.aggregation.voting import ModeVoting

from .centres import CentrePixels
from .gates import Gated, MassGate, QuantileGate, Spared
from .medians import CosineMedian
from .pruning import Pruned
from .tempering import Tempered

_OTHERS = (
    Aggregator("centre-pixel", CentrePixels()),
    Aggregator("vala", CentrePixels(), (Gated(), CosineMedian(), Pruned())),
    Aggregator("vala-scannet", CentrePixels(), (Gated((MassGate(0.9, 0.01),)), CosineMedian(), Pruned())),
    Aggregator("mass-gate", steps=(Gated((MassGate(),)),)),
    Aggregator("quantile-gate", steps=(Gated((QuantileGate(),)),)),
    Aggregator("gates", steps=(Gated(),)),
    Aggregator("spared-gates", steps=(Spared(),)),
    Aggregator("median", steps=(CosineMedian(),)),
    Aggregator("tempered", steps=(Tempered(),)),
    Aggregator("voting", voting=ModeVoting()),
)
MEASURED: Mapping[str, Aggregator] = {**AGGREGATORS, **{a.name: a for a in _OTHERS}}
"""By name: the product's, then the others."""
