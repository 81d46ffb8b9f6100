"""How well masks fit true things, by the points that a simulated SAM is asked.

    python benchmarks/study_points.py ROOM... --kept FOLDER

ROOM: packed rooms of world/scenes. "grid16", "grid32", "rounds": as of `suite/masks.py`. "after found objects": before
its rounds each photo is asked at the most inner pixel of every object that is drawn in it, found in the masks of every
third photo; these are asked in rounds alone. "after true things": the same with the things that are there, which no
objects that are found can be better than. Of photos that are none of every third: points and masks a photo, and over
true things of 100 pixels or more the mean IoU of the best mask with each, of all, of those of more and of less than
32 x 32 pixels.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.suite.answers import place_of
from benchmarks.suite.masks import ASKING
from benchmarks.suite.paired import way_of
from benchmarks.suite.places import drawn_ids
from benchmarks.suite.scenes import BenchScene, read_scene
from benchmarks.suite.simulated_sam import SMALL, room_sam
from drsplat import View, load_image
from drsplat.field.forest import THING
from drsplat.field.objects.choosing import _owners
from drsplat.photos.models.point_masks import PointSegmenter
from drsplat.scene.masks.selection import mask_maps

LEAST = 100  # pixels of a thing
FIRST = 3  # every so many photos are asked before
Ids = Callable[[View], np.ndarray]


class Prompted(PointSegmenter):
    """Asks at objects first. shown: what is drawn in the photo that comes next."""

    shown: np.ndarray

    def _rounds(self, layer: int, explained: np.ndarray) -> Iterator[np.ndarray]:
        yield inner_points(self.shown)
        yield from super()._rounds(layer, explained)


def inner_points(shown: np.ndarray) -> np.ndarray:
    """Return the pixel of each number that is farthest from others, x and y."""
    points = []
    for number in np.unique(shown[shown >= 0]):
        depth = ndimage.distance_transform_edt(np.pad(shown == number, 1))[1:-1, 1:-1]
        y, x = np.unravel_index(depth.argmax(), depth.shape)
        points.append((x + 0.5, y + 0.5))
    return np.array(points).reshape(-1, 2)


def found_objects(folder: Path, kept: Path, first: set[str]) -> Ids:
    """Return what each pixel shows of the things that are found in some photos asked in rounds."""
    place = place_of(str(folder), "rounds", kept)
    way = way_of(replace(place, photos=first))
    numbers = np.append(_owners(way.tree.parents, way.tree.levels == THING), -1)
    things = np.zeros(len(place.gaussians), np.int32)
    things[way.ids] = numbers[way.tree.node_of] + 1
    ids = drawn_ids(place.gaussians, things)
    return lambda view: ids(view) - 1


def row(scene: BenchScene, views: list[View], kind: str, objects: Ids | None) -> str:
    predictor, ious, sizes, masks = room_sam(scene), [], [], 0
    segmenter = PointSegmenter(predictor, ASKING[kind]) if objects is None else Prompted(predictor, ASKING[kind])
    for view in views:
        if objects is not None and isinstance(segmenter, Prompted):
            segmenter.shown = objects(view)
        found, true = mask_maps(segmenter.segment(load_image(view))).mask_ids[-1], scene.ids(view)
        masks += int(found.max()) + 1
        for thing in np.unique(true[true >= 0]):
            if (true == thing).sum() >= LEAST:
                ious.append(best_iou(found, true == thing))
                sizes.append((true == thing).sum())
    fits, is_small = np.array(ious), np.array(sizes) < SMALL
    means = " | ".join(f"{some.mean():.3f}" for some in (fits, fits[~is_small], fits[is_small]))
    return f"{predictor.asked / len(views):.0f} | {masks / len(views):.1f} | {means} |"


def best_iou(masks: np.ndarray, thing: np.ndarray) -> float:
    shared = np.bincount(masks[thing] + 1, minlength=int(masks.max()) + 2)[1:]
    sizes = np.bincount(masks.ravel() + 1, minlength=len(shared) + 1)[1:]
    return float(np.max(shared / (sizes + thing.sum() - shared), initial=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="+", type=Path)
    parser.add_argument("--kept", type=Path, required=True, help="folder of places that are registered already")
    arguments = parser.parse_args()
    print("| room: points | points | masks | IoU | of large | of small |\n" + "|---" * 6 + "|")
    for folder in arguments.rooms:
        scene = read_scene(folder)
        first = {view.name for view in scene.views[::FIRST]}
        views = [view for view in scene.views if view.name not in first]
        for kind in ASKING:
            print(f"| {scene.name}: {kind} | {row(scene, views, kind, None)}", flush=True)
        for name, ids in (("found objects", found_objects(folder, arguments.kept, first)), ("true things", scene.ids)):
            print(f"| {scene.name}: rounds after {name} | {row(scene, views, 'rounds', ids)}", flush=True)


if __name__ == "__main__":
    main()
