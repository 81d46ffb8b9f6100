"""Are scenes that a GPU trains as good as those of the CPU? One row for each device and seed.

    python benchmarks/study_cuda.py CAPTURE [--resolution 504] [--schedule everyday|original] [--iterations 4000]
        [--seeds 3] [--devices cpu cuda]

Held-out photos are rendered by the CPU's kernels on both sides. Seeds decide the order of photos and where the halves
of a split Gaussian go: what they move is the interval in which two devices cannot be told apart.
"""

import numpy as np
from machine import arguments

import drsplat as ds
from drsplat.training import everyday


def main() -> None:
    args = arguments(
        __doc__, "capture", resolution=504, schedule="everyday", iterations=4000, seeds=3,
        devices=["cpu", "cuda"],
    )  # fmt: skip
    views, points = ds.read_views(args.capture, max_side=args.resolution), ds.read_sparse_points(args.capture)
    settings_of = ds.TrainingSettings if args.schedule == "original" else lambda **chosen: everyday(views, **chosen)
    for device in args.devices:
        held_out = []
        for seed in range(args.seeds):
            settings = settings_of(iterations=args.iterations, seed=seed)
            done = ds.train(views, settings, points=points, device=device)
            held_out.append(done.evaluation.psnr)
            print(
                f"{device}, seed {seed}: PSNR {done.evaluation.psnr:.2f} held out, {done.psnr_train:.2f} trained on, "
                f"{len(done.gaussians):,} Gaussians, {done.seconds:.1f} s of iterations",
                flush=True,
            )
        print(f"{device}: mean {np.mean(held_out):.2f}, from {min(held_out):.2f} to {max(held_out):.2f}")


if __name__ == "__main__":
    main()
