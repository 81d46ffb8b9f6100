"""What an edit of a whole thing leaves behind, and what it takes of others: in made rooms and in real captures.

python benchmarks/study_loose_parts.py FOLDER... [CAPTURE=SCENE...] [--clip FOLDER --kept FOLDER]

FOLDER: as `drsplat demo` writes it, or a room of world/scenes with a field and its objects: a scene, photos' poses,
ids/, truth.json, a field. A Gaussian is the thing's whose mesh is nearest, up to 5 cm; within 6 mm of two it is
nobody's. Of each thing the object that fits it best is taken, at IoU 0.3 and more. left: weight of its Gaussians that
stay, drawn without the others, per pixel that shows it; taken: weight of others' Gaussians that go, drawn in the whole
scene, as a share of these pixels. Both in up to 8 photos, before (what is enclosed and what hangs on) and now.

CAPTURE=SCENE, --clip, --kept: as of study_click_masks.py, with masks of whole things, simulated. A thing is what a
click into its middle finds, in each photo; left and taken are shares of the outline in the other photos that its
silhouette leaves and goes beyond, iou is that of both.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from world.looks import SPLITS
from world.meshes import Mesh, areas
from world.rooms import make_room

from benchmarks.study_click_masks import clicks_of
from benchmarks.suite.answers import place_of
from benchmarks.suite.outlines import iou, middle
from benchmarks.suite.vocabularies import Clip
from drsplat import Query, Scene, View, open_scene
from drsplat.authoring.editing.resolving import completed
from drsplat.drawing.pictures import visible_share
from drsplat.kernels import render_channels, splat_arrays

FAR, BETWEEN = 0.05, 0.006  # metres
SPACING = {True: 0.004, False: 0.015}  # metres between points on things, and on walls and floors
PHOTOS, SIDE, LEAST_PIXELS = 8, 320, 20


def points_on(mesh: Mesh, spacing: float, rng: np.random.Generator) -> np.ndarray:
    size = areas(mesh.vertices, mesh.faces)
    face = mesh.faces[rng.choice(len(size), max(50, int(size.sum() / spacing**2)), p=size / size.sum())]
    root, v = np.sqrt(rng.random((len(face), 1))), rng.random((len(face), 1))
    a, b, c = (mesh.vertices[face[:, corner]] for corner in range(3))
    return np.asarray(a * (1 - root) + b * root * (1 - v) + c * root * v)


def true_owners(folder: Path, places: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """The thing of each place, -1 for nobody's; names of the things."""
    truth, rng = json.loads((folder / "truth.json").read_text(encoding="utf-8")), np.random.default_rng(0)
    room = make_room(SPLITS[truth["split"]], truth["seed"])
    meshes = [[mesh for _, mesh in thing.part_meshes()] for thing in room.objects]
    meshes += [[mesh for _, mesh in one.pieces] for one in room.structures]
    nearest, second, owner = np.full(len(places), np.inf), np.full(len(places), np.inf), np.full(len(places), -1)
    for number, parts in enumerate(meshes):
        spacing = SPACING[number < len(room.objects)]
        points = np.concatenate([points_on(mesh, spacing, rng) for mesh in parts])
        distance = cKDTree(points).query(places, distance_upper_bound=2 * FAR)[0]
        second = np.minimum(second, np.maximum(distance, nearest))
        owner, nearest = np.where(distance < nearest, number, owner), np.minimum(distance, nearest)
    names = [thing["category"] for thing in truth["objects"]]
    return np.where((nearest > FAR) | (second < nearest + BETWEEN), -1, owner), names


def rows_of(folder: Path) -> Iterator[tuple[str, list[tuple[float, ...]]]]:
    """Each thing's name, and (left, taken) before and now."""
    scene = open_scene(folder)
    truth, names = true_owners(folder, scene.gaussians.positions)
    objects = scene.object_ids().astype(np.int64)
    sizes = np.bincount(objects[objects >= 0])
    views = views_of(scene)
    for number, name in enumerate(names):
        own = truth == number
        both = np.bincount(objects[own & (objects >= 0)], minlength=len(sizes))
        fits = both / (sizes + own.sum() - both)
        if fits.max() < 0.3:
            continue
        ids = np.flatnonzero(objects == fits.argmax())
        ways = ways_of(scene, ids)
        shown = [(view, pixels) for view in views if (pixels := _pixels(folder, view, number)).sum() >= LEAST_PIXELS]
        if shown:
            yield name, [_left_and_taken(scene, rows, own, truth >= 0, shown) for rows in ways]


def ways_of(scene: Scene, ids: np.ndarray) -> list[np.ndarray]:
    """Return what an edit of some Gaussians takes, before and now."""
    objects = scene.object_ids().astype(np.int64)
    return [completed(scene.gaussians, ids, objects, agreed) for agreed in (np.zeros(0, bool), scene.agreed)]


@dataclass(frozen=True, eq=False)
class Clicked:
    """A click at a thing of a capture, and its outlines in the other photos."""

    scene: Scene
    thing: str
    click: tuple[str, float, float]
    others: list[tuple[View, np.ndarray]]

    def measured(self, ids: np.ndarray) -> tuple[float, float, float]:
        """Return what the silhouette of some Gaussians leaves of the outlines, takes beyond them, and their IoU."""
        scene = self.scene
        drawn = [(m, visible_share(scene.gaussians, v, ids, splats=scene.splats) > 0.5) for v, m in self.others]
        every = [((m & ~d).sum() / m.sum(), (d & ~m).sum() / m.sum(), iou(m, d)) for m, d in drawn]
        left, taken, both = np.mean(every, axis=0).tolist()
        return left, taken, both


def clicks_in(capture: str, clip: Clip, kept: Path) -> Iterator[Clicked]:
    """Yield a click at each thing in each photo that has its outline. capture: CAPTURE=SCENE."""
    clicks = clicks_of(place_of(capture, "sam", kept), Path(capture.partition("=")[0]), clip)
    for thing, masks in clicks.masks.items():
        small = {photo: _small(clicks.scene.view(photo), mask) for photo, mask in masks.items()}
        for photo, mask in masks.items() if len(masks) > 1 else ():
            others = [one for name, one in small.items() if name != photo]
            yield Clicked(clicks.scene, thing, (photo, *middle(mask)), others)


def _small(view: View, mask: np.ndarray) -> tuple[View, np.ndarray]:
    small = view.limited(SIDE)
    return small, np.asarray(Image.fromarray(mask).resize((small.width, small.height), Image.Resampling.NEAREST))


def views_of(scene: Scene) -> list[View]:
    every = sorted(scene.views, key=lambda view: view.name)
    return [view.limited(SIDE) for view in every[:: max(1, len(every) // PHOTOS)]][:PHOTOS]


def _pixels(folder: Path, view: View, number: int) -> np.ndarray:
    stored = Image.open(folder / "ids" / f"{Path(view.name).stem}.png")
    return np.asarray(stored.resize((view.width, view.height), Image.Resampling.NEAREST)).astype(int) == number + 1


def _left_and_taken(scene, rows, own, known, shown) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    goes = np.isin(np.arange(len(own)), rows)
    after = splat_arrays(scene.gaussians.subset(np.flatnonzero(~goes)))
    left, taken = own[~goes, None].astype(np.float32), (goes & known & ~own)[:, None].astype(np.float32)
    stays = sum(render_channels(after, view, left).channels[..., 0][pixels].sum() for view, pixels in shown)
    wrong = sum(render_channels(scene.splats, view, taken).channels.sum() for view, _ in shown)
    area = sum(np.count_nonzero(pixels) for _, pixels in shown)
    return float(stays) / area, float(wrong) / area


def report(name: str, rows: Iterator[tuple[str, list[tuple[float, ...]]]]) -> None:
    """Print left and taken of each thing, before and now, and their means."""
    numbers = []
    for thing, ways in rows:
        numbers.append(ways)
        print(f"| {name} | {thing} | " + " | ".join(f"{x:.3f}" for way in ways for x in way) + " |", flush=True)
    for number, way in enumerate(("before", "now")):
        left, taken, *others = np.array(numbers)[:, number].T
        print(
            f"{name}, {way}: left {left.mean():.3f} (median {np.median(left):.3f}, above 5 %: {(left > 0.05).sum()} of "
            f"{len(left)}), taken {taken.mean():.3f} (median {np.median(taken):.3f})"
            + "".join(f", iou {one.mean():.3f}" for one in others),
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("places", nargs="+")
    parser.add_argument("--clip", type=Path)
    parser.add_argument("--kept", type=Path)
    given = parser.parse_args()
    rooms = [Path(one) for one in given.places if "=" not in one]
    if rooms:
        report(", ".join(folder.name for folder in rooms), (row for folder in rooms for row in rows_of(folder)))
    for capture in (one for one in given.places if "=" in one):
        report(Path(capture.partition("=")[0]).name, rows_in(capture, Clip(given.clip), given.kept))


def rows_in(capture: str, clip: Clip, kept: Path) -> Iterator[tuple[str, list[tuple[float, ...]]]]:
    for one in clicks_in(capture, clip, kept):
        ids = one.scene.ask(Query(click=one.click)).gaussian_ids
        if len(ids):
            yield one.thing, [one.measured(rows) for rows in ways_of(one.scene, ids)]


if __name__ == "__main__":
    main()
