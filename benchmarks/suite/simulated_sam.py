"""A SAM that knows the truth of a made room: at a point it gives the part, the thing and the group that are there.

What published models get wrong is drawn: borders off by some pixels, answers that miss, small things more often than
large ones, and scores that only roughly say how good a mask is. Parts are halves of things in space, a group is a thing
with what stands on it. Nothing is drawn anew when a point is asked again.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int32, UInt8
from scipy import ndimage

from drsplat import View, load_image
from drsplat.models.point_masks import Found, PointMaskSettings

from .scenes import BenchScene

OFF = 2  # pixels that borders are off, at most
MISSED, MISSED_SMALL, SMALL = 0.1, 0.35, 32**2  # shares of answers; pixels, COCO's bound of what is small
SCORE_NOISE = 0.06
GROUPED = 0.25  # of the photos in which a thing's largest answer takes in what stands on it
PARTED = 24  # pixels: a thing of fewer in width and height has no parts


@dataclass(frozen=True, eq=False)
class Answers:
    """The masks that a photo has: numbers of the part and the thing of each pixel, -1 for none, and of each thing's
    group the things in it."""

    parts: Int32[np.ndarray, "h w"]
    things: Int32[np.ndarray, "h w"]
    groups: Mapping[int, frozenset[int]]


class SimulatedSam:
    """A `PointPredictor` of the photos of one room. asked: how many points so far. views: the photos."""

    def __init__(self, scene: BenchScene) -> None:
        self.identity: Mapping[str, object] = {"name": "simulated SAM", "scene": scene.name}
        self.asked = 0
        self._scene, self._on = scene, stands_on(scene)
        self.views = scene.views
        self._by_photo = {_hash(load_image(view)): view for view in scene.views}

    def find(
        self, crop: UInt8[np.ndarray, "h w 3"], points: Float64[np.ndarray, "p 2"], settings: PointMaskSettings
    ) -> Iterator[Found]:
        """Yield the three answers of each point. The crop has to be a whole photo of the room."""
        view = self._by_photo[_hash(crop)]
        answers = self._answers(view)
        for x, y in points.astype(np.int64):
            self.asked += 1
            if answers.things[y, x] >= 0:
                yield _answered(answers, int(x), int(y), view.name)

    def _answers(self, view: View) -> Answers:
        things = self._scene.ids(view)
        rng = np.random.default_rng([*view.name.encode(), 1])
        groups = {
            thing: frozenset({thing, *self._on.get(thing, ())}) if rng.random() < GROUPED else frozenset({thing})
            for thing in np.unique(things[things >= 0]).tolist()
        }
        return Answers(_halves(things), things, groups)


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


def _answered(answers: Answers, x: int, y: int, name: str) -> Found:
    thing = int(answers.things[y, x])
    exact = [
        answers.parts == answers.parts[y, x],
        answers.things == thing,
        np.isin(answers.things, list(answers.groups[thing])),
    ]
    rng = np.random.default_rng([*name.encode(), x, y])
    masks = [_moved(mask, rng) for mask in exact]
    ious = np.array(
        [(mask & true).sum() / max((mask | true).sum(), 1) for mask, true in zip(masks, exact, strict=True)]
    )
    missed = np.array([rng.random() < (MISSED_SMALL if mask.sum() < SMALL else MISSED) for mask in exact])
    scores = np.where(missed, 0.4, ious) + rng.normal(0, SCORE_NOISE, 3)
    stability = np.where(missed, 0.6, 0.95)
    return Found(
        np.stack(masks),
        scores.clip(0, 1).astype(np.float32),
        stability.astype(np.float32),
        np.arange(3, dtype=np.int64),
    )


def _moved(mask: Bool[np.ndarray, "h w"], rng: np.random.Generator) -> Bool[np.ndarray, "h w"]:
    """Return the mask grown or shrunk by some pixels, never to nothing."""
    pixels = int(rng.integers(-OFF, OFF + 1))
    if not pixels:
        return mask
    change = ndimage.binary_dilation if pixels > 0 else ndimage.binary_erosion
    changed = np.asarray(change(mask, iterations=abs(pixels)))
    return changed if changed.any() else mask


def _hash(image: UInt8[np.ndarray, "h w 3"]) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()
