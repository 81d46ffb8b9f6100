"""Pictures of photos in docs/images: of a walk, of a photo beside its trained scene, and of a film.

usage: python scripts/make_page_pictures.py DEMO FILM FOLDER

DEMO: what `drsplat demo` wrote. FILM: what `python -m world.moving` at 4a01ca08 wrote. FOLDER: for walk.jpg,
trained.jpg and moving.jpg.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

import drsplat as ds

GAP = 8
WALK = ("frame_00001.jpg", "frame_00002.jpg", "frame_00003.jpg", "frame_00004.jpg")
STILL = "frame_00009.jpg"
FRAMES = ("frame_0000.png", "frame_0029.png", "frame_0059.png")


def strip(pictures: Sequence[Image.Image], height: int, path: Path) -> None:
    """Write pictures side by side, white between them."""
    scaled = [one.convert("RGB").resize((round(one.width * height / one.height), height)) for one in pictures]
    whole = Image.new("RGB", (sum(one.width + GAP for one in scaled) - GAP, height), "white")
    left = 0
    for one in scaled:
        whole.paste(one, (left, 0))
        left += one.width + GAP
    whole.save(path, quality=80, optimize=True)


def main(arguments: Sequence[str]) -> int:
    if len(arguments) != 3:
        print(__doc__, file=sys.stderr)
        return 2
    demo, film, folder = map(Path, arguments)
    strip([Image.open(demo / "images" / name) for name in WALK], 180, folder / "walk.jpg")
    room = ds.open_scene(demo)
    view = next(view for view in room.views if view.name + ".jpg" == STILL or view.name == STILL)
    drawn = np.clip(ds.render(ds.read_gaussians(demo / "scene.compressed.ply"), view).rgb, 0, 1)
    pair = [Image.open(demo / "images" / STILL), Image.fromarray((255 * drawn).round().astype(np.uint8))]
    strip(pair, 360, folder / "trained.jpg")
    frames = sorted((film / "capture" / "images").iterdir())[-1]
    strip([Image.open(frames / name) for name in FRAMES], 240, folder / "moving.jpg")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
