"""WordNet above the classes of a classifier: a word's classes, and names that climb to a kind that is likely enough."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64


@dataclass(frozen=True, eq=False)
class WordNet:
    """Nouns and their kinds. A node is an offset of data.noun, as text.

    folder: data.noun and index.noun of WordNet 3.0. leaves: the node of each class of a classifier.
    """

    folder: Path
    leaves: Sequence[str]

    @cached_property
    def _lines(self) -> list[list[str]]:
        text = (self.folder / "data.noun").read_text(encoding="latin-1")
        return [line.split("|")[0].split() for line in text.splitlines() if not line.startswith("  ")]

    @cached_property
    def lemmas(self) -> dict[str, list[str]]:
        """Words of each node."""
        words = {line[0]: line[4 : 4 + 2 * int(line[3], 16) : 2] for line in self._lines}
        return {node: [word.replace("_", " ") for word in some] for node, some in words.items()}

    @cached_property
    def parents(self) -> dict[str, list[str]]:
        pointers = {line[0]: line[5 + 2 * int(line[3], 16) :] for line in self._lines}
        return {node: [rest[at + 1] for at, sign in enumerate(rest[:-2]) if sign in ("@", "@i")]
                for node, rest in pointers.items()}  # fmt: skip

    @cached_property
    def senses(self) -> dict[str, list[str]]:
        """Nodes of each word, the usual sense first."""
        lines = (
            line.split()
            for line in (self.folder / "index.noun").read_text(encoding="latin-1").splitlines()
            if line[0] != " "
        )
        return {line[0].replace("_", " "): line[-int(line[2]) :] for line in lines}

    def nodes(self, word: str) -> list[str]:
        """Return all senses of a word, in singular or plural, or the one of "mouse.4"; [] if WordNet lacks it."""
        noun, _, number = word.partition(".")
        endings = [noun, noun.removesuffix("s"), noun.removesuffix("es"), f"{noun.removesuffix('ies')}y"]
        found = next((self.senses[one] for one in endings if one in self.senses), [])
        return [found[int(number) - 1]] if number else found

    def above(self, node: str) -> set[str]:
        """Return a node and all its kinds."""
        found, left = set(), [node]
        while left:
            one = left.pop()
            if one not in found:
                found.add(one)
                left += self.parents.get(one, ())
        return found

    @cached_property
    def _paths(self) -> list[set[str]]:
        return [self.above(leaf) for leaf in self.leaves]

    @cached_property
    def kinds(self) -> list[str]:
        """All nodes that have a class below them, in order."""
        return sorted(set().union(*self._paths))

    @cached_property
    def under(self) -> Bool[np.ndarray, "k c"]:
        """Which classes are below each of `kinds`."""
        return np.array([[kind in path for path in self._paths] for kind in self.kinds])

    @cached_property
    def information(self) -> Float64[np.ndarray, " k"]:
        """From 0 of the root to 1 of a class."""
        return np.asarray(1 - np.log(self.under.sum(1)) / np.log(len(self.leaves)))

    def classes(self, word: str) -> Bool[np.ndarray, " c"]:
        """Mark the classes below any sense of a word."""
        rows = [self.kinds.index(node) for node in self.nodes(word) if node in set(self.kinds)]
        return np.asarray(self.under[rows].any(0)) if rows else np.zeros(len(self.leaves), np.bool_)

    def masses(self, probabilities: Float64[np.ndarray, "o c"]) -> Float64[np.ndarray, "o k"]:
        """Return how likely each of `kinds` is: the sum of its classes."""
        return np.asarray(probabilities @ self._under.T)

    @cached_property
    def _under(self) -> Float64[np.ndarray, "k c"]:
        return self.under.astype(np.float64)

    def climbed(self, masses: Float64[np.ndarray, "o k"], sure: float, least: float) -> Iterator[str | None]:
        """Name each thing by the most informative kind that is likely enough (Deng et al. 2012); None for none.

        sure: probability that a kind has to reach; least: information below which a name says nothing.
        """
        for mass in masses:
            worth = np.where(mass >= sure, self.information + 1e-3 * mass, -1.0)
            best = int(worth.argmax())
            yield self.kinds[best] if self.information[best] >= least and worth[best] >= 0 else None
