"""Answers drawn over pictures of a scene: in colour or as heat, with boxes and names."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...base.arrays import Float32, Float64
from ...drawing.heat import heat_of
from ...drawing.labels import Mark, marked
from ...drawing.pictures import Pixels, heated, highlighted
from ...drawing.rendering import Picture
from ...kernels.boxes import box_of
from ...query import Match, Query, Scene
from ...scene.boxes import Box
from ...scene.gaussians import Gaussians
from ...scene.views import View


@dataclass(frozen=True, eq=False)
class Highlight:
    """An answer that can be drawn over pictures of its scene.

    values: for each Gaussian its heat, or else 1 in a match and 0 elsewhere. marks: boxes of the matches, if wanted.
    up: the vertical that boxes of a moving scene are aligned with; None for free boxes.
    """

    matches: Sequence[Match]
    values: Float32[np.ndarray, "n 1"]
    is_heat: bool = False
    marks: Sequence[Mark] = ()
    up: Float64[np.ndarray, " 3"] | None = None

    @classmethod
    def of(cls, scene: Scene, query: Query, *, heat: bool = False, boxes: bool = False) -> "Highlight":
        """Ask a scene and return its answer.

        heat: show how well each Gaussian fits, instead of the matches. boxes: mark each match with its box and name.

        Raises: as `Scene.locate`.
        """
        answer = scene.ask(query).without_maybe()
        matches = scene.locate(answer)
        values = np.zeros((scene.field.num_gaussians, 1), np.float32)
        if heat:
            values[:, 0] = scene.field.dense(heat_of(answer.values, answer.threshold), fill=0.0)
        else:
            for match in matches:
                values[match.gaussian_ids] = 1
        return cls(matches, values, heat, marks_of(matches, query.text or "") if boxes else (), scene.up)

    def after_edits(self, everything: Gaussians) -> "Highlight":
        """Return the answer after edits of its scene: boxes follow the Gaussians, and removed Gaussians are dropped.

        everything: `Draft.everything`: all rows at their numbers, removed ones with opacity 0. Added rows match
        nothing.
        """
        values = np.zeros((len(everything), 1), np.float32)
        values[: len(self.values)] = self.values
        matches, marks = [], []
        for number, match in enumerate(self.matches):
            ids = match.gaussian_ids[everything.opacities[match.gaussian_ids] > 0]
            if len(ids):
                center, axes, extent = box_of(everything, ids, self.up)
                matches.append(replace(match, center=center, axes=axes, extent=extent, gaussian_ids=ids))
                marks += [box_mark(mark.text, matches[-1]) for mark in self.marks[number : number + 1]]
        return replace(self, matches=matches, values=values, marks=marks)

    @property
    def num_selected(self) -> int:
        """Number of Gaussians in all matches together."""
        return len(np.unique(np.concatenate([np.empty(0, np.int64), *(match.gaussian_ids for match in self.matches)])))

    def over(self, drawn: Picture, picture: Pixels, view: View, share: float, moved: Gaussians | None = None) -> Pixels:
        """Return a picture with the answer drawn over it.

        drawn: the view, rendered with `values` as its channel. picture: the pixels of `drawn`. share: opacity of the
        answer, from 0 to 1. moved: the Gaussians at the picture's time, if the scene moves.
        """
        if share <= 0:
            return picture
        value = drawn.channels[..., 0]
        full = heated(picture, value / np.maximum(drawn.alpha, 1e-3)) if self.is_heat else highlighted(picture, value)
        if share < 1:
            full = np.asarray(picture + (full.astype(np.float32) - picture) * share).astype(np.uint8)
        return marked(full, view, self.marks if moved is None else self._moved(moved), share)

    def _moved(self, gaussians: Gaussians) -> list[Mark]:
        pairs = zip(self.matches, self.marks, strict=False)
        return [box_mark(mark.text, box_of(gaussians, match.gaussian_ids, self.up)) for match, mark in pairs]


def marks_of(matches: Sequence[Match], text: str) -> list[Mark]:
    """Return a named box for each match: its label, or else the text, numbered if there are several."""
    names = [match.label or text for match in matches]
    return [
        box_mark(f"{number} {name}" if len(matches) > 1 else name, match)
        for number, (name, match) in enumerate(zip(names, matches, strict=True), 1)
    ]


def box_mark(text: str, box: Match | Box) -> Mark:
    return Mark(text, box.center, box.extent, box.axes)
