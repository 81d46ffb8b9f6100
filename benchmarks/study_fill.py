"""What `--fill` leaves where a thing was, against the same made room built without it.

python benchmarks/study_fill.py FOLDER... --kept FOLDER [--objects 10] [--picture OUT.jpg]

FOLDER: as of study_loose_parts.py. Each thing that an object fits at IoU 0.5 and more, the largest first, is removed
and the hole filled, and seen in the photo that shows most of it. Of the pixels of its silhouette and 3 around it: PSNR
against a rendering of the meshes without the thing, where shadows and reflections that stay count as wrong; and the
share that are specks, off the median of 5 x 5 pixels around them by more than 0.12 in a channel where the rendering is
not. beside: in the ring around, of the scene as it is, which is what training alone leaves. --kept: where renderings of
the meshes are kept; they need Mitsuba, as world/README.md says. --picture: the scene, the truth, and each way.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from world import engine
from world.looks import SPLITS
from world.render import _exposure, built
from world.rooms import Room, make_room

from benchmarks.study_loose_parts import _pixels, true_owners
from drsplat import Scene, View, open_scene, render
from drsplat.authoring.editing import Edit, Fill, Remove, Rows, edited
from drsplat.authoring.editing.draft import OBJECT_ID
from drsplat.authoring.editing.resolving import complete_rows
from drsplat.drawing.pictures import OtherPixels, as_pixels, contact_sheet, titled, write_picture
from drsplat.errors import DrSplatWarning, InputError

SIDE, SAMPLES = 240, 16
OFF, WINDOW = 0.12, (5, 5, 1)  # of 1; pixels
AROUND, RING = 3, 12  # pixels
LEAST_PIXELS, FITS = 150, 0.5
WAYS = ("removed", "filled")


def things_of(folder: Path, scene: Scene, most: int) -> Iterator[tuple[int, str, np.ndarray]]:
    """Yield number, name and Gaussians of things that an object fits, the largest object first."""
    truth, names = true_owners(folder, scene.gaussians.positions)
    objects = scene.object_ids().astype(np.int64)
    sizes, fitting = np.bincount(objects[objects >= 0]), []
    for number, name in enumerate(names):
        own = truth == number
        both = np.bincount(objects[own & (objects >= 0)], minlength=len(sizes))
        fits = both / (sizes + own.sum() - both)
        if fits.max() >= FITS:
            fitting.append((int(fits.argmax()), number, name))
    for thing, number, name in sorted(fitting)[:most]:
        yield number, name, np.flatnonzero(objects == thing)


def true_picture(folder: Path, room: Room, number: int, view: View, views: list[View], kept: Path) -> np.ndarray:
    """Return the room without a thing as the photos' camera would show it, in [0, 1]."""
    path = kept / f"{folder.name}_{number}_{Path(view.name).stem}.png"
    if not path.exists():
        rest = [thing for at, thing in enumerate(room.objects) if at != number]
        world = built(replace(room, objects=rest))
        light = engine.radiance(world, engine.sensor(view, SAMPLES), 0) * exposure(folder, room, views, kept)
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.rint(255 * engine.srgb(light)).astype(np.uint8)).save(path)
    return np.asarray(Image.open(path)) / 255


def exposure(folder: Path, room: Room, views: list[View], kept: Path) -> float:
    """Return that of the photos."""
    path = kept / f"{folder.name}_exposure.txt"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(str(_exposure(built(room), views)))
    return float(path.read_text())


def after(scene: Scene, ids: np.ndarray, view: View) -> list[np.ndarray]:
    """Return what is seen with the thing removed, and with the hole filled."""
    rows, pictures = Rows.of(complete_rows(scene, ids)), []
    gaussians = replace(scene.gaussians, extra={OBJECT_ID: scene.object_ids()})
    for more in ([], [Edit(rows, Fill())]):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DrSplatWarning)
                made = edited(gaussians, [Edit(rows, Remove()), *more])
        except InputError:  # no plane: as if nothing were filled
            made = edited(gaussians, [Edit(rows, Remove())])
        pictures.append(np.clip(render(made, view, threads=1).rgb, 0, 1))
    return pictures


def psnr(picture: np.ndarray, truth: np.ndarray, where: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(picture - truth)[where].mean()))


def specks(picture: np.ndarray, truth: np.ndarray, where: np.ndarray) -> float:
    """Return the share of some pixels that stand out from those around where the truth does not."""
    real = ndimage.binary_dilation(stands_out(truth))
    return float((stands_out(picture) & ~real)[where].mean())


def stands_out(picture: np.ndarray) -> np.ndarray:
    result: np.ndarray = np.abs(picture - ndimage.median_filter(picture, WINDOW)).max(axis=2) > OFF
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--objects", type=int, default=10)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    numbers, tiles = [], list[OtherPixels]()
    for folder in given.folders:
        scene, about = open_scene(folder), json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        room = make_room(SPLITS[about["split"]], about["seed"])
        views = sorted(scene.views, key=lambda view: view.name)
        for number, name, ids in things_of(folder, scene, given.objects):
            view = max((one.limited(SIDE) for one in views), key=lambda one: _pixels(folder, one, number).sum())
            shown = _pixels(folder, view, number)
            if shown.sum() < LEAST_PIXELS:
                continue
            truth = true_picture(folder, room, number, view, views, given.kept)
            here = ndimage.binary_dilation(shown, iterations=AROUND)
            ring = ndimage.binary_dilation(here, iterations=RING) & ~here
            before, pictures = np.clip(render(scene.gaussians, view, threads=1).rgb, 0, 1), after(scene, ids, view)
            looked_at = ((before, ring), *((picture, here) for picture in pictures))
            numbers.append([(psnr(one, truth, at), specks(one, truth, at)) for one, at in looked_at])
            cells = (f"{x:.1f} dB, {share:.1%}" for x, share in numbers[-1])
            print(f"| {folder.name} | {name} | " + " | ".join(cells) + " |", flush=True)
            said = zip(("before", "truth", *WAYS), (before, truth, *pictures), strict=True)
            tiles += [titled(as_pixels(picture), f"{name}, {words}") for words, picture in said]
            if given.picture:
                write_picture(given.picture, contact_sheet(tiles, 4, tile_width=SIDE, gap=4), overwrite=True)
    for words, values in zip(("beside", *WAYS), np.array(numbers).transpose(1, 2, 0), strict=True):
        (psnrs, shares), (median, middle) = values, np.median(values, axis=1)
        print(f"{words}: PSNR {psnrs.mean():.2f} dB (median {median:.2f}), ", end="")
        print(f"specks {shares.mean():.2%} (median {middle:.2%}), of {len(psnrs)}")


if __name__ == "__main__":
    main()
