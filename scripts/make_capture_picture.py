"""Draw what the built-in models answer on real photos: colours, all matches, with their count.

usage: python scripts/make_capture_picture.py FIELD SCENE CAPTURE docs/images/real_capture.jpg

The one in the README is of 97 photos of a plush doll (docs/images/plush.LICENSE): `drsplat train`, 3000 iterations,
`drsplat embed --segmenter graph --encoder drsplat-mini`, `register` and `objects`, all at their defaults.
"""

import sys

import numpy as np

import drsplat as ds
from drsplat.base.terminal import counted
from drsplat.drawing.pictures import contact_sheet, titled, write_picture

ASKED = ("something blue", "something orange", "something pink")
SIDE_PIXELS, TILE_PIXELS = 640, 400


def panel(scene: ds.Scene, text: str) -> np.ndarray:
    """Return the photo that shows most of an answer, in colour where its matches are."""
    matches = scene.locate(text)
    ids = np.concatenate([match.gaussian_ids for match in matches])
    photo = scene.picture(scene.best_view(ids), ids, photo=True, max_side=SIDE_PIXELS)
    sure = sum(match.sure for match in matches)
    return np.asarray(titled(photo, f"“{text}”", f"{counted(len(matches), 'match', 'matches')}, {sure} sure"))


def main() -> None:
    if len(sys.argv) != 5:
        raise SystemExit(__doc__)
    scene = ds.open_scene(sys.argv[1], scene=sys.argv[2], views=sys.argv[3])
    panels = [panel(scene, text) for text in ASKED]
    write_picture(sys.argv[4], contact_sheet(panels, len(panels), TILE_PIXELS, gap=6), overwrite=True)


if __name__ == "__main__":
    main()
