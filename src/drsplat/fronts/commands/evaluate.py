"""drsplat evaluate: a protocol, its data and what is to be judged -> numbers and a report."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.terminal import counted
from ...errors import InputError
from .declaring import Facts, argument, declaration, finite, flag, length, option, part, whole, words
from .options import Encoders, Verb, left_out, overwrite, without
from .tables import show_table

if TYPE_CHECKING:
    from ...evaluation.running import Judged

OPTIONS_HANDED_ON = (
    "relevancy", "threshold", "method", "automatic", "voxel_side", "figures", "score_only", "overwrite", "threads",
)  # fmt: skip
PROTOCOLS = ("lerf-ovs", "scannet-points", "scannet-volume", "voxel")
EXAMPLES = """\
  drsplat evaluate lerf-ovs lerf_ovs --name teatime --scene teatime.ply --field teatime.field --report out
  drsplat evaluate scannet-volume scans --name scene0000_00 --scene 0.ply --field 0.field \\
      --name scene0062_00 --scene 62.ply --field 62.field --vocabulary clip_texts.json --report out
  drsplat evaluate lerf-ovs lerf_ovs --name teatime --scene teatime.ply --features per_gaussian.npy \\
      --vocabulary clip_texts.json --report peer

Predictions are written to REPORT/predictions and scored from there. Leave the labelled photos out when you register
(the report says whether you did). Tables give results with a fixed threshold, chosen without these scenes, and with
one tuned on them, as in the papers: never compare one with the other."""
DAILY = "name scene field report threshold encoder overwrite"


@declaration
class Scenes:
    """Scenes that are judged: lists with a value for each scene."""

    TITLE = "for each scene, in the same order"
    name: list[str] | None = option("folder in DATA (default: the only one there)", None, words, action="append")
    scene: list[str] = option("scene that was registered", action="append", required=True)
    field: list[str] | None = option("field that `drsplat register` wrote", action="append")
    features: list[str] | None = option(
        "features of any system, instead of --field: (N, D) float16 or float32, a row per Gaussian, zeros for no "
        "feature (.npy, .safetensors), OpenGaussian's cluster_lang.npz, or a PyTorch checkpoint with one such tensor; "
        "with --vocabulary or --encoder for the texts", "FILE.npy", action="append",
    )  # fmt: skip
    decoder: list[str] | None = option(
        "LangSplat's autoencoder, if --features is its checkpoint: three numbers per Gaussian, decoded to 512",
        "FILE.pth", action="append",
    )  # fmt: skip


@declaration
class Options(Verb):
    """Options of this verb."""

    protocol: str = argument("protocol to score by", choices=PROTOCOLS)
    data: str = argument("folder with a folder per scene; for lerf-ovs also with label/")
    scenes: Scenes = part(Scenes)
    report: str = option("folder for the report and the predictions", "DIR", required=True)
    method: str | None = option("name of the method in the tables (default: the measure)", "NAME", words)
    relevancy: bool = flag("measure relevancy against object, things, stuff, texture (default: cosine)")
    threshold: float | None = option("fixed threshold (default: the encoder's own, else 0.5)", "T", finite)
    automatic: bool = flag("score with a threshold per query, too, chosen from its scores")
    label_set: str = option(
        "classes: scannet19, scannet15, scannet10, scannet200, household, or a tab-separated file of id, name, prompt "
        "(default: scannet19)", "SET", words, "scannet19",
    )  # fmt: skip
    label_table: str | None = option(
        "file scannetv2-labels.combined.tsv, for scannet200 (default: the one in DATA)", "FILE"
    )
    prompt: str | None = option(
        'template of the query for a class, e.g. "a photo of a {}" (default: its name)', "TEXT", words
    )
    voxel_side: float = option("side of a voxel in scene units (default: 0.05)", "LENGTH", length, 0.05)
    figures: int = option("pictures per scene (default: 6)", "N", whole, 6)
    score_only: bool = flag("score the predictions that REPORT already has")
    encoders: Encoders = part(Encoders)
    without: str | None = without()
    overwrite: bool = overwrite()

    @property
    def in_photos(self) -> bool:
        """True where the truth is in photos."""
        return self.protocol == "lerf-ovs"


def device(options: Options) -> str:
    """Return the device to draw on."""
    return options.encoders.for_kernels


def run(options: Options) -> Facts:
    from ... import evaluate
    from ...evaluation.report import without_nan
    from ...evaluation.scannet import label_set

    _check(options)
    labels = label_set(options.label_set)
    answer = evaluate(
        options.protocol,
        options.data,
        {name: partial(_judged, options, index) for index, name in enumerate(_names(options))},
        options.report,
        labels=labels.prompted(options.prompt) if options.prompt else labels,
        label_table=Path(options.label_table) if options.label_table else None,
        without=partial(left_out, without=options.without) if options.without else None,
        files=[Path(path) for path in options.scenes.scene if Path(path).is_file()],
        track=options.track,
        **{name: getattr(options, name) for name in OPTIONS_HANDED_ON},
    )
    return dict(without_nan(answer)) if options.json else answer


def show(answer: Facts) -> None:
    from ...evaluation.report import cell_text
    from ...evaluation.tables import pictures_note, tables_of

    for table in (table for table in tables_of([answer]) if not table.aside):
        rows = [tuple(map(cell_text, row)) for row in table.rows]
        show_table(table.title, table.columns, rows)
        if table.note:
            print(f"{table.note}\n")
    print("\n".join([*filter(None, [pictures_note(answer)]), *answer["written"]]))


def _check(options: Options) -> None:
    """Check what can be checked before any work is done."""
    data, scenes, count = Path(options.data), options.scenes, len(options.scenes.scene)
    labels = "NAME/ with photos and poses, label/NAME/ with frame_XXXXX.json"
    if not data.is_dir() or (options.in_photos and not (data / "label").is_dir()):
        layout = labels if options.in_photos else "a folder per scene"
        got = "no label/ in it" if data.is_dir() else "no such folder"
        raise InputError(
            f"{data}: expected the data of {options.protocol} with its truth ({layout}), got {got}: fields are "
            "scored on it and named with --field"
        )
    if not options.score_only and bool(scenes.field) == bool(scenes.features):
        raise InputError("give --field or --features for each scene, and not both")
    if options.without and not options.in_photos:
        raise InputError("--without is for lerf-ovs: the truth of the others is not in photos")
    for name, given in vars(scenes).items():
        if given and len(given) != count:
            raise InputError(f"--{name} is given {counted(len(given), 'time')} and --scene {counted(count, 'time')}")
    if scenes.decoder and not scenes.features:
        raise InputError("--decoder needs --features: give the checkpoint that it decodes")
    if scenes.features and not (options.encoders.vocabulary or options.encoders.encoder):
        raise InputError("--features needs --vocabulary or --encoder: what turns texts into vectors")


def _names(options: Options) -> list[str]:
    """Return the folder names of the scenes. Raises: InputError: none is given, and there is not exactly one."""
    if options.scenes.name:
        return options.scenes.name
    place = Path(options.data, "label" if options.in_photos else "")
    folders = sorted(path.name for path in place.iterdir() if path.is_dir()) if place.is_dir() else []
    if len(folders) != 1 or len(options.scenes.scene) != 1:
        listed = ", ".join(folders[:6]) or "none"
        raise InputError(f"name the scenes of {place} that these are with --name (there: {listed})")
    return folders


def _judged(options: Options, index: int) -> Judged:
    """Return the scene of a field, or Gaussians with features of another system, and the encoder for these."""
    from ... import load_encoder, open_scene, read_gaussians, read_vocabulary
    from ...formats.peer_features import read_peer_features

    scenes, texts = options.scenes, options.encoders
    scene = scenes.scene[index]
    if scenes.field:
        return open_scene(scenes.field[index], scene=scene, threads=options.threads, **vars(texts))
    gaussians = read_gaussians(scene)
    if not scenes.features:
        return gaussians  # with --score-only
    encoder = read_vocabulary(texts.vocabulary) if texts.vocabulary else load_encoder(texts.encoder or "", texts.device)
    decoder = None if scenes.decoder is None else Path(scenes.decoder[index])
    return gaussians, read_peer_features(Path(scenes.features[index]), decoder), encoder
