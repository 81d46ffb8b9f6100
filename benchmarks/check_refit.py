"""Does training find a scene that is known? From perturbed points, all settings the defaults.

300 Gaussians, 32 photos of 96x72 from a ring, 28 to train on and 4 held out; the points are off by
0.03 scene units (the scene is 2 wide). Exit status 1 when a held-out PSNR is below --least dB.

usage: python benchmarks/check_refit.py [--iterations 3000] [--least 32]
"""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

from machine import arguments

import drsplat as ds
from captures_to_train import known_scene, perturbed_points, photographed, ring

MCMC_BUDGET = 600


def main() -> int:
    given = arguments(__doc__, iterations=3000, least=32.0)
    scene = known_scene()
    found = []
    with tempfile.TemporaryDirectory() as folder:
        views = photographed(Path(folder), scene, ring(32))
        for strategy, budget in (("default", None), ("mcmc", MCMC_BUDGET)):
            settings = ds.TrainingSettings(iterations=given.iterations, strategy=strategy, max_gaussians=budget)
            training = ds.train(views, settings, points=perturbed_points(scene), device="cpu")
            found.append(training.evaluation.psnr)
            print(
                f"{strategy:8} {given.iterations} iterations: PSNR {training.evaluation.psnr:.2f} dB, SSIM "
                f"{training.evaluation.ssim:.4f}, {len(training.gaussians)} Gaussians, {training.seconds:.0f} s"
            )
    return int(min(found) < given.least)


if __name__ == "__main__":
    sys.exit(main())
