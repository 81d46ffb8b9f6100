"""drsplat train: posed photos -> a scene of Gaussians."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from .options import add_invert_masks, add_kernel_device, add_overwrite, count, views_of, whole

if TYPE_CHECKING:
    from ...formats.captures import SparsePoints
    from ...scene.views import View
    from ...training import TrainingSettings

EXAMPLES = """\
  drsplat train capture --output-dir model
  drsplat train capture --output-dir model --resolution 2
  drsplat train capture --output-dir model --schedule original --iterations 7000
  drsplat train capture --output-dir model --strategy mcmc --max-gaussians 300000 --json

To resume a stopped run, give the same command again without --overwrite. A finished run of --schedule original
continues with more --iterations."""
DAILY = ("output_dir", "overwrite", "iterations", "resolution", "device", "images")
RESOLUTION_DIVISORS = (1, 2, 4, 8)
STARTS = {"given": "given", "triangulated": "triangulated from the photos", "random": "random"}
EVERYDAY_ITERATIONS, ORIGINAL_ITERATIONS = 4000, 30_000  # of the two schedules
MAX_SIDE_PIXELS = 1600  # as 3DGS: larger photos are scaled down unless --resolution says otherwise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", help="posed photos: a folder with a COLMAP model, transforms.json or cameras.json")
    parser.add_argument(
        "--output-dir", "--output", "-o", required=True, metavar="DIR",
        help="folder for the model, in the layout of 3DGS",
    )  # fmt: skip
    add_overwrite(parser)
    parser.add_argument(
        "--iterations", type=count, metavar="N",
        help=f"iterations; the everyday schedule is scaled to them, the original one of {ORIGINAL_ITERATIONS} ends "
        f"after them (default: {EVERYDAY_ITERATIONS} everyday, else {ORIGINAL_ITERATIONS})",
    )  # fmt: skip
    parser.add_argument(
        "--resolution", "-r", type=count, metavar="R",
        help=f"divisor of the photos' sides (1, 2, 4 or 8), or their longer side in pixels, at least 64 for good "
        f"results; sides under 11 are refused (default: unchanged, but at most {MAX_SIDE_PIXELS})",
    )  # fmt: skip
    add_kernel_device(parser)
    _add_method(parser)
    _add_course(parser)
    group = parser.add_argument_group("capture")
    group.add_argument(
        "--images", metavar="DIR", help="folder of the photos, e.g. images_4 (default: CAPTURE/images, else CAPTURE)"
    )
    group.add_argument(
        "--points", metavar="FILE",
        help="PLY of initial points, in the frame of the capture's camera file (default: the capture's points, else "
        "points triangulated from its photos)",
    )  # fmt: skip
    group.add_argument(
        "--dataparser-transforms", metavar="FILE",
        help="nerfstudio's dataparser_transforms.json, to train in its frame (default: the one in CAPTURE)",
    )  # fmt: skip
    add_invert_masks(group)
    parser.set_defaults(max_side=None, times=None)


def _add_method(parser: argparse.ArgumentParser) -> None:
    method = parser.add_argument_group("method")
    method.add_argument(
        "--schedule", choices=("everyday", "original"), default="everyday",
        help="schedule of the optimisation: drsplat's, which takes minutes, or that of 3DGS (default: everyday)",
    )  # fmt: skip
    method.add_argument(
        "--strategy", choices=("default", "mcmc"), default="default",
        help="densification strategy: adaptive density control, or relocation within a budget (default: default)",
    )  # fmt: skip
    method.add_argument(
        "--max-gaussians", type=count, metavar="N",
        help="maximum number of Gaussians (default: half the pixels of a photo, more for more than 100 photos; no "
        "limit with --schedule original, where mcmc needs one)",
    )  # fmt: skip
    method.add_argument(
        "--background", choices=("black", "white", "random"), default="black",
        help="colour behind the Gaussians; random is a new one each iteration (default: black)",
    )  # fmt: skip
    method.add_argument(
        "--sh-degree", type=int, choices=range(4), default=3,
        help="degree of the colours' spherical harmonics (default: 3)",
    )  # fmt: skip
    method.add_argument(
        "--antialiased", action="store_true",
        help="train opacities for viewers with antialiasing (mip): the scene keeps its look from farther away",
    )  # fmt: skip
    method.add_argument(
        "--colors-in-bytes", action="store_true",
        help="limit constant colours to 0 to 1, the range of viewers with 8-bit colours (default: no limit, as in "
        "3DGS)",
    )  # fmt: skip
    method.add_argument("--seed", type=whole, default=0, metavar="N", help="random seed (default: 0)")
    method.add_argument(
        "--test-every", type=whole, default=8, metavar="N",
        help="hold every Nth photo out for testing; 0: none (default: 8)",
    )  # fmt: skip


def _add_course(parser: argparse.ArgumentParser) -> None:
    course = parser.add_argument_group("course of the run")
    course.add_argument(
        "--eval-every", type=whole, default=0, metavar="N",
        help="iterations between evaluations on the held-out photos (default: at the end only)",
    )  # fmt: skip
    course.add_argument(
        "--save-at", type=count, nargs="*", default=[7000], metavar="N",
        help="iterations after which the scene is also saved, before an opacity reset that is due then (default: "
        "7000)",
    )  # fmt: skip
    course.add_argument(
        "--checkpoint-every", type=count, default=1000, metavar="N",
        help="iterations between checkpoints, but at most two minutes (default: 1000)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ... import read_sparse_points, train
    from ...base.progress import Meter
    from ...base.system import peak_memory_bytes
    from ...base.terminal import counted
    from ...kernels.cuda.devices import chosen_device

    device = chosen_device(arguments.device)
    divisor = arguments.resolution if arguments.resolution in RESOLUTION_DIVISORS else None
    views = [
        view.limited(max(view.width, view.height) / divisor if divisor else arguments.resolution or MAX_SIDE_PIXELS)
        for view in _with_photo(arguments)
    ]
    settings = _settings(arguments, views)
    points = read_sparse_points(
        arguments.capture, points=arguments.points, dataparser_transforms=arguments.dataparser_transforms
    )
    _print_triangulation(points, arguments)
    with Meter("training", settings.iterations, quiet=arguments.json) as meter:
        training = train(
            views, settings, arguments.output_dir, points=points, device=device,
            overwrite=arguments.overwrite, save_at=tuple(arguments.save_at),
            checkpoint_every=arguments.checkpoint_every, threads=arguments.threads,
            report=lambda status: meter.update(
                status.iteration,
                f"loss {status.loss:.4f}  PSNR {status.psnr:.2f}  {counted(status.num_gaussians, 'Gaussian')}",
            ),
        )  # fmt: skip
    return {
        "model": arguments.output_dir,
        "device": device,
        "strategy": settings.strategy,
        "num_views": len(views),
        "width": views[0].width,
        "height": views[0].height,
        **training.measures(),
        "history": training.history,
        "peak_memory_bytes": peak_memory_bytes(),
    }


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted
    from .tables import show_facts, size_text, text_of

    seconds, count = answer["seconds"], max(answer["iterations"], 1)
    stages = answer["stage_seconds"].items()
    psnr, ssim = answer["psnr_test"], answer["ssim_test"]
    tested = "nothing was held out" if psnr is None else (
        f"PSNR {psnr:.2f} dB, SSIM {ssim:.4f} on {counted(answer['num_test_views'], 'photo')}"
    )  # fmt: skip
    show_facts(
        f"trained: {answer['model']}",
        {
            "held out": tested,
            "trained on": f"PSNR {answer['psnr_train']:.2f} dB",
            "Gaussians": text_of(answer["num_gaussians"]),
            "started from": " and ".join(f"{n:,} {STARTS[kind]} points" for kind, n in answer["start"].items() if n),
            "photos": f"{answer['num_views']}, {answer['width']}x{answer['height']}"
            + (f", {answer['num_masked_views']} with masks" if answer["num_masked_views"] else ""),
            "time": f"{seconds:.1f} s on {answer['device']}, {1000 * seconds / count:.1f} ms an iteration",
            "stages, ms": ", ".join(f"{name} {1000 * spent / count:.1f}" for name, spent in stages),
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )


def _settings(arguments: argparse.Namespace, views: Sequence[View]) -> TrainingSettings:
    from ...training import TrainingSettings, everyday

    chosen = {
        "seed": arguments.seed, "background": arguments.background, "strategy": arguments.strategy,
        "max_gaussians": arguments.max_gaussians, "sh_degree": arguments.sh_degree,
        "test_every": arguments.test_every, "evaluate_every": arguments.eval_every,
        "antialiased": arguments.antialiased, "colors_in_bytes": arguments.colors_in_bytes,
    }  # fmt: skip
    if arguments.schedule == "everyday":
        return everyday(views, planned_iterations(arguments), **chosen)
    return TrainingSettings(iterations=planned_iterations(arguments), **chosen)


def planned_iterations(arguments: argparse.Namespace) -> int:
    default = EVERYDAY_ITERATIONS if arguments.schedule == "everyday" else ORIGINAL_ITERATIONS
    return default if arguments.iterations is None else int(arguments.iterations)


def _with_photo(arguments: argparse.Namespace) -> Iterable[View]:
    """Return the views with photos, or all where none has one; the reader warns of the others, `train` of all."""
    views = views_of(arguments, arguments.capture)
    return [view for view in views if view.image_path is not None] or views


def _print_triangulation(points: SparsePoints | None, arguments: argparse.Namespace) -> None:
    """Print what was triangulated, before the meter begins to move."""
    if points is None and not arguments.json:
        text = "the capture has no points: triangulating some from its photos, a fifth of a second each"
        print(f"drsplat: {text}", file=sys.stderr)
