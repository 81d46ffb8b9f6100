"""Queries of the demo and their right answers."""

from typing import NamedTuple


class Probe(NamedTuple):
    """Query in words, and the names of the right objects (categories of `truth.json`); none if there are none."""

    text: str
    meant: tuple[str, ...]


PROBES = (
    Probe("yellow apple", ("yellow apple",)),
    Probe("orange carrot", ("orange carrot",)),
    Probe("green cup", ("green mug",)),
    Probe("toy duck", ("green toy duck",)),
    Probe("green car", ("green toy car",)),
    Probe("red vase", ("red vase",)),
    Probe("blue candle", ("blue candle",)),
    Probe("couch", ("orange sofa",)),
    Probe("houseplant", ("green plant",)),
    Probe("wooden table", ("brown table",)),
    Probe("chair", ("brown chair",)),
    Probe("bookcase", ("red shelf",)),
    Probe("something to eat", ("yellow apple", "orange carrot")),
    Probe("fork", ("grey fork",)),
    Probe("laptop", ()),
    Probe("teddy bear", ()),
)
