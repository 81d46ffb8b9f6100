"""A SAM that knows what photos show: at a point it gives the part, the thing and the group that are there.

What published models get wrong is drawn: borders off by some pixels, answers that miss, small things more often than
large ones, and scores that only roughly say how good a mask is. Parts are halves of things in space, a group is a thing
with what stands on it. Nothing is drawn anew when a point is asked again.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int32, UInt8
from scipy import ndimage

from drsplat import View, load_image
from drsplat.photos.models.point_masks import PointMasks, PointMaskSettings

from .scenes import BenchScene

OFF = 2  # pixels that borders are off, at most
MISSED, MISSED_SMALL, SMALL = 0.1, 0.35, 32**2  # shares of answers; pixels, COCO's bound of what is small
SCORE_NOISE = 0.06
GROUPED = 0.25  # of the photos in which a thing's largest answer takes in what stands on it
PARTED = 24  # pixels: a thing of fewer in width and height has no parts


class Answer(NamedTuple):
    """A mask, its IoU with what it should be, and whether that is small."""

    mask: Bool[np.ndarray, "h w"]
    iou: float
    is_small: bool


@dataclass(frozen=True, eq=False)
class Answers:
    """The masks that a photo has: numbers of the part and the thing of each pixel, -1 for none, and of each thing's
    group the things in it. draw: its number, none for the first. given: answers by output, number and pixels that
    borders are off."""

    name: str
    draw: Sequence[int]
    parts: Int32[np.ndarray, "h w"]
    things: Int32[np.ndarray, "h w"]
    groups: Mapping[int, frozenset[int]]
    given: dict[tuple[int, int, int], Answer] = field(default_factory=dict)

    def at(self, x: int, y: int, point: int) -> PointMasks:
        """Return the three answers at a point that shows a thing, with its number."""
        rng = np.random.default_rng([*self.name.encode(), x, y, *self.draw])
        numbers = int(self.parts[y, x]), *[int(self.things[y, x])] * 2
        answers = [
            self._answer(output, number, int(rng.integers(-OFF, OFF + 1))) for output, number in enumerate(numbers)
        ]
        missed = np.array([rng.random() < (MISSED_SMALL if answer.is_small else MISSED) for answer in answers])
        scores = np.where(missed, 0.4, [answer.iou for answer in answers]) + rng.normal(0, SCORE_NOISE, 3)
        return PointMasks(
            np.stack([answer.mask for answer in answers]),
            scores.clip(0, 1).astype(np.float32),
            np.where(missed, 0.6, 0.95).astype(np.float32),
            np.arange(3, dtype=np.int64),
            np.full(3, point, np.int64),
        )

    def _answer(self, output: int, number: int, pixels: int) -> Answer:
        key = output, number, pixels
        if key not in self.given:
            exact = self._exact(output, number)
            mask = _moved(exact, pixels)
            iou = float((mask & exact).sum() / max((mask | exact).sum(), 1))
            self.given[key] = Answer(mask, iou, bool(exact.sum() < SMALL))
        return self.given[key]

    def _exact(self, output: int, number: int) -> Bool[np.ndarray, "h w"]:
        if output == 2:
            return np.isin(self.things, list(self.groups[number]))
        return np.asarray((self.parts, self.things)[output] == number)


class SimulatedSam:
    """A `PointPredictor` of some photos. asked: how many points so far.

    name: what the photos are of. ids: what each pixel of one shows, -1 for nothing. on: what stands on each thing.
    draw: number of the draw of all that it gets wrong.
    """

    def __init__(
        self,
        name: str,
        views: Sequence[View],
        ids: Callable[[View], Int32[np.ndarray, "h w"]],
        on: Mapping[int, Sequence[int]],
        draw: int = 0,
    ) -> None:
        self.identity: Mapping[str, object] = {"name": "simulated SAM", "of": name, "draw": draw}
        self.asked = 0
        self._ids, self._on, self._draw = ids, on, [draw] if draw else []
        self._by_photo = {_hash(load_image(view)): view for view in views}
        self._last: Answers | None = None

    def find(
        self, crop: UInt8[np.ndarray, "h w 3"], points: Float64[np.ndarray, "p 2"], settings: PointMaskSettings
    ) -> Iterator[PointMasks]:
        """Yield the three answers of each point. The crop has to be a whole photo."""
        view = self._by_photo[_hash(crop)]
        if self._last is None or self._last.name != view.name:
            self._last = self._answers(view)
        self.asked += len(points)
        for number, (x, y) in enumerate(points.astype(np.int64).tolist()):
            if self._last.things[y, x] >= 0:
                yield self._last.at(x, y, number)

    def _answers(self, view: View) -> Answers:
        things = self._ids(view)
        rng = np.random.default_rng([*view.name.encode(), 1, *self._draw])
        groups = {
            thing: frozenset({thing, *self._on.get(thing, ())}) if rng.random() < GROUPED else frozenset({thing})
            for thing in np.unique(things[things >= 0]).tolist()
        }
        return Answers(view.name, self._draw, _halves(things), things, groups)


def room_sam(scene: BenchScene, draw: int = 0) -> SimulatedSam:
    """Return a simulated SAM of the photos of a made room."""
    return SimulatedSam(scene.name, scene.views, scene.ids, stands_on(scene), draw)


def stands_on(scene: BenchScene) -> dict[int, list[int]]:
    """Return the things that stand on each thing: above its centre and within its box, seen from above."""
    objects = json.loads((scene.folder / "truth.json").read_text(encoding="utf-8"))["objects"]
    return {below["id"]: [above["id"] for above in objects if _is_on(above, below)] for below in objects}


def _is_on(above: Mapping[str, Any], below: Mapping[str, Any]) -> bool:
    center, box = np.array(above["box"]["center"]), below["box"]
    turned = np.deg2rad(-box["degrees"])
    x, y = center[:2] - box["center"][:2]
    along = np.cos(turned) * x - np.sin(turned) * y, np.sin(turned) * x + np.cos(turned) * y
    within = all(abs(a) <= size / 2 for a, size in zip(along, box["size"][:2], strict=True))
    return bool(within and above is not below and center[2] > box["center"][2])


def _halves(things: Int32[np.ndarray, "h w"]) -> Int32[np.ndarray, "h w"]:
    """Number the halves of each thing along the longer side of what is seen of it."""
    halves = things * 2
    for number, place in enumerate(ndimage.find_objects(things + 1)):
        if place is None:
            continue
        height, width = (side.stop - side.start for side in place)
        if max(height, width) >= PARTED:
            y, x = np.mgrid[place]
            second = y >= place[0].start + height / 2 if height > width else x >= place[1].start + width / 2
            halves[place][second & (things[place] == number)] += 1
    return halves


def _moved(mask: Bool[np.ndarray, "h w"], pixels: int) -> Bool[np.ndarray, "h w"]:
    """Return the mask grown or, below 0, shrunk by some pixels, never to nothing."""
    if not pixels:
        return mask
    change = ndimage.binary_dilation if pixels > 0 else ndimage.binary_erosion
    changed = np.asarray(change(mask, iterations=abs(pixels)))
    return changed if changed.any() else mask


def _hash(image: UInt8[np.ndarray, "h w 3"]) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()
