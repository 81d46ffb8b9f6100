"""Everyday words of places whose things are known, and the default answers of the built-in pair to them.

Of captures: everyday_words.json, written down before any was asked, with eighteen that nothing in the photos is called,
and colours by `real_colors`. Of rooms: the names that are there, with and without their colours, and eighteen that are
not. In the file, "+" says that things which nobody outlined may be called so as well.
"""

import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drsplat import MiniEncoder, Scene, load_field
from drsplat.errors import InputError
from drsplat.photos.models.mini.lexicon import COLORS, NAMES
from drsplat.query.defaults import MIN_GAUSSIANS, NOTHING, SURE

from .answers import place_of
from .places import Place
from .real_colors import TRUTH
from .trials import LEAST

WORDS = json.loads(Path(__file__).with_name("everyday_words.json").read_text(encoding="utf-8"))
ABSENT, PAIRS = 18, 4  # words that are not in a room; those of them with a colour


class Word(NamedTuple):
    """kind: noun or colour. meant: numbers of things, none of an absent word. counted: weight of each row."""

    text: str
    kind: str
    meant: np.ndarray
    counted: np.ndarray

    @property
    def is_present(self) -> bool:
        return bool(self.meant.any())

    def iou(self, rows: np.ndarray) -> float:
        both, either = (self.counted[some].sum() for some in (rows & self.meant, rows | self.meant))
        return float(both / either) if either else 0.0


class Said(NamedTuple):
    """iou: 0 where nothing is found. is_found: maybe or for sure."""

    iou: float
    is_found: bool
    is_sure: bool


@dataclass(frozen=True, eq=False)
class Ground:
    """A place with the field that is asked. labels, mass: the thing of each row, and its weight."""

    name: str
    place: Place
    folder: Path
    scene: Scene

    @property
    def is_capture(self) -> bool:
        return self.name in WORDS

    @cached_property
    def labels(self) -> np.ndarray:
        return np.asarray(self.place.labels[self.scene.field.gaussian_ids])

    @cached_property
    def mass(self) -> np.ndarray:
        return np.asarray(self.place.mass[self.scene.field.gaussian_ids])

    @cached_property
    def words(self) -> list[Word]:
        return list(self._of_capture() if self.is_capture else self._of_room())

    def _of_capture(self) -> Iterator[Word]:
        things, known = list(self.place.things), WORDS[self.name]
        outlined = self.mass * (self.labels < len(things))
        for text, called in known["present"].items():
            meant = np.isin(self.labels, [things.index(thing) for thing in called.split() if thing != "+"])
            yield Word(text, "noun", meant, outlined if "+" in called else self.mass)
        for color in COLORS:
            own, partly = (
                [things.index(thing) for thing, colors in TRUTH[self.name].items() if color in colors[at].split()]
                for at in (0, 1)
            )
            if own:
                counted = outlined * ~np.isin(self.labels, partly)
                yield Word(f"something {color}", "colour", np.isin(self.labels, own), counted)
        for text in known["absent"]:
            yield Word(text, "noun", np.zeros(len(self.labels), np.bool_), self.mass)

    def _of_room(self) -> Iterator[Word]:
        truth = json.loads((self.folder / "truth.json").read_text(encoding="utf-8"))
        seen = [one for one in truth["objects"] if np.count_nonzero(self.labels == one["id"]) >= LEAST]
        texts: dict[str, list[int]] = defaultdict(list)
        for one in seen:
            for text in {one["name"], f"{one['color']} {one['name']}", f"something {one['color']}"}:
                texts[text].append(one["id"])
        for text, ids in sorted(texts.items()):
            kind = "colour" if text.startswith("something") else "noun"
            yield Word(text, kind, np.isin(self.labels, ids), self.mass)
        there, rng = {one["name"] for one in truth["objects"]}, np.random.default_rng(0)
        missing = [str(name) for name in rng.permutation(sorted({*NAMES} - there))][: ABSENT - PAIRS]
        swaps = [f"{color} {name}" for color in COLORS for name in sorted(there)
                 if not any(one["name"] == name and one["color"] == color for one in truth["objects"])]  # fmt: skip
        for text in (*missing, *(str(text) for text in rng.permutation(swaps)[: ABSENT - len(missing)])):
            yield Word(text, "noun", np.zeros(len(self.labels), np.bool_), self.mass)

    def built_in(self, text: str) -> tuple[np.ndarray, bool]:
        """Return which rows the default answer has, and whether it is sure; none if the words are unknown."""
        try:
            answer = self.scene.ask(text)
        except InputError:
            return np.zeros(len(self.labels), np.bool_), False
        rows = np.asarray(answer.values > answer.threshold)
        is_found = answer.certainty != NOTHING and rows.sum() >= MIN_GAUSSIANS
        return rows & is_found, is_found and answer.certainty == SURE

    @cached_property
    def by_built_in(self) -> list[Said]:
        found = [self.built_in(word.text) for word in self.words]
        return [
            Said(word.iou(rows), bool(rows.any()), is_sure)
            for word, (rows, is_sure) in zip(self.words, found, strict=True)
        ]


def ground_of(given: str, kept: Path) -> Ground:
    *place, field = given.split("=")
    known = place_of("=".join(place), "graph", kept)
    scene = Scene(load_field(Path(field)), known.gaussians, known.cameras, MiniEncoder())
    return Ground(Path(place[0]).resolve().name, known, Path(place[0]), scene)
