"""drsplat train: posed photos -> a scene of Gaussians."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from ...base.progress import Meter
from ...base.system import peak_memory_bytes
from ...base.terminal import counted
from .declaring import Facts, count, declaration, flag, option, part, whole
from .options import Photos, Verb, capture, invert_masks, keep_people, kernel_device, overwrite, without_people
from .tables import show_facts, size_text

if TYPE_CHECKING:
    from ...scene.views import View

EXAMPLES = """\
  drsplat train capture --output-dir model
  drsplat train capture --output-dir model --resolution 2
  drsplat train capture --output-dir model --schedule original --iterations 7000
  drsplat train capture --output-dir model --strategy mcmc --max-gaussians 300000 --json

To resume a stopped run, give the same command again without --overwrite. A finished run of --schedule original
continues with more --iterations."""
DAILY = "output_dir overwrite iterations resolution device images"
RESOLUTION_DIVISORS = (1, 2, 4, 8)
STARTS = {"given": "given", "triangulated": "triangulated from the photos", "random": "random"}
EVERYDAY_ITERATIONS, ORIGINAL_ITERATIONS = 3000, 30_000  # of the two schedules
NO_POINTS = "the capture has no points: triangulating some from its photos, a fifth of a second each"
MAX_SIDE_PIXELS = 1600  # as 3DGS: larger photos are scaled down unless --resolution says otherwise


@declaration
class Method:
    """How a scene is optimised."""

    TITLE = "method"
    schedule: str = option(
        "schedule of the optimisation: drsplat's, which takes minutes, or that of 3DGS (default: everyday)",
        default="everyday", choices=("everyday", "original"),
    )  # fmt: skip
    strategy: str = option(
        "densification strategy: adaptive density control, or relocation within a budget (default: default)",
        default="default", choices=("default", "mcmc"),
    )  # fmt: skip
    max_gaussians: int | None = option(
        "maximum number of Gaussians (default: half the pixels of a photo, more for more than 100 photos; no limit "
        "with --schedule original, where mcmc needs one)", "N", count,
    )  # fmt: skip
    background: str = option(
        "colour behind the Gaussians; random is a new one each iteration (default: black)",
        default="black", choices=("black", "white", "random"),
    )  # fmt: skip
    sh_degree: int = option(
        "degree of the colours' spherical harmonics (default: 3)", None, int, 3, choices=range(4)
    )  # fmt: skip
    antialiased: bool = flag(
        "train opacities for viewers with antialiasing (mip): the scene keeps its look from farther away"
    )
    colors_in_bytes: bool = flag(
        "limit constant colours to 0 to 1, the range of viewers with 8-bit colours (default: no limit, as in 3DGS)"
    )
    seed: int = option("random seed (default: 0)", "N", whole, 0)
    test_every: int = option("hold every Nth photo out for testing; 0: none (default: 8)", "N", whole, 8)

    @property
    def is_everyday(self) -> bool:
        return self.schedule == "everyday"


@declaration
class Course:
    """When a run measures itself, and what it keeps."""

    TITLE = "course of the run"
    eval_every: int = option(
        "iterations between evaluations on the held-out photos (default: at the end only)", "N", whole, 0
    )
    save_at: list[int] = option(
        "iterations after which the scene is also saved, before an opacity reset that is due then (default: 7000)",
        "N", count, [7000], nargs="*",
    )  # fmt: skip
    checkpoint_every: int = option(
        "iterations between checkpoints, but at most two minutes (default: 1000)", "N", count, 1000
    )


@declaration
class Options(Verb):
    """Options of this verb."""

    capture: str = capture()
    output_dir: str = option(
        "folder for the model, in the layout of 3DGS", "DIR", flags="--output-dir --output -o", required=True
    )
    overwrite: bool = overwrite()
    iterations: int | None = option(
        f"iterations; the everyday schedule is scaled to them, the original one of {ORIGINAL_ITERATIONS} ends after "
        f"them (default: {EVERYDAY_ITERATIONS} everyday, else {ORIGINAL_ITERATIONS})", "N", count,
    )  # fmt: skip
    resolution: int | None = option(
        f"divisor of the photos' sides (1, 2, 4 or 8), or their longer side in pixels, at least 64 for good results; "
        f"sides under 11 are refused (default: unchanged, but at most {MAX_SIDE_PIXELS})", "R", count, flags="-r",
    )  # fmt: skip
    device: str = kernel_device()
    method: Method = part(Method)
    course: Course = part(Course)
    images: str | None = option(
        "folder of the photos, e.g. images_4 (default: CAPTURE/images, else CAPTURE)", "DIR", title="capture"
    )
    points: str | None = option(
        "PLY of initial points, in the frame of the capture's camera file (default: the capture's points, else points "
        "triangulated from its photos)", "FILE", title="capture",
    )  # fmt: skip
    dataparser_transforms: str | None = option(
        "nerfstudio's dataparser_transforms.json, to train in its frame (default: the one in CAPTURE)", "FILE",
        title="capture",
    )  # fmt: skip
    invert_masks: bool = invert_masks("capture")
    keep_people: bool = keep_people("capture")

    @property
    def planned_iterations(self) -> int:
        return self.iterations or (EVERYDAY_ITERATIONS if self.method.is_everyday else ORIGINAL_ITERATIONS)

    def views(self) -> list[View]:
        """Read the views with photos, or all where none has one; the reader warns of the others, `train` of all."""
        photos = Photos(images=self.images, dataparser_transforms=self.dataparser_transforms)
        views = photos.views(self.capture, self.invert_masks)
        views = [view for view in views if view.image_path is not None] or views
        divisor = self.resolution if self.resolution in RESOLUTION_DIVISORS else None
        most = self.resolution or MAX_SIDE_PIXELS
        return [view.limited(max(view.size) / divisor if divisor else most) for view in views]


def run(options: Options) -> Facts:
    from ... import read_sparse_points, train
    from ...kernels.cuda.devices import chosen_device
    from ...training import TrainingSettings, everyday

    device, views = chosen_device(options.device), options.views()
    chosen = {name: value for name, value in vars(options.method).items() if name != "schedule"}
    chosen |= {"evaluate_every": options.course.eval_every} | ({"transients_at": 0} if options.keep_people else {})
    if options.method.is_everyday:
        settings = everyday(views, options.planned_iterations, **chosen)
    else:
        settings = TrainingSettings(iterations=options.planned_iterations, **chosen)
    transforms = options.dataparser_transforms
    points = read_sparse_points(options.capture, points=options.points, dataparser_transforms=transforms)
    if points is None and not options.json:  # before the meter begins to move
        print(f"drsplat: {NO_POINTS}", file=sys.stderr)
    with (
        without_people(options, views, transforms) as used,
        Meter("training", settings.iterations, quiet=options.json) as meter,
    ):
        training = train(
            used, settings, options.output_dir, points=points, device=device,
            overwrite=options.overwrite, save_at=tuple(options.course.save_at),
            checkpoint_every=options.course.checkpoint_every, threads=options.threads,
            report=lambda status: meter.update(
                status.iteration,
                f"loss {status.loss:.4f}  PSNR {status.psnr:.2f}  {counted(status.num_gaussians, 'Gaussian')}",
            ),
        )  # fmt: skip
    return {
        "model": options.output_dir,
        "device": device,
        "strategy": settings.strategy,
        "num_views": len(views),
        "width": views[0].width,
        "height": views[0].height,
        **training.measures(),
        "history": training.history,
        "peak_memory_bytes": peak_memory_bytes(),
    }


def show(answer: Facts) -> None:
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
            "Gaussians": answer["num_gaussians"],
            "started from": " and ".join(f"{n:,} {STARTS[kind]} points" for kind, n in answer["start"].items() if n),
            "photos": f"{answer['num_views']}, {answer['width']}x{answer['height']}"
            + (f", {answer['num_masked_views']} with masks" if answer["num_masked_views"] else "")
            + (f"; what moves is left out of {moved}" if (moved := answer["num_views_with_transients"]) else ""),
            "time": f"{seconds:.1f} s on {answer['device']}, {1000 * seconds / count:.1f} ms an iteration",
            "stages, ms": ", ".join(f"{name} {1000 * spent / count:.1f}" for name, spent in stages),
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )
