"""drsplat embed: posed photos -> masks and their embeddings."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.progress import Stopwatch
from ...base.terminal import counted
from ...errors import InputError
from .declaring import Facts, count, declaration, flag, option, part, up_to, words
from .options import (
    DEVICES,
    Photos,
    Verb,
    capture,
    invert_masks,
    keep_people,
    left_out,
    overwrite,
    parts_of,
    without,
    without_people,
)
from .tables import show_facts, size_text, text_of

if TYPE_CHECKING:
    from ...formats.langsplat import FeatureFolder
    from ...photos.embedding.embed import EmbeddingReport
    from ...photos.models.point_masks import PointMaskSettings
    from ...query import Scene
    from ...scene.encoders import ImageEncoder
    from ...scene.gaussians import Gaussians
    from ...scene.masks.masks import Segmenter
    from ...scene.views import View
    from ..scanning.choosing import ModelChoice

EXAMPLES = """\
  drsplat embed capture
  drsplat embed capture --segmenter facebook/sam2.1-hiera-tiny --points auto --crop-layers 0 \\
      --scene model --views auto --crops objects
  drsplat embed capture --segmenter graph --encoder drsplat-mini
  drsplat embed capture --encoder google/siglip2-base-patch16-224 --output capture/siglip2 --json
  drsplat embed capture --masks capture/language_features --encoder facebook/dinov2-base --output capture/dinov2
  drsplat embed capture --masks room.field --scene model --encoder drsplat-mini --output capture/things

To resume a stopped run, give the same command again without --overwrite."""
DAILY = "output segmenter encoder scene device overwrite"
DEFAULT_ENCODER = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
ENCODER_HELP = (
    "embedding model, by Hugging Face id or folder: CLIP, MetaCLIP 2, SigLIP, SigLIP 2 or TIPSv2, or DINOv2 or "
    "DINOv3, which know no words; hf-hub:ID for an open_clip model, such as hf-hub:timm/PE-Core-B-16; or "
    "drsplat-mini, built in, which knows 37 household objects (default: "
)
_LEVELS = {"four": ("default", "small", "medium", "large"), "large": ("large",)}
MAX_POINTS_PER_SIDE = 1024
AUTO, ALL = "auto", "all"
COARSE_TO_FINE = {"first_points_per_side": 4, "points_per_side": 64, "most_points": 128}
"""Rounds of 4, 8, 16, 32 and 64 points a side, where no mask explains the photo yet."""
NESTED_MASKS = {"mask_inner": 0.0}
"""Settings of large masks in rounds: what stands on a thing stays beside the mask of both."""


def _auto_or(number: Callable[[str], int], *others: str) -> Callable[[str], int | str]:
    """Return the parser of an option that is a number, `auto` or one of some other words."""
    return lambda text: text if text in (AUTO, *others) else number(text)


def models_device(title: str = "") -> Any:
    return option(
        "device of the models; auto is a GPU if there is one (default: auto)", default="auto",
        choices=("auto", *DEVICES), title=title,
    )  # fmt: skip


@declaration
class Cutting:
    """How photos are cut into masks."""

    TITLE = "method"
    levels: str | None = option(
        "four: default, small, medium and large as in LangSplat; large: only large masks, stored in all four levels as "
        "in Dr. Splat, all that register uses by default (default: four; large with --crops objects; graph has only "
        "large)", choices=tuple(_LEVELS),
    )  # fmt: skip
    points: int | str | None = option(
        "SAM: grid of N x N points on each photo and each crop; time grows with N squared. auto refines the grid only "
        "where no mask covers the photo yet, with 128 points at most (default: 32, LangSplat's)", "N",
        _auto_or(up_to(MAX_POINTS_PER_SIDE)),
    )  # fmt: skip
    crop_layers: int | None = option(
        "SAM: 1 also searches four enlarged crops, for small objects, and takes five times as long (default: 1, "
        "LangSplat's)", None, int, choices=range(3),
    )  # fmt: skip
    max_height: int = option(
        "greatest height of a photo; taller ones are scaled down, as LangSplat does (default: 1080)", "PIXELS", count,
        1080,
    )  # fmt: skip


@declaration
class WithScene:
    """Work that the scene of the photos spares."""

    TITLE = "with the scene, which makes it faster"
    scene: str | None = option(
        "Gaussians of the same photos, as `drsplat train` writes them; no moving scene", "SCENE"
    )  # fmt: skip
    views: int | str = option(
        "photos to embed: all; N, the N that together show most of the scene; or auto, enough to show all of it often "
        "enough (default: all; the others need --scene)", "N", _auto_or(count, ALL), ALL,
    )  # fmt: skip
    crops: str = option(
        "crops to embed: one per mask and photo, or, for large masks, a few per object of the scene (default: masks; "
        "objects needs --scene)", default="masks", choices=("masks", "objects"),
    )  # fmt: skip

    def read(self) -> Gaussians | None:
        """Return the scene; None where none is given and none is needed.

        Raises: InputError: one is needed, or it moves.
        """
        from ...formats.scenes import read_gaussians

        if self.scene is not None:
            return read_gaussians(self.scene)
        needed = f"--views {self.views}" if self.views != ALL else "--crops objects" if self.crops == "objects" else ""
        if needed:
            raise InputError(f"{needed} needs the scene of the photos: give --scene SCENE")
        return None


@declaration
class Options(Verb):
    """Options of this verb."""

    capture: str = capture()
    output: str | None = option(
        "folder for the features (default: CAPTURE/language_features)", "DIR", flags="-o"
    )  # fmt: skip
    langsplat: bool = flag(
        "write LangSplat's <photo>_s.npy and <photo>_f.npy for other programs: the same data, about a hundred times as "
        "large (default: <photo>.features.safetensors)"
    )
    overwrite: bool = overwrite()
    segmenter: str | None = option(
        "SAM, SAM 2, SAM 2.1, SAM 3 or EdgeTAM, by Hugging Face id or folder; or graph, built in: no download, an "
        "eighth of a second per photo, coarser masks (default: auto, as `drsplat scan` chooses: with a GPU "
        "facebook/sam-vit-huge, the paper's, else facebook/sam2.1-hiera-tiny with --points auto --crop-layers 0 "
        "--levels large, seconds per photo; graph where SAM or CLIP cannot be had)", "NAME", words, title="models",
    )  # fmt: skip
    masks: str | None = option(
        "features of the same photos whose masks are reused: only the encoder changes, for `drsplat register "
        "--weights-of`; or a field whose objects are drawn into the photos, the same mask in each, with --scene "
        "(default: cut the photos again)", "DIR", title="models",
    )  # fmt: skip
    encoder: str = option(
        f"{ENCODER_HELP}auto, {DEFAULT_ENCODER}, the paper's, where SAM and CLIP can be had, else drsplat-mini)",
        "NAME", words, AUTO, title="models",
    )  # fmt: skip
    device: str = models_device("models")
    cutting: Cutting = part(Cutting)
    with_scene: WithScene = part(WithScene)
    photos: Photos = part(Photos)
    invert_masks: bool = invert_masks()
    keep_people: bool = keep_people()
    without: str | None = without()

    @property
    def folder(self) -> Path:
        """Folder for the features."""
        from ...formats.photo_files import capture_folder

        return Path(self.output) if self.output else capture_folder(Path(self.capture)) / "language_features"

    def models(self) -> ModelChoice:
        """Return the models, of which "auto" leaves the choice to what can be had here.

        Raises: InputError: the features that are there are of better ones.
        """
        from ...formats.embedding_record import read_record
        from ..scanning.choosing import choose_models

        models = choose_models(self.segmenter or (AUTO if self.masks is None else ""), self.encoder, self.device)
        record = read_record(self.folder)
        made_by = None if record is None else record.settings.get("encoder")
        known = made_by.get("name") if isinstance(made_by, dict) else models.encoder
        if models.reason and self.encoder == AUTO and known != models.encoder and not self.overwrite:
            raise InputError(
                f"{self.folder} holds features of {known}, and what can be had now is {models.encoder}, because "
                f"{models.reason}: name the encoder or another output, or pass overwrite=True"
            )
        return models

    def point_settings(self, models: ModelChoice) -> PointMaskSettings | None:
        """Return the settings of SAM; None for `graph`. Raises: InputError: options of SAM for `graph`."""
        from ...photos.models.graph import GraphSegmenter
        from ...photos.models.point_masks import PointMaskSettings

        light = models.cutting(self.segmenter or AUTO)
        unset: dict[str, Any] = {name: value for name, value in light.items() if getattr(self.cutting, name) is None}
        cutting = replace(self.cutting, **unset)
        asked = {"points_per_side": cutting.points, "crop_layers": cutting.crop_layers}
        given: dict[str, Any] = {name: value for name, value in asked.items() if value is not None}
        levels = cutting.levels or ("large" if self.with_scene.crops == "objects" else "four")
        if given.get("points_per_side") == AUTO:
            given |= COARSE_TO_FINE | (NESTED_MASKS if levels == "large" else {})
        if models.segmenter != GraphSegmenter.name:
            return PointMaskSettings(**given, levels=_LEVELS[levels])
        if given or cutting.levels == "four":
            why = f" (SAM cannot be had: {models.reason})" if models.reason else ""
            raise InputError(
                f"--segmenter graph has masks of one level and no point grid: leave out --points, --crop-layers and "
                f"--levels four{why}"
            )
        return None


def run(options: Options) -> Facts:
    from ...scene.views import pictures_kind

    watch = Stopwatch()
    views = options.photos.views(options.capture, options.invert_masks)
    out = left_out([view.name for view in views], options.without)
    views = [view for view in views if view.name not in out]
    scene = options.with_scene.read()
    models = options.models()
    segmenter = _segmenter(options, models)
    encoder = image_encoder(models.encoder, options.device, options.threads)
    if AUTO in (options.segmenter or AUTO, options.encoder) and not options.json:
        print(f"drsplat: {models.sentence(verb='embed')}", file=sys.stderr)
    watch.lap("load")
    chosen, seen = _chosen_views(options, views, scene)
    with without_people(options, chosen, options.photos.dataparser_transforms) as used:
        report = _embedded(options, used, segmenter, encoder, scene)
    watch.lap("embed")
    return {
        "output": str(options.folder),
        "pictures": pictures_kind(view.rendered_from for view in chosen),
        "num_photos": report.photos,
        "num_photos_not_chosen": len(views) - len(chosen),
        "seen_share": seen,
        "left_out": sorted(out),
        "num_photos_reused": report.reused,
        "num_photos_redone": report.redone,
        "changes": list(report.changes),
        "num_masks": sum(report.masks.values()),
        "num_crops": report.crops,
        "masks_per_level": dict(report.masks),
        "num_empty_masks": report.empty_masks,
        "segmenter": models.segmenter,
        "encoder": encoder.identity.name,
        "dim": encoder.identity.dim,
        "photos_per_second": (report.photos - report.reused) / watch.seconds["embed"],
        **watch.measures(),
    }


def _chosen_views(options: Options, views: list[View], scene: Gaussians | None) -> tuple[list[View], float | None]:
    """Return the views of --views, and the share of what all show that they have seen often enough; None for all."""
    from ...photos.embedding.view_choice import ENOUGH_SHARE, choose_views

    asked = options.with_scene.views
    if asked == ALL or scene is None:
        return views, None
    enough, most = (1.0, asked) if isinstance(asked, int) else (ENOUGH_SHARE, None)
    choice = choose_views(
        scene, views, enough=enough, most=most, **options.running
    )  # fmt: skip
    return sorted(choice.views, key=lambda view: view.name), choice.seen[-1] if choice.seen else 0.0


def _embedded(
    options: Options,
    views: list[View],
    segmenter: Segmenter | FeatureFolder | Scene,
    encoder: ImageEncoder,
    scene: Gaussians | None,
) -> EmbeddingReport:
    """Embed the crops of --crops, of the objects of a scene once they are drawn.

    What moves is left out where training wrote masks of it beside the scene.
    """
    from ...authoring.exporting.masking import draw_features
    from ...formats.mask_files import FOLDER
    from ...photos.embedding.embed import embed
    from ...photos.embedding.objects_first import embed_objects
    from ...query import Scene
    from ...training.transients import with_masks

    if options.with_scene.scene and not options.keep_people:
        views = with_masks(views, Path(options.with_scene.scene) / FOLDER)
    shared: dict[str, Any] = {"overwrite": options.overwrite, "track": options.track}
    output, parts, few = options.folder, parts_of(options.folder), options.with_scene.crops == "objects"
    if isinstance(segmenter, Scene):
        segmenter = draw_features(parts / "drawn", segmenter, views, whole=few, **shared)
    shared |= {"max_height": options.cutting.max_height, "form": "langsplat" if options.langsplat else "compact"}
    if not few or scene is None:
        return embed(views, output, segmenter, encoder, **shared)
    return embed_objects(views, output, segmenter, encoder, scene, parts=parts, threads=options.threads, **shared)


def interrupted(options: Options) -> str:
    """Return what a stopped run keeps, and how to go on."""
    again = ", without --overwrite," if options.overwrite else ""
    return f"the photos embedded so far are kept in {options.folder}: give the same command again{again} to go on"


def show(answer: Facts) -> None:
    made, reused = answer["num_photos"] - answer["num_photos_reused"], text_of(answer["num_photos_reused"])
    anew = f", {text_of(answer['num_photos_redone'])} over older files" if answer["num_photos_redone"] else ""
    show_facts(
        f"embedded: {answer['output']}",
        {
            answer["pictures"]: f"{text_of(answer['num_photos'])} ({reused} from an earlier run{anew})",
            "not chosen": "none: all photos are embedded"
            if answer["seen_share"] is None
            else (
                f"{answer['num_photos_not_chosen']:,} photos; the chosen ones show {answer['seen_share']:.0%} of what "
                "all do"
            ),
            "masks": f"{text_of(answer['num_masks'])} ({text_of(answer['masks_per_level'])})",
            "embedded crops": answer["num_crops"],
            "empty masks": answer["num_empty_masks"],
            "encoder": f"{answer['encoder']} ({answer['dim']}-d)",
            "time": f"{answer['seconds']:.1f} s for {counted(made, 'photo')}",
            "peak memory": size_text(answer["peak_memory_bytes"]),
        },
    )


def _segmenter(options: Options, models: ModelChoice) -> Segmenter | FeatureFolder | Scene:
    """Return the segmenter of --segmenter, or what --masks names. Raises: InputError: both were given."""
    from ... import open_scene, read_features
    from ...formats.field_folder import MANIFEST
    from ...photos.models.sam import load_segmenter

    if options.masks is None:
        settings = options.point_settings(models)
        return load_segmenter(models.segmenter, options.device, settings, threads=options.threads)
    cutting = options.cutting
    if any(value is not None for value in (options.segmenter, cutting.points, cutting.crop_layers, cutting.levels)):
        raise InputError("--masks keeps what was cut: drop --segmenter, --points, --crop-layers and --levels")
    if options.output is None:
        raise InputError("--masks: name another folder for the new features with --output")
    if (Path(options.masks) / MANIFEST).is_file():
        return open_scene(options.masks, scene=options.with_scene.scene, threads=options.threads)
    return read_features(options.masks)


def image_encoder(name: str, device: str, threads: int) -> ImageEncoder:
    """Return an encoder of pictures. Raises: InputError: it embeds words only."""
    from ...photos.models.loading import load_encoder
    from ...scene.encoders import ImageEncoder

    encoder = load_encoder(name, device, threads=threads)
    if not isinstance(encoder, ImageEncoder):
        raise InputError(f"--encoder {name}: it embeds words, no images: name another")
    return encoder
