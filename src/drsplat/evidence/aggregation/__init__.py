"""Ways from the votes of a Gaussian, its row of W, to one feature: see docs/aggregators.md."""

from .aggregator import AGGREGATORS, MEAN, Aggregated, Aggregator, Step, aggregator
from .record import MEAN_RECORD, AggregatorRecord, record_from_json, record_json
from .sampling import Sampling

__all__ = [
    "AGGREGATORS", "MEAN", "MEAN_RECORD", "Aggregated", "Aggregator", "AggregatorRecord", "Sampling", "Step",
    "aggregator", "record_from_json", "record_json",
]  # fmt: skip
