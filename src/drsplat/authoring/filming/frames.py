"""The pictures of a film, one after the other."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...drawing.labels import Mark, marked
from ...drawing.pictures import PAPER, OtherPixels, as_pixels
from ...drawing.rendering import render
from ...errors import InputError
from ...kernels import SplatArrays, splat_arrays
from ...scene.gaussians import Gaussians
from ...scene.moving import Moving
from ...scene.views import View
from .highlights import Highlight

LEAD_S = 1.0  # before an answer appears
FADE_S = 1.0  # until it is all there
MIN_FILM_PARTS = 6  # lead and fade are each shortened to a film's length over this
BORDER_PIXELS = 2  # between two sides


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
