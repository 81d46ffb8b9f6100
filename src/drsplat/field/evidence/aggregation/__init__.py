"""Aggregators, which make one feature of a Gaussian's votes, its row of W: see docs/aggregators.md.

Names are loaded on first use: reading the record of an aggregator loads none of them.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .aggregators import AGGREGATORS, MEAN, Aggregated, Aggregator, Step, aggregator
    from .record import MEAN_RECORD, AggregatorRecord, Sampling, record_from_json

_HOMES = {
    "aggregators": ("AGGREGATORS", "MEAN", "Aggregated", "Aggregator", "Step", "aggregator"),
    "record": ("MEAN_RECORD", "AggregatorRecord", "Sampling", "record_from_json"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "AGGREGATORS", "MEAN", "MEAN_RECORD", "Aggregated", "Aggregator", "AggregatorRecord", "Sampling", "Step",
    "aggregator", "record_from_json",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'drsplat.field.evidence.aggregation' has no attribute '{name}'")
    return getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
