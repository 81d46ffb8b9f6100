"""drsplat evaluate: a protocol, its data and what is to be judged -> numbers and a report."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .leaving_out import add_without, left_out
from .options import add_overwrite, add_query_encoders, device_for_kernels, finite, length, tracker, whole, words
from .query_options import open_scene

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
DAILY = ("name", "scene", "field", "report", "threshold", "encoder", "overwrite")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("protocol", choices=PROTOCOLS, help="protocol to score by")
    parser.add_argument("data", help="folder with a folder per scene; for lerf-ovs also with label/")
    each = parser.add_argument_group("for each scene, in the same order")
    each.add_argument("--name", type=words, action="append", help="folder in DATA (default: the only one there)")
    each.add_argument("--scene", action="append", required=True, help="scene that was registered")
    each.add_argument("--field", action="append", help="field that `drsplat register` wrote")
    each.add_argument(
        "--features", action="append", metavar="FILE.npy",
        help="features of any system, instead of --field: (N, D) float16 or float32, a row per Gaussian, zeros for no "
        "feature (.npy, .safetensors), OpenGaussian's cluster_lang.npz, or a PyTorch checkpoint with one such tensor; "
        "with --vocabulary or --encoder for the texts",
    )  # fmt: skip
    each.add_argument(
        "--decoder", action="append", metavar="FILE.pth",
        help="LangSplat's autoencoder, if --features is its checkpoint: three numbers per Gaussian, decoded to 512",
    )  # fmt: skip
    parser.add_argument("--report", required=True, metavar="DIR", help="folder for the report and the predictions")
    parser.add_argument(
        "--method", type=words, metavar="NAME", help="name of the method in the tables (default: the measure)"
    )
    parser.add_argument(
        "--relevancy", action="store_true",
        help="measure relevancy against object, things, stuff, texture (default: cosine)",
    )  # fmt: skip
    parser.add_argument(
        "--threshold", type=finite, metavar="T", help="fixed threshold (default: the encoder's own, else 0.5)"
    )
    parser.add_argument(
        "--automatic", action="store_true", help="score with a threshold per query, too, chosen from its scores"
    )
    _add_classes(parser)
    parser.add_argument("--figures", type=whole, default=6, metavar="N", help="pictures per scene (default: 6)")
    parser.add_argument("--score-only", action="store_true", help="score the predictions that REPORT already has")
    add_query_encoders(parser)
    add_without(parser)
    add_overwrite(parser)


def _add_classes(parser: argparse.ArgumentParser) -> None:
    """Add the options of ScanNet's classes, and of how their volumes are counted."""
    parser.add_argument(
        "--label-set", type=words, default="scannet19", metavar="SET",
        help="classes: scannet19, scannet15, scannet10, scannet200, household, or a tab-separated file of id, name, "
        "prompt (default: scannet19)",
    )  # fmt: skip
    parser.add_argument(
        "--label-table", metavar="FILE",
        help="file scannetv2-labels.combined.tsv, for scannet200 (default: the one in DATA)",
    )  # fmt: skip
    parser.add_argument(
        "--prompt", type=words, metavar="TEXT",
        help='template of the query for a class, e.g. "a photo of a {}" (default: its name)',
    )  # fmt: skip
    parser.add_argument(
        "--voxel-side", type=length, default=0.05, metavar="LENGTH",
        help="side of a voxel in scene units (default: 0.05)",
    )  # fmt: skip


def device(arguments: argparse.Namespace) -> str:
    """Return the device to draw on."""
    return device_for_kernels(arguments)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ... import evaluate
    from ...evaluation.label_sets import label_set
    from ...evaluation.report import without_nan

    _check(arguments)
    labels = label_set(arguments.label_set)
    answer = evaluate(
        arguments.protocol,
        arguments.data,
        {name: partial(_judged, arguments, index) for index, name in enumerate(_names(arguments))},
        arguments.report,
        labels=labels.prompted(arguments.prompt) if arguments.prompt else labels,
        label_table=Path(arguments.label_table) if arguments.label_table else None,
        without=partial(left_out, without=arguments.without) if arguments.without else None,
        files=[Path(path) for path in arguments.scene if Path(path).is_file()],
        track=tracker(arguments),
        **{name: value for name, value in vars(arguments).items() if name in OPTIONS_HANDED_ON},
    )
    return dict(without_nan(answer)) if arguments.json else answer


def show(answer: dict[str, Any]) -> None:
    from ...evaluation.report import cell_text
    from ...evaluation.tables import pictures_note, tables_of
    from .tables import show_table

    for table in (table for table in tables_of([answer]) if not table.aside):
        rows = [tuple(map(cell_text, row)) for row in table.rows]
        show_table(table.title, table.columns, rows)
        if table.note:
            print(f"{table.note}\n")
    print("\n".join([*filter(None, [pictures_note(answer)]), *answer["written"]]))


def _check(arguments: argparse.Namespace) -> None:
    """Check what can be checked before any work is done."""
    from ...base.terminal import counted
    from ...errors import InputError

    _check_data(arguments)
    count = len(arguments.scene)
    if not arguments.score_only and bool(arguments.field) == bool(arguments.features):
        raise InputError("give --field or --features for each scene, and not both")
    if arguments.without and arguments.protocol != "lerf-ovs":
        raise InputError("--without is for lerf-ovs: the truth of the others is not in photos")
    for option in ("name", "field", "features", "decoder"):
        given = getattr(arguments, option)
        if given and len(given) != count:
            raise InputError(f"--{option} is given {counted(len(given), 'time')} and --scene {counted(count, 'time')}")
    if arguments.decoder and not arguments.features:
        raise InputError("--decoder needs --features: give the checkpoint that it decodes")
    if arguments.features and not (arguments.vocabulary or arguments.encoder):
        raise InputError("--features needs --vocabulary or --encoder: what turns texts into vectors")


def _check_data(arguments: argparse.Namespace) -> None:
    """Refuse data without the truth to score by."""
    from ...errors import InputError

    data, with_labels = Path(arguments.data), arguments.protocol == "lerf-ovs"
    if not data.is_dir() or (with_labels and not (data / "label").is_dir()):
        layout = (
            "NAME/ with photos and poses, label/NAME/ with frame_XXXXX.json" if with_labels else "a folder per scene"
        )
        got = "no label/ in it" if data.is_dir() else "no such folder"
        raise InputError(
            f"{data}: expected the data of {arguments.protocol} with its truth ({layout}), got {got}: fields are "
            "scored on it and named with --field"
        )


def _names(arguments: argparse.Namespace) -> list[str]:
    """Return the folder names of the scenes. Raises: InputError: none is given, and there is not exactly one."""
    from ...errors import InputError

    if arguments.name:
        return list(arguments.name)
    place = Path(arguments.data, "label") if arguments.protocol == "lerf-ovs" else Path(arguments.data)
    folders = sorted(path.name for path in place.iterdir() if path.is_dir()) if place.is_dir() else []
    if len(folders) != 1 or len(arguments.scene) != 1:
        listed = ", ".join(folders[:6]) or "none"
        raise InputError(f"name the scenes of {place} that these are with --name (there: {listed})")
    return folders


def _judged(arguments: argparse.Namespace, index: int) -> Judged:
    """Return the scene of a field, or Gaussians with features of another system, and the encoder for these."""
    from ... import load_encoder, read_gaussians, read_vocabulary
    from ...formats.peer_features import read_peer_features

    if arguments.field:
        return open_scene(
            argparse.Namespace(**vars(arguments) | {"scene": arguments.scene[index]}), arguments.field[index]
        )
    gaussians = read_gaussians(arguments.scene[index])
    if not arguments.features:
        return gaussians  # with --score-only
    words = arguments.vocabulary
    encoder = read_vocabulary(words) if words else load_encoder(arguments.encoder, arguments.device)
    decoder = None if arguments.decoder is None else Path(arguments.decoder[index])
    return gaussians, read_peer_features(Path(arguments.features[index]), decoder), encoder
