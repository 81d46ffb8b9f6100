"""What a click cuts out of a real capture: against outlines that were drawn by hand.

    python benchmarks/study_clicks.py CAPTURE SCENE FIELD [--features FOLDER] [--pictures FOLDER]

FIELD: with objects (`drsplat objects FIELD --scene SCENE` finds them). A thing is clicked at its middle in each of its
photos, and what is found is drawn in the others. "click": IoU of the answer; "best level": of the part, thing or
group there that fits best; "all pieces": of all objects of which most is inside the outline in the photo of the
click, that is what somebody gets who clicks on until the thing is whole, with the number of those larger than a
hundredth of the outline.

--features: what `embed` wrote. Prints what masks alone can do, in the photos themselves: the best single mask, and
all together that are mostly inside. --outlines: others than those of the tests for a capture of this name (the folder
CAPTURE is called plush, desk_penguin or brighton_beach). --pictures: what the first click
found, in each photo, with the outline drawn by hand in yellow.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from scipy import ndimage

from benchmarks.suite.outlines import Click, Clicks, fits_of_masks, middle, outlines_path, read_outlines
from drsplat import Query, open_scene, read_features
from drsplat.drawing.pictures import write_picture

YELLOW = (255, 230, 0)


def row(thing: str, clicks: list[Click]) -> str:
    answers = np.array([click.answer.ious for click in clicks])
    levels = ", ".join(click.best.what for click in clicks)
    best, whole = (
        np.mean([found.mean for found in some]) for some in ([c.best for c in clicks], [c.whole for c in clicks])
    )
    pieces = [click.pieces for click in clicks]
    return (
        f"| {thing} | {answers.mean():.2f} | {answers.min():.2f} to {answers.max():.2f} | {best:.2f} ({levels}) "
        f"| {whole:.2f} | {min(pieces)} to {max(pieces)} |"
    )


def of_masks(clicks: Clicks, folder: Path) -> None:
    features = read_features(folder)
    print("\n| thing | best mask | in single photos | all masks inside |")
    print("|---" * 4 + "|")
    for thing, masks in clicks.masks.items():
        fits = np.array(
            [
                fits_of_masks(
                    features[Path(photo).stem].mask_ids, clicks.scene.view(photo), clicks.outlines[photo][thing]
                )
                for photo in masks
            ]
        )
        best, together = fits.T
        print(f"| {thing} | {best.mean():.2f} | {best.min():.2f} to {best.max():.2f} | {together.mean():.2f} |")


def pictures(clicks: Clicks, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for thing, masks in clicks.masks.items():
        first = next(iter(masks))
        answer = clicks.scene.ask(Query(click=(first, *middle(masks[first]))))
        for photo, mask in masks.items():
            picture = clicks.scene.picture(photo, answer, photo=True)
            picture[mask ^ ndimage.binary_erosion(mask, iterations=3)] = YELLOW
            write_picture(folder / f"{thing}_{Path(photo).stem}.png", picture, overwrite=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("field", type=Path)
    parser.add_argument("--outlines", type=Path)
    parser.add_argument("--features", type=Path)
    parser.add_argument("--pictures", type=Path)
    arguments = parser.parse_args()
    outlines = read_outlines(arguments.outlines or outlines_path(arguments.capture.resolve().name))
    scene = open_scene(arguments.field, scene=arguments.scene, views=arguments.capture)
    clicks = Clicks(scene, outlines)
    print("| thing | click | in single photos | best level | all pieces | pieces |")
    print("|---" * 6 + "|")
    for thing in clicks.masks:
        print(row(thing, list(clicks.of(thing))), flush=True)
    if arguments.features:
        of_masks(clicks, arguments.features)
    if arguments.pictures:
        pictures(clicks, arguments.pictures)


if __name__ == "__main__":
    main()
