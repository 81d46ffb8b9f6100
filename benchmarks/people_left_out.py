"""How well people are found and left out of photos, and what is left out where nobody is.

    python benchmarks/people_left_out.py CAPTURE... [--annotated FILE.json]... [--pictures FOLDER]

CAPTURE: posed photos without people. FILE.json: annotations of people in the form of COCO (polygons or runs), with the
pictures beside it or in `images` beside it. The first table says which share of the pixels of people is left out of the
annotated pictures, and how many people are found, half or more of each, by their size; the second the same of those
who are cut out of them, when they are whole and large enough, and pasted into every third photo of the captures at any
size from a third of the height on: standing below, or cut off by the lower border, anywhere from left to right. The
third says what is left out of the captures as they are, by the network alone and where the capture has points, and the
CPU time of a photo, on all cores together. FOLDER gets pictures of those who are missed, and of all that is left out
wrongly.
"""

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.machine import describe
from benchmarks.suite.tables import markdown
from drsplat.drawing.pictures import write_picture
from drsplat.formats.captures import read_sparse_points, read_views
from drsplat.photos.models.people import people, without_people
from drsplat.photos.models.people.finding import SIDE_PIXELS
from drsplat.scene.photos import load_image
from drsplat.scene.views import View

LARGE_SHARE = 0.01  # of the picture
PASTED_SIDE = 120  # pixels from head to feet, in the annotated picture, from which on somebody is pasted
EVERY = 3

CutOut = tuple[np.ndarray, np.ndarray]  # a picture, and which of its pixels are somebody's


class Seen(NamedTuple):
    """A picture with somebody in it: what is left out, and the pixels of each person."""

    name: str
    image: np.ndarray
    left_out: np.ndarray
    persons: list[np.ndarray]


def annotated(path: Path) -> Iterator[tuple[str, np.ndarray, list[np.ndarray]]]:
    """Yield each picture and the pixels of each person in it; crowds are no persons."""
    document = json.loads(path.read_text())
    for entry in document["images"]:
        name = Path(entry["file_name"]).name
        file = next(place for place in (path.parent / name, path.parent / "images" / name) if place.is_file())
        image = np.asarray(Image.open(file).convert("RGB"))
        parts = [one for one in document["annotations"] if one["image_id"] == entry["id"] and not one.get("iscrowd")]
        yield name, image, [pixels_of(one["segmentation"], image.shape[:2]) for one in parts]


def pixels_of(segmentation: Any, shape: tuple[int, int]) -> np.ndarray:
    """Return the pixels of polygons, or of runs down the columns."""
    if isinstance(segmentation, list):
        picture = Image.new("L", shape[::-1])
        for polygon in segmentation:
            ImageDraw.Draw(picture).polygon([tuple(point) for point in np.reshape(polygon, (-1, 2))], fill=1)
        return np.asarray(picture) > 0
    counts = segmentation["counts"]
    runs = unpacked(counts) if isinstance(counts, str) else counts
    flat = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return flat.reshape(shape[::-1]).T


def unpacked(text: str) -> list[int]:
    """Return the runs of COCO's packed form: five bits a letter, and from the fourth on less what was two before."""
    runs: list[int] = []
    letters = iter(text)
    for letter in letters:
        value, shift = 0, 0
        while True:
            bits = ord(letter) - 48
            value |= (bits & 31) << shift
            shift += 5
            if not bits & 32:
                break
            letter = next(letters)
        if bits & 16:
            value -= 1 << shift
        runs.append(value + (runs[-2] if len(runs) > 2 else 0))
    return runs


def resized(image: np.ndarray, height: int) -> np.ndarray:
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    way = Image.Resampling.NEAREST if image.dtype == bool else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(image).resize((width, height), way))


def seen(name: str, image: np.ndarray, persons: list[np.ndarray]) -> Seen:
    scale = SIDE_PIXELS / max(image.shape[:2])
    height = min(SIDE_PIXELS, round(image.shape[0] * scale))
    small = resized(image, height)[:, :SIDE_PIXELS]
    return Seen(name, small, people(small) > 0, [resized(one, height)[:, :SIDE_PIXELS] for one in persons])


def cut_outs(pictures: list[Seen]) -> list[CutOut]:
    """Return the picture and the pixels of each person that is large, and not half behind something."""
    found = []
    for picture in pictures:
        for person in picture.persons:
            rows, columns = np.nonzero(person)
            box = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
            if np.ptp(rows) >= PASTED_SIDE and person[box].mean() > 0.3:
                found.append((picture.image[box], person[box]))
    return found


def pasted(
    photo: np.ndarray, person: tuple[np.ndarray, np.ndarray], rng: random.Random
) -> tuple[np.ndarray, np.ndarray]:
    height, width = photo.shape[:2]
    tall = round(height * rng.uniform(1 / 3, 1.1))
    picture, shown = (resized(part, tall) for part in person)
    top = height - tall if tall < height and rng.random() < 0.5 else height - round(tall * rng.uniform(0.6, 1))
    left = rng.randint(-shown.shape[1] // 4, width - shown.shape[1] * 3 // 4)
    rows, columns = np.nonzero(shown)
    inside = (rows + top >= 0) & (rows + top < height) & (columns + left >= 0) & (columns + left < width)
    rows, columns = rows[inside], columns[inside]
    result, where = photo.copy(), np.zeros((height, width), bool)
    result[rows + top, columns + left] = picture[rows, columns]
    where[rows + top, columns + left] = True
    return result, where


def raster(view: View) -> np.ndarray:
    return load_image(replace(view.limited(SIDE_PIXELS), distortion=None))


def found_row(name: str, pictures: list[Seen]) -> list[str]:
    persons = [(one, picture.left_out) for picture in pictures for one in picture.persons if one.any()]
    hits = [(float(out[one].mean()), one.mean() >= LARGE_SHARE, one.sum()) for one, out in persons]
    pixels = sum(share * count for share, _, count in hits) / sum(count for *_, count in hits)
    large = [share >= 0.5 for share, is_large, _ in hits if is_large]
    small = [share >= 0.5 for share, is_large, _ in hits if not is_large]
    return [name, str(len(pictures)), f"{pixels:.1%}", f"{sum(large)} of {len(large)}", f"{sum(small)} of {len(small)}"]


def wrong_row(capture: Path, pictures: Path | None) -> list[str]:
    """Say what is left out of a capture; show the pictures of it."""
    views, row = read_views(capture), [capture.name]
    points = read_sparse_points(capture)
    row.append(str(len(views)))
    for known in (None, points):
        begin, shares = time.process_time(), []
        with tempfile.TemporaryDirectory() as folder:
            masked = without_people(views, known, Path(folder))
            seconds = (time.process_time() - begin) / len(views)
            for view in masked:
                left_out = np.zeros(1, bool) if view.mask_path is None else np.asarray(Image.open(view.mask_path)) == 0
                shares.append(left_out.mean())
                if left_out.any() and pictures is not None:
                    kind = "alone" if known is None else "points"
                    small = resized(left_out, raster(view).shape[0])
                    write_picture(
                        pictures / f"wrong_{kind}_{capture.name}_{view.name}.png", marked(raster(view), small)
                    )
        row.append(f"{np.mean(shares):.3%} ({sum(share > 0 for share in shares)})")
    return [*row, f"{seconds:.2f} s"]


def marked(image: np.ndarray, left_out: np.ndarray) -> np.ndarray:
    shown = image.copy()
    width = min(left_out.shape[1], image.shape[1])
    shown[:, :width][left_out[:, :width]] = shown[:, :width][left_out[:, :width]] // 2 + np.array([127, 0, 0], np.uint8)
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--annotated", type=Path, action="append", default=[], metavar="FILE.json")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    real = [seen(*one) for path in arguments.annotated for one in annotated(path)]
    groups, rng = {"annotated": real} if real else {}, random.Random(0)
    whole = cut_outs(real)
    for capture in arguments.captures if whole else []:
        photos = [(view.name, *pasted(raster(view), rng.choice(whole), rng)) for view in read_views(capture)[::EVERY]]
        groups[f"pasted into {capture.name}"] = [seen(name, image, [where]) for name, image, where in photos]
    columns = ["people", "pictures", "pixels left out", "found, large", "found, smaller"]
    print(markdown(columns, [found_row(name, pictures) for name, pictures in groups.items()]), end="\n\n")
    for name, pictures in groups.items() if arguments.pictures is not None else []:
        for picture in pictures:
            if any(one.any() and picture.left_out[one].mean() < 0.5 for one in picture.persons):
                file = arguments.pictures / f"missed_{name.replace(' ', '_')}_{picture.name}.png"
                write_picture(file, marked(picture.image, picture.left_out))
    rows = [wrong_row(capture, arguments.pictures) for capture in arguments.captures]
    print(markdown(["capture", "photos", "left out, network alone", "with points", "CPU time of a photo"], rows))
    print(describe())


if __name__ == "__main__":
    main()
