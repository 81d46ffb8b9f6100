"""CPU seconds and held-out PSNR of whole everyday trainings on one thread.

    python benchmarks/bench_schedule.py CAPTURE... [--side 504] [--seeds 0 1]

Beside an earlier version: `python benchmarks/in_turns.py --before PYTHON --rounds 1 bench_schedule.py CAPTURE...`.
"""

import argparse
import time

from machine import describe

import drsplat as ds
from drsplat.training import everyday


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", metavar="CAPTURE", nargs="+")
    parser.add_argument("--side", type=int, default=504)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    args = parser.parse_args()
    print(describe())
    for capture in args.captures:
        views, points = ds.read_views(capture, max_side=args.side), ds.read_sparse_points(capture)
        for seed in args.seeds:
            begin = time.process_time()
            trained = ds.train(views, everyday(views, seed=seed), points=points, device="cpu", threads=1)
            busy, test = time.process_time() - begin, trained.evaluation
            assert test is not None
            print(
                f"{capture}, seed {seed}: {test.psnr:.2f} dB held out, SSIM {test.ssim:.4f}, {trained.psnr_train:.2f} "
                f"dB trained on, {len(trained.gaussians):,} Gaussians, {busy:.1f} CPU s",
                flush=True,
            )


if __name__ == "__main__":
    main()
