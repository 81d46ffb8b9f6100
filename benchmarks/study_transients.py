"""What moves between photos: how much of it is left out of training, how much else, and what the scene gains.

    python benchmarks/study_transients.py CAPTURE... [--iterations 1500] [--side 378] [--every 5] [--seed 0]
        [--pictures FOLDER]

Pieces of photographs that scikit-image ships (a cat, a cup, an astronaut, a cameraman, a rocket), of 2 to 12 % of the
photo, are pasted into every EVERY-th photo that is trained on; what is held out stays as it is. Each capture is trained
four times: as it is and with pasted things, and each with and without looking for what moves. The first table says
which share of the pasted pixels is left out, how many things are (half or more of their pixels), and which share of
all other pixels, farther than 8 pixels from a thing; the second, the PSNR of the photos held out. FOLDER gets each
photo of which something is left out, in red.
"""

import argparse
import random
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFilter
from scipy import ndimage
from skimage import data

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.tables import markdown
from drsplat import load_image, read_sparse_points, read_views, train
from drsplat.drawing.pictures import write_picture
from drsplat.formats.captures import SparsePoints
from drsplat.scene.views import View
from drsplat.training import everyday

TEST_EVERY, NEAR = 8, 8
SHARES = 0.02, 0.12  # of a photo that a thing covers
CORNERS = 24


class Photographed(NamedTuple):
    """Photos in a folder, and the pixels of what was pasted into each."""

    views: list[View]
    things: dict[str, np.ndarray]


class Left(NamedTuple):
    """Shares of the pasted pixels that are left out, of each thing; of all others, photo by photo; and PSNR, dB."""

    pixels: float
    things: list[float]
    others: list[float]
    psnr: float


def pictures() -> list[np.ndarray]:
    grey = np.repeat(data.camera()[..., None], 3, axis=2)
    return [data.astronaut(), data.chelsea(), data.coffee(), grey, data.rocket()]


def pasted(photo: np.ndarray, rng: random.Random) -> tuple[np.ndarray, np.ndarray]:
    """Return the photo with a piece of a picture in it, and where that is."""
    height, width = photo.shape[:2]
    picture = rng.choice(pictures())
    radius = np.sqrt(rng.uniform(*SHARES) * height * width / np.pi)
    center = rng.uniform(0.15, 0.85) * width, rng.uniform(0.2, 0.9) * height
    angles = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    radii, stretch = radius * np.array([rng.uniform(0.75, 1.25) for _ in angles]), rng.uniform(0.7, 1.4)
    corners = np.stack([center[0] + radii * np.cos(angles) * stretch, center[1] + radii * np.sin(angles) / stretch], 1)
    layer = Image.new("L", (width, height))
    ImageDraw.Draw(layer).polygon([tuple(corner) for corner in corners.tolist()], fill=255)
    opaque = np.asarray(layer.filter(ImageFilter.GaussianBlur(1)))[..., None] / 255
    side, short = int(2.5 * radius * max(stretch, 1 / stretch)), min(picture.shape[:2])
    square = Image.fromarray(picture[:short, :short]).resize((side, side))
    canvas = Image.new("RGB", (width, height))
    canvas.paste(square, (int(center[0] - side / 2), int(center[1] - side / 2)))
    return np.uint8(photo * (1 - opaque) + np.asarray(canvas) * opaque), opaque[..., 0] > 0.5


def photographed(capture: Path, folder: Path, side: int, every: int) -> Photographed:
    """Write the photos of a capture, smaller; every: of the photos trained on, 0 for none, get a thing."""
    rng, views, things = random.Random(1), [], {}
    for number, view in enumerate(sorted(read_views(capture), key=lambda view: view.name)):
        small = view.limited(side)
        photo, shown = load_image(replace(small, distortion=None)), np.zeros((small.height, small.width), bool)
        trained = number - number // TEST_EVERY - 1  # among those that are not held out
        if every and number % TEST_EVERY and trained % every == every // 2:
            photo, shown = pasted(photo, rng)
        name = f"{Path(view.name).stem}.png"
        write_picture(folder / name, photo)
        views.append(replace(small, name=name, image_path=folder / name, mask_path=None))
        things[name] = shown
    return Photographed(views, things)


def trained(photos: Photographed, points: SparsePoints | None, chosen: dict[str, int], folder: Path) -> Left:
    settings = everyday(photos.views, test_every=TEST_EVERY, **chosen)
    found = train(photos.views, settings, folder, points=points, device="cpu")
    out, others, pixels = [], [], [0, 0]
    for view in photos.views:
        thing, path = photos.things[view.name], folder / "masks" / f"{view.name}.png"
        left_out = ~np.asarray(Image.open(path)) if path.is_file() else np.zeros_like(thing)
        others.append(float((left_out & ~ndimage.binary_dilation(thing, iterations=NEAR)).mean()))
        if thing.any():
            out.append(float(left_out[thing].mean()))
            pixels = [pixels[0] + int(left_out[thing].sum()), pixels[1] + int(thing.sum())]
    assert found.evaluation is not None
    return Left(pixels[0] / max(pixels[1], 1), out, others, found.evaluation.psnr)


def draw(photos: Photographed, masks: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for view in photos.views:
        path = masks / f"{view.name}.png"
        if path.is_file():
            photo, left_out = load_image(replace(view, distortion=None)).copy(), ~np.asarray(Image.open(path))
            photo[left_out] = photo[left_out] // 2 + np.array([127, 0, 0], np.uint8)
            write_picture(folder / view.name, photo, overwrite=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--iterations", type=int, default=1500)
    parser.add_argument("--side", type=int, default=378)
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    args = parser.parse_args()
    found, gained = [], []
    for capture in args.captures:
        points, row = read_sparse_points(capture), [capture.name]
        for kind, every in {"as it is": 0, "with things": args.every}.items():
            with tempfile.TemporaryDirectory() as place:
                photos = photographed(capture, Path(place), args.side, every)
                chosen = {"iterations": args.iterations, "seed": args.seed}
                with_ = trained(photos, points, chosen, Path(place, "with"))
                without = trained(photos, points, chosen | {"transients_at": 0}, Path(place, "without"))
                if args.pictures:
                    draw(
                        photos, Path(place, "with", "masks"), args.pictures / f"{capture.name}_{kind.replace(' ', '_')}"
                    )
            things = f"{sum(share >= 0.5 for share in with_.things)} of {len(with_.things)}" if every else "-"
            pixels = f"{with_.pixels:.1%}" if every else "-"
            others = f"{np.mean(with_.others):.2%} in {sum(share > 0 for share in with_.others)} of {len(photos.views)}"
            found.append((capture.name, kind, pixels, things, others))
            row += [f"{without.psnr:.2f}", f"{with_.psnr:.2f} ({with_.psnr - without.psnr:+.2f})"]
            print(*found[-1], *row[-2:], flush=True)
        gained.append(row)
    print(markdown(("capture", "photos", "pixels left out", "things", "others left out"), found))
    print(markdown(("capture", "as it is, dB", "looked for", "with things, dB", "looked for"), gained))
    print(describe())


if __name__ == "__main__":
    main()
