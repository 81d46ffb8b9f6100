"""Boxes and names of objects over a picture of a view, no name over another where there is room."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..base.arrays import Array, Float64, Matrix3, Pixels, Vector3
from ..scene.labelled import Annotation
from ..scene.views import View
from .pictures import OUTLINE_COLOR

MAX_DODGING_NAMES = 200  # that make room for each other; further ones are placed as if alone
PLATE_HEIGHTS = (0, 1, 2, 3)  # between an object and its name
PLATE_WIDTHS = (0.0, -0.5, 0.5, -1.0, 1.0)  # by which a name moves aside
Box = Float64[np.ndarray, " 4"]  # left, top, right, bottom, in pixels


CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) - 0.5
EDGES = [(i, k) for i, k in combinations(range(8), 2) if (i ^ k).bit_count() == 1]
SHADE_COLOR = (20, 22, 27)  # behind letters and beside lines, to make them legible on anything
NEAR_SHARE = 1e-3  # of the distance to a mark's middle: nothing nearer to the camera is drawn
LINES_PER_HEIGHT, MIN_LETTERS_PIXELS = 28, 11
Spot = tuple[float, float]
Color = tuple[int, int, int]
Lines = Sequence[tuple[Spot, Spot]]
Letters = ImageFont.FreeTypeFont | ImageFont.ImageFont


@dataclass(frozen=True, eq=False)
class Mark:
    """Name at a place of the world: at a point, or at a box as that of a match.

    extent: full lengths along the rows of `axes`; None for a point. text: may be empty; several lines are joined.
    """

    text: str
    center: Vector3
    extent: Vector3 | None = None
    axes: Matrix3 | None = None
    color: Color = OUTLINE_COLOR

    @property
    def corners(self) -> Float64[Array, "8 3"]:
        """Corners of the box; for a point, that point eight times."""
        extent = np.zeros(3) if self.extent is None else self.extent
        axes = np.eye(3) if self.axes is None else self.axes
        return self.center + (CORNERS * extent) @ axes


def notes_of(annotations: Sequence[Annotation]) -> list[Mark]:
    """Return the marks of annotations."""
    return [
        Mark(one.text, one.center, one.outline and one.outline.extent, one.outline and one.outline.axes)
        for one in annotations
    ]


def marked(picture: Pixels, view: View, marks: Sequence[Mark], share: float = 1.0) -> Pixels:
    """Draw boxes and names over the picture of a view, the furthest first; nothing hides them.

    A box is cut off where it leaves the space before the camera, and has its name above its visible part, or near by
    where another name is there; a mark outside the picture has none. share: from 0, nothing, to 1.
    """
    if share <= 0 or not marks:
        return picture
    drawn = Image.fromarray(picture)
    pen = ImageDraw.Draw(drawn)
    letters = ImageFont.load_default(max(MIN_LETTERS_PIXELS, view.height / LINES_PER_HEIGHT))
    lines = [lines_of(mark, view) for mark in marks]
    order = np.argsort([-float(np.linalg.norm(mark.center - view.center)) for mark in marks], kind="stable").tolist()
    for number in order:
        _draw_lines(pen, marks[number], lines[number], max(1, round(view.height / 240)))
    # the places of names by mark number, for marks in the picture that have a name
    named = [number for number, mark in enumerate(marks) if mark.text.strip() and lines[number]]
    spots = [np.array(lines[number]).reshape(-1, 2) for number in named]
    things = [np.concatenate([spot.min(0), spot.max(0)]) for spot in spots]
    texts = [pen.textbbox((0, 0), " ".join(marks[number].text.split()), letters) for number in named]
    border = max((bottom - top for _, top, _, bottom in texts), default=0) / 3
    sizes = [(right - left + 2 * border, bottom - top + 2 * border) for left, top, right, bottom in texts]
    plates = dict(zip(named, plates_of(things, sizes, border, view.size), strict=True))
    for number in _in_sight([number for number in order if number in plates], plates, view):
        _draw_name(pen, marks[number], plates[number], letters)
    result: Pixels = np.asarray(drawn)
    return result if share >= 1 else np.asarray(Image.blend(Image.fromarray(picture), drawn, share))


def lines_of(mark: Mark, view: View) -> list[tuple[Spot, Spot]]:
    """Return the parts of a mark's edges in the picture, in pixels; a point's is one line of no length."""
    corners = mark.corners @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    near = NEAR_SHARE * max(float(np.linalg.norm(mark.center - view.center)), 1e-9)
    ends = [(corners[0], corners[0])] if mark.extent is None else [(corners[i], corners[k]) for i, k in EDGES]
    lines = []
    for start, end in ends:
        if max(start[2], end[2]) <= near:
            continue
        start, end = _before(start, end, near), _before(end, start, near)
        line = _within(_pixel(start, view), _pixel(end, view), view)
        lines += [line] if line is not None else []
    return lines


def _before(point: Array, other: Array, near: float) -> Array:
    """Return the point, or where its line to another point crosses the near plane."""
    if point[2] >= near:
        return point
    met = point + (near - point[2]) / (other[2] - point[2]) * (other - point)
    return np.array([met[0], met[1], near])  # exactly near, without rounding


def _pixel(point: Array, view: View) -> Array:
    return (view.K @ point)[:2] / point[2]


def _within(start: Array, end: Array, view: View) -> tuple[Spot, Spot] | None:
    """Clip a line to the picture, by the slabs of its sides; None if nothing is left."""
    first, last, step = 0.0, 1.0, end - start
    for axis, side in enumerate(view.size):
        if step[axis] == 0:
            if not 0 <= start[axis] <= side:
                return None
            continue
        low, high = sorted((-start[axis] / step[axis], (side - start[axis]) / step[axis]))
        first, last = max(first, low), min(last, high)
    if not first <= last:
        return None
    a, b = (np.clip(start + at * step, 0, view.size) for at in (first, last))
    return (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))


def _draw_lines(pen: ImageDraw.ImageDraw, mark: Mark, spots: Sequence[tuple[Spot, Spot]], width: int) -> None:
    if mark.extent is None:
        for (x, y), _ in spots:
            for radius, color in ((3 * width + 1, SHADE_COLOR), (2 * width + 1, mark.color)):
                pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color)
        return
    for thick, color in ((width + 2, SHADE_COLOR), (width, mark.color)):
        for line in spots:
            pen.line(line, fill=color, width=thick)


def _in_sight(far_first: Sequence[int], plates: dict[int, Box], view: View) -> list[int]:
    """Return the numbers, the furthest first, of plates not wholly behind nearer ones: letters are slow to draw."""
    covered = np.zeros((view.height, view.width), np.bool_)
    in_sight = []
    for number in reversed(far_first):
        left, top, right, bottom = plates[number].astype(int).tolist()  # cut off, as Pillow does
        plate = covered[top : bottom + 1, left : right + 1]
        if not plate.all():
            in_sight.append(number)
            plate[:] = True
    return in_sight[::-1]


def _draw_name(pen: ImageDraw.ImageDraw, mark: Mark, plate: Box, letters: Letters) -> None:
    left, top, right, bottom = plate.tolist()
    text = " ".join(mark.text.split())
    inner = pen.textbbox((0, 0), text, letters)
    x, y = (left + right - inner[0] - inner[2]) / 2, (top + bottom - inner[1] - inner[3]) / 2
    pen.rectangle((left, top, right, bottom), fill=SHADE_COLOR)
    pen.text((x, y), text, mark.color, letters)


def plates_of(
    things: Sequence[Box], sizes: Sequence[tuple[float, float]], margin: float, picture: tuple[int, int]
) -> list[Box]:
    """Return a plate for each name, in order: above its object, else at the nearest free place above or below.

    things: boxes of the objects' visible parts. sizes: of their plates, width and height. margin: between both. Where
    no place is free it is the one that hides least.
    """
    taken = np.empty((0, 4))
    for number, (thing, size) in enumerate(zip(things, sizes, strict=True)):
        # all candidate places, nearest first, within the picture
        (wide, high), (left, top, right, bottom) = size, thing.tolist()
        rows = [(float(step), top - margin - (step + 1) * high) for step in PLATE_HEIGHTS]
        rows += [(step + 0.5, bottom + margin + step * high) for step in PLATE_HEIGHTS]
        ways = sorted(
            ((step + abs(aside), aside, y) for step, y in rows for aside in PLATE_WIDTHS), key=lambda way: way[0]
        )
        x = np.array([(left + right - wide) / 2 + aside * wide for _, aside, _ in ways])
        y = np.array([y for *_, y in ways])
        x, y = x.clip(0, max(picture[0] - wide, 0)), y.clip(0, max(picture[1] - high, 0))
        places = np.stack([x, y, x + wide, y + high], axis=1)
        # the number of pixels that each place shares with each taken plate
        a, b = places[:, None], (taken if number < MAX_DODGING_NAMES else taken[:0])[None]
        sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
        hidden = sides.clip(0).prod(-1).sum(1)
        taken = np.concatenate([taken, places[[int(np.argmin(hidden))]]])
    return list(taken)
