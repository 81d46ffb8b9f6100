"""A rendered scene as small files that can ship:

python -m world.packing photos RENDERED --output DIR     photos, poses, points, truth
python -m world.packing labels RENDERED --output DIR     labels of LERF-OVS and ScanNet
drsplat train DIR --output-dir MODEL --iterations 7000 --sh-degree 1 --max-gaussians 100000
python -m world.packing scene MODEL/point_cloud/iteration_7000/point_cloud.ply --output DIR

DIR then has images/, sparse/0/, truth.json, ids/, DIR_vh_clean_2.labels.ply and scene.compressed.ply, which
SuperSplat reads too; beside it is label/DIR/frame_XXXXX.json, where LERF-OVS has it. So `drsplat evaluate` reads
the folder above as data of either kind. photos makes the labels as well; labels makes them anew, alone.
"""

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from drsplat.formats.scannet import read_scannet_labels

from .layouts import HELD_OUT, ply
from .truth import read_truth

QUALITY, POINTS = 85, 5_000
LABELLED_POINTS = 15_000
SCENE = "scene.compressed.ply"


def pack_photos(rendered: Path, output: Path) -> None:
    """All but the scene."""
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
    for view in truth.views:
        ids = Image.fromarray((truth.ids(view) + 1).astype(np.uint8))
        ids.save(output / "ids" / f"{Path(view).stem}.png", optimize=True)
    known = json.loads((rendered / "truth.json").read_text(encoding="utf-8"))
    kept = {key: known[key] for key in ("world", "split", "seed", "cameras", "scene", "structures")}
    kept["objects"] = [{k: v for k, v in thing.items() if k != "pixels"} for thing in known["objects"]]
    kept["held_out"] = truth.views[::HELD_OUT]
    text = json.dumps(kept, indent=1) + "\n"
    (output / "truth.json").write_text(text, encoding="utf-8")
    pack_labels(rendered, output)


def pack_labels(rendered: Path, output: Path) -> None:
    """The polygons of the held-out photos, and a share of the labelled points; older ones are replaced."""
    truth = read_truth(rendered)
    name = output.resolve().name
    labels = output.resolve().parent / "label" / name
    labels.mkdir(parents=True, exist_ok=True)
    for path in sorted((rendered / "lerf_ovs" / "label" / truth.scene).glob("*.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        text = json.dumps(document, separators=(",", ":")) + "\n"
        (labels / path.name).write_text(text, encoding="utf-8")
    cloud = read_scannet_labels(rendered / "scannet" / truth.scene / f"{truth.scene}_vh_clean_2.labels.ply")
    rows = np.unique(np.linspace(0, len(cloud.labels) - 1, LABELLED_POINTS).astype(int))
    columns = dict(zip("xyz", cloud.positions[rows].astype(np.float32).T, strict=True))
    labels = {"label": cloud.labels[rows].astype(np.uint16)}
    (output / f"{name}_vh_clean_2.labels.ply").write_bytes(ply({**columns, **labels}))


def pack_scene(scene: Path, output: Path) -> None:
    """As SuperSplat's compressed PLY, some 20 bytes per Gaussian."""
    import gsply

    gsply.plywrite(str(output / SCENE), gsply.plyread(str(scene)), compressed=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("part", choices=("photos", "labels", "scene"))
    parser.add_argument("source", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    pack = {"photos": pack_photos, "labels": pack_labels, "scene": pack_scene}[arguments.part]
    pack(arguments.source, arguments.output)


if __name__ == "__main__":
    main()
