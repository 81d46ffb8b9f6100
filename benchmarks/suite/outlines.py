"""True outlines of things, drawn by hand in photos, and how well what a click finds fits them.

In JSON: name of a photo -> name of a thing -> corners of its outline in pixels of the stored photo, as it was drawn.
Outlines show what is visible of a thing. Where one thing lies on another and the outlines overlap, as a mouse on a mat,
the pixels are the smaller one's; the functions here draw each outline alone and do not take them from the larger one.
No corners mean that a thing is in sight and was not outlined: what the photo shows outside of outlines is not known.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from drsplat import Query, Scene, View
from drsplat.drawing.pictures import visible_share
from drsplat.errors import InputError
from drsplat.field.forest import LEVELS
from drsplat.kernels import render_channels
from drsplat.scene.photos import undistort_ids

Outlines = Mapping[str, Mapping[str, list[list[float]]]]
BESIDE = 0.01  # of the outline: smaller pieces are not counted


def outlines_path(capture: str) -> Path:
    """Return the file with the outlines of a capture, by the name of its folder: plush, desk_penguin, ..."""
    return Path(__file__).resolve().parents[2] / "tests" / "support" / f"{capture}_outlines.json"


def read_outlines(path: Path) -> Outlines:
    """Return the outlines that were drawn."""
    drawn = json.loads(path.read_text(encoding="utf-8"))
    return {photo: {thing: corners for thing, corners in things.items() if corners} for photo, things in drawn.items()}


def outlined_in_part(path: Path) -> set[str]:
    """Return the photos that show things which are outlined in other photos only."""
    drawn = json.loads(path.read_text(encoding="utf-8"))
    return {photo for photo, things in drawn.items() if not all(things.values())}


def inside(view: View, corners: list[list[float]]) -> np.ndarray:
    """(h, w) bool on the raster of the view's pinhole, whose photo was stored with lens and all."""
    drawn = Image.new("L", (view.width, view.height))
    ImageDraw.Draw(drawn).polygon([tuple(corner) for corner in corners], fill=1)
    result: np.ndarray = undistort_ids(view, np.asarray(drawn, np.int32)) == 1
    return result


def middle(mask: np.ndarray) -> tuple[float, float]:
    """The pixel furthest from what is outside, (x, y): a centre that is on the thing whatever its shape."""
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    y, x = np.unravel_index(depth.argmax(), depth.shape)
    return float(x) + 0.5, float(y) + 0.5


def iou(one: np.ndarray, other: np.ndarray) -> float:
    either = np.count_nonzero(one | other)
    return np.count_nonzero(one & other) / either if either else 0.0


def fits_of_masks(mask_ids: np.ndarray, view: View, corners: list[list[float]]) -> tuple[float, float]:
    """IoU with the outline of the best mask of a photo's map, and of all masks that are mostly inside it together.

    mask_ids: (h, w) on the photo as stored, as `embed` writes it; the view's size is that of the photo.
    """
    height, width = mask_ids.shape
    drawn = Image.new("L", (width, height))
    scaled = [(x * width / view.width, y * height / view.height) for x, y in corners]
    ImageDraw.Draw(drawn).polygon(scaled, fill=1)
    outlined = np.asarray(drawn, bool)
    masks = [mask_ids == number for number in np.unique(mask_ids[outlined]) if number >= 0]
    within = [mask for mask in masks if 2 * np.count_nonzero(mask & outlined) > np.count_nonzero(mask)]
    together = np.logical_or.reduce([np.zeros_like(outlined), *within])
    return max([iou(mask, outlined) for mask in masks], default=0.0), iou(together, outlined)


class Found(NamedTuple):
    """ious: of a selection, in each photo other than the one that was clicked in."""

    what: str
    ious: list[float]

    @property
    def mean(self) -> float:
        return float(np.mean(self.ious))


class Click(NamedTuple):
    """answer: what the click alone finds. best: of all nodes of the hierarchy there. whole: all objects of which
    most is inside the outline in the photo of the click, `pieces` of them larger than a hundredth of it."""

    photo: str
    answer: Found
    best: Found
    whole: Found
    pieces: int


@dataclass(frozen=True, eq=False)
class Clicks:
    """Clicks into the middle of things with known outlines; the scene has views and objects."""

    scene: Scene
    outlines: Outlines

    @cached_property
    def masks(self) -> dict[str, dict[str, np.ndarray]]:
        """By thing and photo."""
        by_thing: dict[str, dict[str, np.ndarray]] = {}
        for photo, things in self.outlines.items():
            for thing, corners in things.items():
                by_thing.setdefault(thing, {})[photo] = inside(self.scene.view(photo), corners)
        return by_thing

    def of(self, thing: str) -> Iterator[Click]:
        """A click in each of the photos, looked at in the others."""
        for photo in self.masks[thing]:
            answer, best = self.answered(thing, photo)
            yield Click(photo, answer, best, *self.whole(thing, photo))

    def answered(self, thing: str, photo: str) -> tuple[Found, Found]:
        """Return what a click in a photo finds, and the best level there."""
        click = (photo, *middle(self.masks[thing][photo]))
        answer = self.fit(thing, photo, "click", self.scene.ask(Query(click=click)).gaussian_ids)
        return answer, max(self.levels(thing, click), key=lambda found: found.mean, default=answer)

    def levels(self, thing: str, click: tuple[str, float, float]) -> Iterator[Found]:
        """Each node at the click, none where what is there is loose."""
        objects = self.scene.field.objects
        assert objects is not None
        try:
            nodes = self.scene.object_at(click)
        except InputError:
            return
        for node in nodes:
            ids = self.scene.field.gaussian_ids[objects.rows(node)]
            yield self.fit(thing, click[0], LEVELS[objects.levels[node]], ids)

    def whole(self, thing: str, photo: str) -> tuple[Found, int]:
        mask, areas = self.masks[thing][photo], self.shares(photo)
        within = areas[mask].sum(0)
        chosen = np.flatnonzero(2 * within > areas.sum((0, 1)))
        ids = np.flatnonzero(np.isin(self.scene.object_ids(), chosen))
        pieces = np.count_nonzero(within[chosen] > BESIDE * mask.sum())
        return self.fit(thing, photo, "pieces", ids), pieces

    def shares(self, photo: str) -> np.ndarray:
        """(h, w, objects) blending weights of every object."""
        ids = self.scene.object_ids()
        channels = (ids[:, None] == np.arange(ids.max() + 1)).astype(np.float32)
        return render_channels(self.scene.splats, self.scene.view(photo), channels).channels

    def fit(self, thing: str, clicked: str, what: str, ids: np.ndarray) -> Found:
        others = [photo for photo in self.masks[thing] if photo != clicked]
        return Found(what, [iou(self.drawn(photo, ids), self.masks[thing][photo]) for photo in others])

    def drawn(self, photo: str, ids: np.ndarray) -> np.ndarray:
        """(h, w) bool: where Gaussians are most of what is seen."""
        scene = self.scene
        result: np.ndarray = visible_share(scene.gaussians, scene.view(photo), ids, splats=scene.splats) > 0.5
        return result
