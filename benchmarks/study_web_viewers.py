"""How near viewers of the web come to photos with a scene of drsplat: PSNR of what they show in a real browser.

    python benchmarks/study_web_viewers.py CAPTURE SCENE [--photos 2] [--resolution 640]

CAPTURE: photos, of which every eighth, that training held out, is drawn. "model": our own picture of Gaussians whose
constant colours are in bytes (`in_bytes`). "Spark as it is": without `preBlurAmount: 0.3, blurAmount: 0`, with
which it draws plain scenes. "fitted": after `fitted_to_8_bits`. dB against the photos, mean; in brackets against the
model. Needs Chromium, playwright, Node.js and `npm install --prefix tests/foreign`.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import drsplat as ds
from benchmarks.study_colors_8bit import EVERY, MEMORY, as_a_viewer_draws
from browsing import a_browser
from drsplat.scene.eight_bits import fitted_to_8_bits
from drsplat.training.metrics import psnr
from drsplat.training.training_photos import TrainingPhotos
from foreign_viewing import pictured

WAYS = {
    "GaussianSplats3D": ("mkkellogg", False),
    "Spark as it is": ("spark", True),
    "Spark for plain scenes": ("spark", False),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture")
    parser.add_argument("scene")
    parser.add_argument("--photos", type=int, default=2)
    parser.add_argument("--resolution", type=int, default=640)
    given = parser.parse_args()
    scene = ds.read_gaussians(given.scene)
    views = ds.read_views(given.capture, max_side=given.resolution)[::EVERY][: given.photos]
    photos = TrainingPhotos(views, MEMORY)
    results: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder, a_browser() as browser:
        files = {"": Path(folder) / "scene.ply", ", fitted": Path(folder) / "fitted.ply"}
        for path, gaussians in zip(files.values(), (scene, fitted_to_8_bits(scene)), strict=True):
            ds.write_gaussians(path, gaussians)
        for index, view in enumerate(views):
            photo = photos[index].colors()
            model = np.clip(ds.render(as_a_viewer_draws(scene, view), view, threads=1).rgb, 0, 1)
            shown = {"drsplat": np.clip(ds.render(scene, view, threads=1).rgb, 0, 1), "model": model}
            for name, (page, antialiased) in WAYS.items():
                for suffix, path in files.items():
                    shown[name + suffix] = pictured(browser, page, path, view, antialiased=antialiased)
            for name, picture in shown.items():
                results.setdefault(name, []).append((psnr(picture, photo), psnr(picture, model)))
    for name, values in results.items():
        near, to_model = np.mean(values, axis=0)
        print(f"| {name} | {near:.2f} ({to_model:.1f}) |")


if __name__ == "__main__":
    main()
