"""drsplat embed: posed photos -> masks and their embeddings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .leaving_out import add_without, left_out
from .options import add_capture_options, add_invert_masks, add_overwrite, count, tracker, up_to, views_of, words
from .parts import parts_of

if TYPE_CHECKING:
    from ...formats.feature_files import Form
    from ...formats.langsplat import FeatureFolder
    from ...photos.embedding.embed import EmbeddingReport
    from ...photos.models.point_masks import PointMaskSettings
    from ...scene.encoders import ImageEncoder
    from ...scene.gaussians import Gaussians
    from ...scene.masks.masks import Segmenter
    from ...scene.views import View

EXAMPLES = """\
  drsplat embed capture
  drsplat embed capture --segmenter facebook/sam2.1-hiera-tiny --points auto --crop-layers 0 \\
      --scene model --views auto --crops objects
  drsplat embed capture --segmenter graph --encoder drsplat-mini
  drsplat embed capture --encoder google/siglip2-base-patch16-224 --output capture/siglip2 --json
  drsplat embed capture --masks capture/language_features --encoder facebook/dinov2-base --output capture/dinov2

To resume a stopped run, give the same command again without --overwrite."""
DAILY = ("output", "segmenter", "encoder", "scene", "device", "overwrite")
DEFAULT_SEGMENTER = "facebook/sam-vit-huge"
DEFAULT_ENCODER = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
ENCODER_HELP = (
    "embedding model, by Hugging Face id or folder: CLIP, MetaCLIP 2, SigLIP, SigLIP 2 or TIPSv2, or DINOv2 or "
    "DINOv3, which know no words; hf-hub:ID for an open_clip model, such as hf-hub:timm/PE-Core-B-16; or "
    f"drsplat-mini, built in, which knows 37 household objects (default: {DEFAULT_ENCODER}, the paper's)"
)
_LEVELS = {"four": ("default", "small", "medium", "large"), "large": ("large",)}
MAX_POINTS_PER_SIDE = 1024
AUTO, ALL = "auto", "all"
COARSE_TO_FINE = {"first_points_per_side": 4, "points_per_side": 64, "most_points": 128}
"""Rounds of 4, 8, 16, 32 and 64 points a side, where no mask explains the photo yet."""
NESTED_MASKS = {"mask_inner": 0.0}
"""Settings of large masks in rounds: what stands on a thing stays beside the mask of both."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", help="posed photos: a folder with a COLMAP model, transforms.json or cameras.json")
    parser.add_argument(
        "--output", "-o", metavar="DIR", help="folder for the features (default: CAPTURE/language_features)"
    )
    parser.add_argument(
        "--langsplat", action="store_true",
        help="write LangSplat's <photo>_s.npy and <photo>_f.npy for other programs: the same data, about a hundred "
        "times as large (default: <photo>.features.safetensors)",
    )  # fmt: skip
    add_overwrite(parser)
    models = parser.add_argument_group("models")
    models.add_argument(
        "--segmenter", type=words, metavar="NAME",
        help=f"SAM, SAM 2, SAM 2.1, SAM 3 or EdgeTAM, by Hugging Face id or folder; or graph, built in: no "
        f"download, an eighth of a second per photo, coarser masks (default: {DEFAULT_SEGMENTER}, the paper's; on "
        "a CPU use graph, or facebook/sam2.1-hiera-tiny with --points auto --crop-layers 0, seconds per photo)",
    )  # fmt: skip
    models.add_argument(
        "--masks", metavar="DIR",
        help="features of the same photos whose masks are reused: only the encoder changes, for `drsplat register "
        "--weights-of` (default: cut the photos again)",
    )  # fmt: skip
    models.add_argument("--encoder", type=words, default=DEFAULT_ENCODER, metavar="NAME", help=ENCODER_HELP)
    add_device(models)
    _add_method(parser.add_argument_group("method"))
    _add_scene(parser.add_argument_group("with the scene, which makes it faster"))
    add_capture_options(parser)
    add_invert_masks(parser)
    add_without(parser)


def _add_method(method: argparse._ArgumentGroup) -> None:
    method.add_argument(
        "--levels", choices=tuple(_LEVELS),
        help="four: default, small, medium and large as in LangSplat; large: only large masks, stored in all four "
        "levels as in Dr. Splat, all that register uses by default (default: four; large with --crops objects; graph "
        "has only large)",
    )  # fmt: skip
    method.add_argument(
        "--points", type=_auto_or(up_to(MAX_POINTS_PER_SIDE)), metavar="N",
        help="SAM: grid of N x N points on each photo and each crop; time grows with N squared. auto refines the grid "
        "only where no mask covers the photo yet, with 128 points at most (default: 32, LangSplat's)",
    )  # fmt: skip
    method.add_argument(
        "--crop-layers", type=int, choices=range(3),
        help="SAM: 1 also searches four enlarged crops, for small objects, and takes five times as long (default: 1, "
        "LangSplat's)",
    )  # fmt: skip
    method.add_argument(
        "--max-height", type=count, default=1080, metavar="PIXELS",
        help="greatest height of a photo; taller ones are scaled down, as LangSplat does (default: 1080)",
    )  # fmt: skip


def _add_scene(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--scene", metavar="SCENE", help="Gaussians of the same photos, as `drsplat train` writes them; no moving scene"
    )
    parser.add_argument(
        "--views", type=_auto_or(count, ALL), default=ALL, metavar="N",
        help="photos to embed: all; N, the N that together show most of the scene; or auto, enough to show all of it "
        "often enough (default: all; the others need --scene)",
    )  # fmt: skip
    parser.add_argument(
        "--crops", choices=("masks", "objects"), default="masks",
        help="crops to embed: one per mask and photo, or, for large masks, a few per object of the scene (default: "
        "masks; objects needs --scene)",
    )  # fmt: skip


def _auto_or(number: Callable[[str], int], *others: str) -> Callable[[str], int | str]:
    """Return the parser of an option that is a number, `auto` or one of some other words."""
    return lambda text: text if text in (AUTO, *others) else number(text)


def add_device(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--device", choices=("auto", "cpu", "cuda", "mps"), default="auto",
        help="device of the models; auto is a GPU if there is one (default: auto)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...base.progress import Stopwatch
    from ...base.system import peak_memory_bytes
    from ...scene.views import pictures_kind

    watch = Stopwatch()
    views = views_of(arguments, arguments.capture)
    without = left_out([view.name for view in views], arguments.without)
    views = [view for view in views if view.name not in without]
    scene = _scene(arguments)
    output = _output_folder(arguments)
    segmenter = _segmenter(arguments)
    encoder = image_encoder(arguments)
    watch.lap("load")
    chosen, seen = _chosen_views(arguments, views, scene)
    report = _embedded(arguments, chosen, output, segmenter, encoder, scene)
    watch.lap("embed")
    made = report.photos - report.reused
    return {
        "output": str(output),
        "pictures": pictures_kind(view.rendered_from for view in chosen),
        "num_photos": report.photos,
        "num_photos_not_chosen": len(views) - len(chosen),
        "seen_share": seen,
        "left_out": sorted(without),
        "num_photos_reused": report.reused,
        "num_photos_redone": report.redone,
        "changes": list(report.changes),
        "num_masks": sum(report.masks.values()),
        "num_crops": report.crops,
        "masks_per_level": dict(report.masks),
        "num_empty_masks": report.empty_masks,
        "encoder": encoder.identity.name,
        "dim": encoder.identity.dim,
        "seconds": sum(watch.seconds.values()),
        "photos_per_second": made / watch.seconds["embed"],
        "peak_memory_bytes": peak_memory_bytes(),
    }


def _scene(arguments: argparse.Namespace) -> Gaussians | None:
    """Return the scene of --scene; None where none is given and none is needed.

    Raises: InputError: one is needed, or it moves.
    """
    from ...errors import InputError
    from ...formats.scenes import read_gaussians

    if arguments.scene is not None:
        return read_gaussians(arguments.scene)
    needed = {"--views": arguments.views != ALL, "--crops": arguments.crops == "objects"}
    for option, is_needed in needed.items():
        if is_needed:
            raise InputError(
                f"{option} {getattr(arguments, option[2:])} needs the scene of the photos: give --scene SCENE"
            )
    return None


def _chosen_views(
    arguments: argparse.Namespace, views: list[View], scene: Gaussians | None
) -> tuple[list[View], float | None]:
    """Return the views of --views, and the share of what all show that they have seen often enough; None for all."""
    from ...photos.embedding.view_choice import ENOUGH_SHARE, choose_views

    if arguments.views == ALL or scene is None:
        return views, None
    enough, most = (ENOUGH_SHARE, None) if arguments.views == AUTO else (1.0, arguments.views)
    choice = choose_views(
        scene, views, enough=enough, most=most, threads=arguments.threads, track=tracker(arguments)
    )  # fmt: skip
    return sorted(choice.views, key=lambda view: view.name), choice.seen[-1] if choice.seen else 0.0


def _embedded(
    arguments: argparse.Namespace,
    views: list[View],
    output: Path,
    segmenter: Segmenter | FeatureFolder,
    encoder: ImageEncoder,
    scene: Gaussians | None,
) -> EmbeddingReport:
    """Embed the crops of --crops. Raises: InputError: --masks keeps masks that are embedded one by one."""
    from ...errors import InputError
    from ...photos.embedding.embed import embed
    from ...photos.embedding.objects_first import embed_objects
    from ...scene.masks.masks import Segmenter

    form: Form = "langsplat" if arguments.langsplat else "compact"
    track, overwrite, max_height = tracker(arguments), arguments.overwrite, arguments.max_height
    if arguments.crops == "masks" or scene is None:
        return embed(
            views, output, segmenter, encoder, max_height=max_height, overwrite=overwrite, form=form, track=track
        )
    if not isinstance(segmenter, Segmenter):
        raise InputError("--masks embeds every mask again: drop --crops objects")
    return embed_objects(
        views, output, segmenter, encoder, scene, parts=parts_of(output), max_height=max_height, overwrite=overwrite,
        form=form, threads=arguments.threads, track=track,
    )  # fmt: skip


def interrupted(arguments: argparse.Namespace) -> str:
    """Return what a stopped run keeps, and how to go on."""
    again = ", without --overwrite," if arguments.overwrite else ""
    folder = _output_folder(arguments)
    return f"the photos embedded so far are kept in {folder}: give the same command again{again} to go on"


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted
    from .tables import show_facts, size_text, text_of

    made, reused = answer["num_photos"] - answer["num_photos_reused"], text_of(answer["num_photos_reused"])
    anew = f", {text_of(answer['num_photos_redone'])} over older files" if answer["num_photos_redone"] else ""
    show_facts(
        f"embedded: {answer['output']}",
        {
            answer["pictures"]: f"{text_of(answer['num_photos'])} ({reused} from an earlier run{anew})",
            "not chosen": _not_chosen(answer),
            "masks": f"{text_of(answer['num_masks'])} ({text_of(answer['masks_per_level'])})",
            "embedded crops": text_of(answer["num_crops"]),
            "empty masks": text_of(answer["num_empty_masks"]),
            "encoder": f"{answer['encoder']} ({answer['dim']}-d)",
            "time": f"{answer['seconds']:.1f} s for {counted(made, 'photo')}",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )


def _not_chosen(answer: dict[str, Any]) -> str:
    if answer["seen_share"] is None:
        return "none: all photos are embedded"
    return f"{answer['num_photos_not_chosen']:,} photos; the chosen ones show {answer['seen_share']:.0%} of what all do"


def _segmenter(arguments: argparse.Namespace) -> Segmenter | FeatureFolder:
    """Return the segmenter of --segmenter, or the masks of --masks. Raises: InputError: both were given."""
    from ... import read_features
    from ...errors import InputError
    from ...photos.models.sam import load_segmenter

    if arguments.masks is None:
        arguments.segmenter = arguments.segmenter or DEFAULT_SEGMENTER
        return load_segmenter(
            arguments.segmenter, arguments.device, point_settings(arguments), threads=arguments.threads
        )
    cutting = (arguments.segmenter, arguments.points, arguments.crop_layers, arguments.levels)
    if any(value is not None for value in cutting):
        raise InputError("--masks keeps what was cut: drop --segmenter, --points, --crop-layers and --levels")
    if arguments.output is None:
        raise InputError("--masks: name another folder for the new features with --output")
    return read_features(arguments.masks)


def _output_folder(arguments: argparse.Namespace) -> Path:
    from ...formats.photo_files import capture_folder

    if arguments.output:
        return Path(arguments.output)
    return capture_folder(Path(arguments.capture)) / "language_features"


def image_encoder(arguments: argparse.Namespace) -> ImageEncoder:
    """Return the encoder of --encoder and --device. Raises: InputError: it embeds words only."""
    from ...errors import InputError
    from ...photos.models.loading import load_encoder
    from ...scene.encoders import ImageEncoder

    encoder = load_encoder(arguments.encoder, arguments.device, threads=arguments.threads)
    if not isinstance(encoder, ImageEncoder):
        raise InputError(f"--encoder {arguments.encoder}: it embeds words, no images: name another")
    return encoder


def point_settings(arguments: argparse.Namespace) -> PointMaskSettings | None:
    """Return the settings of SAM; None for `graph`. InputError: options of SAM for `graph`."""
    from ...errors import InputError
    from ...photos.models.graph import GraphSegmenter
    from ...photos.models.point_masks import PointMaskSettings

    asked = {"points_per_side": arguments.points, "crop_layers": arguments.crop_layers}
    given = {name: value for name, value in asked.items() if value is not None}
    default = "large" if arguments.crops == "objects" else "four"
    levels = arguments.levels or default
    if given.get("points_per_side") == AUTO:
        given |= COARSE_TO_FINE | (NESTED_MASKS if levels == "large" else {})
    if arguments.segmenter != GraphSegmenter.name:
        return PointMaskSettings(**given, levels=_LEVELS[levels])
    if given or arguments.levels == "four":
        raise InputError(
            "--segmenter graph has masks of one level and no point grid: leave out --points, "
            "--crop-layers and --levels four"
        )
    return None
