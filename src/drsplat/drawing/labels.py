"""Boxes and names over a picture of a view: where things of the world are in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..arrays import Float64
from ..scene.annotations import Annotation, Outline
from ..scene.views import View
from .pictures import OUTLINE, Pixels
from .plates import Box, plates_of

CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) - 0.5
EDGES = [(i, k) for i, k in combinations(range(8), 2) if (i ^ k).bit_count() == 1]
SHADE = (20, 22, 27)  # behind letters and beside lines, so that they are read on anything
NEAR = 1e-3  # of the distance to a mark's middle: nothing nearer to the camera is drawn
LETTERS, LEAST_LETTERS = 28, 11  # pictures are so many lines of text high; pixels
Spot = tuple[float, float]
Color = tuple[int, int, int]
Lines = Sequence[tuple[Spot, Spot]]
Letters = ImageFont.FreeTypeFont | ImageFont.ImageFont


@dataclass(frozen=True, eq=False)
class Mark:
    """A name at a place of the world: a point, or a box as that of a match.

    extent: full lengths along the rows of `axes`; None for a point. text: may be empty, several lines make one.
    """

    text: str
    center: Float64[np.ndarray, " 3"]
    extent: Float64[np.ndarray, " 3"] | None = None
    axes: Float64[np.ndarray, "3 3"] | None = None
    color: Color = OUTLINE

    @property
    def corners(self) -> Float64[np.ndarray, "8 3"]:
        """Of the box; all at the point where there is none."""
        extent = np.zeros(3) if self.extent is None else self.extent
        axes = np.eye(3) if self.axes is None else self.axes
        return np.asarray(self.center + (CORNERS * extent) @ axes)


def notes_of(annotations: Sequence[Annotation]) -> list[Mark]:
    """What people wrote at places of the scene."""
    return [_note(one.text, one.center, one.outline) for one in annotations]


def _note(text: str, center: Float64[np.ndarray, " 3"], outline: Outline | None) -> Mark:
    return Mark(text, center) if outline is None else Mark(text, center, outline.extent, outline.axes)


def marked(picture: Pixels, view: View, marks: Sequence[Mark], share: float = 1.0) -> Pixels:
    """The picture of a view with boxes and names over it, the furthest first; nothing hides them.

    A box is cut off where it leaves the space before the camera, and has its name above what is seen of it, or near by
    where another name is there; a mark that is nowhere in the picture has none. share: from 0, nothing, to 1.
    """
    if share <= 0 or not marks:
        return picture
    drawn = Image.fromarray(picture)
    pen = ImageDraw.Draw(drawn)
    letters = ImageFont.load_default(max(LEAST_LETTERS, view.height / LETTERS))
    lines = [lines_of(mark, view) for mark in marks]
    far = np.argsort([-float(np.linalg.norm(mark.center - view.center)) for mark in marks], kind="stable").tolist()
    for number in far:
        _draw_lines(pen, marks[number], lines[number], max(1, round(view.height / 240)))
    plates = _plates(pen, marks, lines, letters, (view.width, view.height))
    for number in _in_sight([number for number in far if number in plates], plates, view):
        _draw_name(pen, marks[number], plates[number], letters)
    result: Pixels = np.asarray(drawn)
    return result if share >= 1 else np.asarray(Image.blend(Image.fromarray(picture), drawn, share))


def lines_of(mark: Mark, view: View) -> list[tuple[Spot, Spot]]:
    """What of a mark's edges is in the picture, from pixel to pixel; a point's is one line of no length."""
    corners = mark.corners @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    near = NEAR * max(float(np.linalg.norm(mark.center - view.center)), 1e-9)
    ends = [(corners[0], corners[0])] if mark.extent is None else [(corners[i], corners[k]) for i, k in EDGES]
    found = []
    for one, other in ends:
        if max(one[2], other[2]) <= near:
            continue
        one, other = _before(one, other, near), _before(other, one, near)
        line = _within(_pixel(one, view), _pixel(other, view), view)
        found += [line] if line is not None else []
    return found


def _before(point: np.ndarray, other: np.ndarray, near: float) -> np.ndarray:
    """The point, or where its line to another comes through the near plane."""
    if point[2] >= near:
        return point
    met = point + (near - point[2]) / (other[2] - point[2]) * (other - point)
    return np.array([met[0], met[1], near])  # exactly, however large the numbers that it is a difference of


def _pixel(point: np.ndarray, view: View) -> np.ndarray:
    return np.asarray((view.K @ point)[:2] / point[2])


def _within(one: np.ndarray, other: np.ndarray, view: View) -> tuple[Spot, Spot] | None:
    """A line's part in the picture, by the slabs of its sides; None where it has none."""
    first, last, step = 0.0, 1.0, other - one
    for axis, side in enumerate((view.width, view.height)):
        if step[axis] == 0:
            if not 0 <= one[axis] <= side:
                return None
            continue
        low, high = sorted((-one[axis] / step[axis], (side - one[axis]) / step[axis]))
        first, last = max(first, low), min(last, high)
    if not first <= last:
        return None
    begin, end = (np.clip(one + at * step, 0, (view.width, view.height)) for at in (first, last))
    return (float(begin[0]), float(begin[1])), (float(end[0]), float(end[1]))


def _draw_lines(pen: ImageDraw.ImageDraw, mark: Mark, spots: Sequence[tuple[Spot, Spot]], width: int) -> None:
    if mark.extent is None:
        for (x, y), _ in spots:
            for radius, color in ((3 * width + 1, SHADE), (2 * width + 1, mark.color)):
                pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color)
        return
    for thick, color in ((width + 2, SHADE), (width, mark.color)):
        for line in spots:
            pen.line(line, fill=color, width=thick)


def _plates(
    pen: ImageDraw.ImageDraw, marks: Sequence[Mark], lines: Sequence[Lines], letters: Letters, size: tuple[int, int]
) -> dict[int, Box]:
    """Where the names are of those that have one and are in the picture, by number: in their order, so that names of a
    film stay where they are when their things pass each other.
    """
    named = [number for number, mark in enumerate(marks) if mark.text.strip() and lines[number]]
    spots = [np.array(lines[number]).reshape(-1, 2) for number in named]
    things = [np.concatenate([one.min(0), one.max(0)]) for one in spots]
    texts = [pen.textbbox((0, 0), _in_a_line(marks[number].text), letters) for number in named]
    border = max((bottom - top for _, top, _, bottom in texts), default=0) / 3
    sizes = [(right - left + 2 * border, bottom - top + 2 * border) for left, top, right, bottom in texts]
    return dict(zip(named, plates_of(things, sizes, border, size), strict=True))


def _in_sight(far: Sequence[int], plates: dict[int, Box], view: View) -> list[int]:
    """Return those, the furthest first, whose plates are not all behind nearer ones: letters take long to draw."""
    covered = np.zeros((view.height, view.width), np.bool_)
    in_sight = []
    for number in reversed(far):
        left, top, right, bottom = plates[number].astype(int).tolist()  # cut off, as Pillow does
        plate = covered[top : bottom + 1, left : right + 1]
        if not plate.all():
            in_sight.append(number)
            plate[:] = True
    return in_sight[::-1]


def _draw_name(pen: ImageDraw.ImageDraw, mark: Mark, plate: Box, letters: Letters) -> None:
    left, top, right, bottom = plate.tolist()
    text = _in_a_line(mark.text)
    inner = pen.textbbox((0, 0), text, letters)
    x, y = (left + right - inner[0] - inner[2]) / 2, (top + bottom - inner[1] - inner[3]) / 2
    pen.rectangle((left, top, right, bottom), fill=SHADE)
    pen.text((x, y), text, mark.color, letters)


def _in_a_line(text: str) -> str:
    return " ".join(text.split())
