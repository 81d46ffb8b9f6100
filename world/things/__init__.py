"""The catalogue: one maker per kind of thing, `maker(rng, split) -> Thing`."""

from collections.abc import Callable

import numpy as np

from ..looks import Split
from ..thing import Thing
from . import decor, food, furniture, kitchen, toys

Maker = Callable[[np.random.Generator, Split], Thing]

CATALOGUE: dict[str, Maker] = {
    maker.__name__: maker for family in (kitchen, food, decor, toys, furniture) for maker in family.THINGS
}
"""By the maker's name; a thing's own name is a phrase ("toy duck")."""


def make(kind: str, split: Split, seed: int) -> Thing:
    """One thing of the catalogue; the same one for the same seed."""
    return CATALOGUE[kind](split.rng(seed, list(CATALOGUE).index(kind)), split)
