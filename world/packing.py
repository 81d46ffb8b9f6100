"""A rendered scene as small files that can ship:

python -m world.packing photos RENDERED --output DIR     photos, poses, points, truth of the held-out photos
drsplat train DIR --output-dir MODEL --iterations 7000 --sh-degree 1 --max-gaussians 100000
python -m world.packing scene MODEL/point_cloud/iteration_7000/point_cloud.ply --output DIR

DIR then has images/, sparse/0/, truth.json, ids/ and scene.compressed.ply, which SuperSplat reads too.
"""

import argparse
import json
import shutil
from pathlib import Path

import gsply
import numpy as np
from PIL import Image

from .layouts import HELD_OUT
from .truth import read_truth

QUALITY, POINTS = 85, 5_000
SCENE = "scene.compressed.ply"


def pack_photos(rendered: Path, output: Path) -> None:
    """All but the scene; ids and labels of held-out photos only."""
    truth = read_truth(rendered)
    for name in ("images", "ids", "sparse/0"):
        (output / name).mkdir(parents=True)
    for view in truth.views:
        photo = Image.open(truth.capture / "images" / view)
        photo.save(output / "images" / view, quality=QUALITY, optimize=True)
    for name in ("cameras.txt", "images.txt"):
        shutil.copy(truth.capture / "sparse/0" / name, output / "sparse/0" / name)
    lines = (truth.capture / "sparse/0/points3D.txt").read_text().splitlines(keepends=True)
    rows = np.linspace(1, len(lines) - 1, min(POINTS, len(lines) - 1)).astype(int)
    (output / "sparse/0/points3D.txt").write_text("".join(lines[k] for k in rows))
    held_out = truth.views[::HELD_OUT]
    for view in held_out:
        ids = Image.fromarray((truth.ids(view) + 1).astype(np.uint8))
        ids.save(output / "ids" / f"{Path(view).stem}.png", optimize=True)
    known = json.loads((rendered / "truth.json").read_text(encoding="utf-8"))
    kept = {key: known[key] for key in ("world", "split", "seed", "cameras", "scene", "structures")}
    kept["objects"] = [
        {k: v for k, v in thing.items() if k != "pixels"} for thing in known["objects"]
    ]
    kept["held_out"] = held_out
    text = json.dumps(kept, indent=1) + "\n"
    (output / "truth.json").write_text(text, encoding="utf-8")


def pack_scene(scene: Path, output: Path) -> None:
    """As SuperSplat's compressed PLY, some 20 bytes per Gaussian."""
    gsply.plywrite(str(output / SCENE), gsply.plyread(str(scene)), compressed=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("part", choices=("photos", "scene"))
    parser.add_argument("source", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    pack = {"photos": pack_photos, "scene": pack_scene}[arguments.part]
    pack(arguments.source, arguments.output)


if __name__ == "__main__":
    main()
