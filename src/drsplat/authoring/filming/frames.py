"""The pictures of a film, one after the other."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...base.arrays import Float32, OtherPixels, Pixels, Vector3
from ...drawing.heat import heat_of
from ...drawing.labels import Mark, marked
from ...drawing.pictures import PAPER, as_pixels, heated, highlighted
from ...drawing.rendering import Picture, render
from ...errors import InputError
from ...kernels import SplatArrays, splat_arrays
from ...kernels.boxes import box_of
from ...query import Match, Query, Scene
from ...scene.boxes import Box
from ...scene.gaussians import Gaussians
from ...scene.moving import Moving
from ...scene.views import View

LEAD_S = 1.0  # before an answer appears
FADE_S = 1.0  # until it is all there
MIN_FILM_PARTS = 6  # lead and fade are each shortened to a film's length over this
BORDER_PIXELS = 2  # between two sides


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
    up: Vector3 | None = None

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


@dataclass(frozen=True, eq=False)
class Film:
    """A film to be drawn. views: one for each picture, all of one size.

    A film of a moving scene lasts from its first time to its last. answer: fades in. beside: another scene, or the
    same, in the left half, without the answer; the views are those of one half. near: as in `splat_arrays`. notes:
    drawn from the first picture to the last, on both sides.

    Raises: InputError: no views; an answer of another scene.
    """

    scene: Gaussians | Moving
    views: Sequence[View]
    fps: float
    answer: Highlight | None = None
    beside: Gaussians | Moving | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near: float | None = None
    threads: int = 0
    notes: Sequence[Mark] = ()

    def __post_init__(self) -> None:
        if not self.views:
            raise InputError("a film needs a view for each of its pictures, got none")
        rows = len(_at(self.scene, 0.0))
        if self.answer is not None and len(self.answer.values) != rows:
            raise InputError(f"the answer is of {len(self.answer.values):,} Gaussians, the scene has {rows:,}")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        width, height = self.views[0].width, self.views[0].height
        return (width, height) if self.beside is None else (2 * width, height)

    def pictures(self, views: Iterable[View] | None = None) -> Iterator[OtherPixels]:
        """Yield the pictures, drawn when they are asked for. views: these same, if somebody counts them."""
        right, left = _Side(self, self.scene), None
        if self.beside is not None and self.beside is not self.scene:
            left = _Side(self, self.beside)
        last = max(len(self.views) - 1, 1)
        for number, view in enumerate(self.views if views is None else views):
            share = self._share(number)
            plain, picture = right.draw(view, number / last, self.answer, share)
            if self.beside is None:
                yield picture
            else:
                yield _joined(plain if left is None else left.draw(view, number / last, None, 0.0)[1], picture)

    def _share(self, number: int) -> float:
        """Return how much of the answer is there."""
        lasts = len(self.views) / self.fps
        lead, fade = min(LEAD_S, lasts / MIN_FILM_PARTS), min(FADE_S, lasts / MIN_FILM_PARTS)
        part = float(np.clip((number / self.fps - lead) / fade, 0, 1))
        return part * part * (3 - 2 * part)


class _Side:
    """A scene that is drawn again and again."""

    def __init__(self, film: Film, scene: Gaussians | Moving) -> None:
        self.film, self.scene = film, scene
        self.splats = None if isinstance(scene, Moving) else splat_arrays(scene, film.near)

    def draw(self, view: View, time: float, answer: Highlight | None, share: float) -> tuple[OtherPixels, OtherPixels]:
        """Draw the view at a time, without the answer and with a share of it."""
        gaussians = _at(self.scene, time)
        splats: SplatArrays = self.splats or splat_arrays(gaussians, self.film.near)
        drawn = render(
            gaussians, view, values=answer.values if answer is not None and share > 0 else None,
            background=self.film.background, threads=self.film.threads, splats=splats,
        )  # fmt: skip
        plain = as_pixels(drawn.rgb)
        noted = marked(plain, view, self.film.notes)
        if answer is None or share <= 0:
            return noted, noted
        over = answer.over(drawn, plain, view, share, gaussians if self.splats is None else None)
        return noted, marked(over, view, self.film.notes)


def _at(scene: Gaussians | Moving, share: float) -> Gaussians:
    if not isinstance(scene, Moving):
        return scene
    first, last = float(scene.times[0]), float(scene.times[-1])
    return scene.at(first + share * (last - first))


def _joined(left: OtherPixels, right: OtherPixels) -> OtherPixels:
    both = np.concatenate([left, right], axis=1)
    middle = left.shape[1]
    both[:, middle - BORDER_PIXELS // 2 : middle + BORDER_PIXELS // 2] = PAPER
    return both


def marks_of(matches: Sequence[Match], text: str) -> list[Mark]:
    """Return a named box for each match: its label, or else the text, numbered if there are several."""
    names = [match.label or text for match in matches]
    return [
        box_mark(f"{number} {name}" if len(matches) > 1 else name, match)
        for number, (name, match) in enumerate(zip(names, matches, strict=True), 1)
    ]


def box_mark(text: str, box: Match | Box) -> Mark:
    return Mark(text, box.center, box.extent, box.axes)
