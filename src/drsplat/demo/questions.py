"""What the demo asks, and what the right answer is."""

from typing import NamedTuple


class Question(NamedTuple):
    """A query in words, and the names of the things that it means (categories of `truth.json`): none where there is no
    such thing."""

    text: str
    meant: tuple[str, ...]


QUESTIONS = (
    Question("yellow apple", ("yellow apple",)),
    Question("orange carrot", ("orange carrot",)),
    Question("green cup", ("green mug",)),
    Question("toy duck", ("green toy duck",)),
    Question("green car", ("green toy car",)),
    Question("red vase", ("red vase",)),
    Question("blue candle", ("blue candle",)),
    Question("couch", ("orange sofa",)),
    Question("houseplant", ("green plant",)),
    Question("wooden table", ("brown table",)),
    Question("chair", ("brown chair",)),
    Question("bookcase", ("red shelf",)),
    Question("something to eat", ("yellow apple", "orange carrot")),
    Question("fork", ("grey fork",)),
    Question("laptop", ()),
    Question("teddy bear", ()),
)
