"""drsplat evaluate: a protocol, its data and what is to be judged -> numbers and a report."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .leaving_out import add_without, left_out
from .options import add_overwrite, add_query_encoders, finite, length, tracker, whole, words

if TYPE_CHECKING:
    from ..encoders import Encoder
    from ..evaluation.lerf_ovs import LerfScene
    from ..evaluation.report import Figure
    from ..evaluation.scannet import ScannetScene
    from ..evaluation.scorers import Scorer
    from ..scene.gaussians import Gaussians

SUMMARY = "score fields, or features of other systems, on a protocol of the papers"
PROTOCOLS = ("lerf-ovs", "scannet-points", "scannet-volume", "voxel")
EXAMPLES = """\
  drsplat evaluate lerf-ovs lerf_ovs --name teatime --scene teatime.ply --field teatime.field --report out
  drsplat evaluate scannet-volume scans --name scene0000_00 --scene 0.ply --field 0.field \\
      --name scene0062_00 --scene 62.ply --field 62.field --vocabulary clip_texts.json --report out
  drsplat evaluate lerf-ovs lerf_ovs --name teatime --scene teatime.ply --features per_gaussian.npy \\
      --vocabulary clip_texts.json --report peer

Predictions are written to REPORT/predictions and scored from there. Leave the labelled photos out when you
register (the report says whether you did). Tables have a fixed threshold, chosen without these scenes, and one
tuned on them, as the papers have it: never compare the one with the other."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("protocol", choices=PROTOCOLS, help="protocol to score by")
    parser.add_argument("data", help="folder with a folder per scene; of lerf-ovs also with label/")
    each = parser.add_argument_group("for each scene, in the same order")
    each.add_argument("--name", type=words, action="append", help="folder in DATA (default: the only one there)")
    each.add_argument("--scene", action="append", required=True, help="scene that was registered")
    each.add_argument("--field", action="append", help="field that `drsplat register` wrote")
    each.add_argument(
        "--features", action="append", metavar="FILE.npy",
        help="features of any system, instead of --field: (N, D) float16 or float32, a row per Gaussian, zeros where "
        "there is none; with --vocabulary or --encoder for the texts",
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
        "--threshold", type=finite, metavar="T",
        help="fixed threshold (default: the encoder's own, else 0.5)",
    )  # fmt: skip
    parser.add_argument(
        "--automatic", action="store_true", help="score with a threshold per query as well, chosen from its scores"
    )
    parser.add_argument(
        "--label-set", type=words, default="scannet19", metavar="SET",
        help="classes: scannet19, scannet15, scannet10, scannet200, household, or a file of lines id, name, prompt "
        "with "
        "tabs between (default: scannet19)",
    )  # fmt: skip
    parser.add_argument(
        "--label-table",
        metavar="FILE",
        help="file scannetv2-labels.combined.tsv, for scannet200 (default: the one in DATA)",
    )
    parser.add_argument(
        "--prompt",
        type=words,
        metavar="TEXT",
        help='template of the query for a class, e.g. "a photo of a {}" (default: its name)',
    )
    parser.add_argument(
        "--voxel-side",
        type=length,
        default=0.05,
        metavar="LENGTH",
        help="side of a voxel in scene units (default: 0.05)",
    )
    parser.add_argument("--figures", type=whole, default=6, metavar="N", help="pictures per scene (default: 6)")
    parser.add_argument("--score-only", action="store_true", help="score the predictions that are in REPORT already")
    add_query_encoders(parser)
    add_without(parser)
    add_overwrite(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ..evaluation.report import without_nan, write_report

    _check(arguments)
    run_protocol = _lerf if arguments.protocol == "lerf-ovs" else _scannet
    result, figures = run_protocol(arguments, Path(arguments.report) / "predictions")
    written = write_report(Path(arguments.report), [result], figures, overwrite=True)
    answer = {**result, "written": [str(path) for path in written]}
    return dict(without_nan(answer)) if arguments.json else answer


def show(answer: dict[str, Any]) -> None:
    from ..evaluation.report import shown
    from ..evaluation.tables import tables_of
    from .tables import show_table

    for table in (table for table in tables_of([answer]) if not table.aside):
        rows = [tuple(map(shown, row)) for row in table.rows]
        show_table(table.title, table.columns, rows)
        if table.note:
            print(f"{table.note}\n")
    print("\n".join(answer["written"]))


def _check(arguments: argparse.Namespace) -> None:
    """All that can be known to be wrong before any work is done."""
    from ..errors import InputError
    from ..terminal import counted

    count, report = len(arguments.scene), Path(arguments.report)
    if not arguments.score_only and bool(arguments.field) == bool(arguments.features):
        raise InputError("give --field or --features for each scene, and not both")
    if arguments.without and arguments.protocol != "lerf-ovs":
        raise InputError("--without is for lerf-ovs: the truth of the others is not in photos")
    for option in ("name", "field", "features"):
        given = getattr(arguments, option)
        if given and len(given) != count:
            raise InputError(f"--{option} is given {counted(len(given), 'time')} and --scene {counted(count, 'time')}")
    if (report / "results.json").exists() and not (arguments.overwrite or arguments.score_only):
        raise InputError(f"{report} holds results already: pass --overwrite, or name another folder")
    if arguments.features and not (arguments.vocabulary or arguments.encoder):
        raise InputError("--features needs --vocabulary or --encoder: what turns texts into vectors")


def _lerf(arguments: argparse.Namespace, folder: Path) -> tuple[dict[str, Any], list[Figure]]:
    from .. import read_gaussians
    from ..evaluation import lerf_ovs
    from ..evaluation.figures import lerf_figures

    scenes, figures, files = [], [], []
    for index, name in enumerate(_names(arguments, "label")):
        scene = _kept(lerf_ovs.read_lerf_scene(Path(arguments.data), name), arguments.without)
        scenes.append(scene)
        files += sorted((Path(arguments.data) / "label" / name).glob("*.json"))
        if arguments.score_only:
            continue
        gaussians = read_gaussians(arguments.scene[index])
        scorer = _scorer(arguments, index, gaussians)
        threads = arguments.threads
        lerf_ovs.predict(
            scene, gaussians, scorer, folder,
            choosers=_choosers(arguments, scorer), threads=threads, track=tracker(arguments),
        )  # fmt: skip
        figures += lerf_figures(scene, gaussians, scorer, arguments.figures, threads=threads)
    return {**lerf_ovs.score(scenes, folder), "files": _hashes(arguments, files)}, figures


def _kept(scene: LerfScene, without: str | None) -> LerfScene:
    """Without the labelled photos that are left out."""
    from dataclasses import replace

    out = left_out([frame.name for frame in scene.frames], without)
    return replace(scene, frames=tuple(frame for frame in scene.frames if frame.name not in out))


def _scannet(arguments: argparse.Namespace, folder: Path) -> tuple[dict[str, Any], list[Figure]]:
    from ..evaluation import scannet_points, scannet_volume, voxel

    scenes, figures, files = [], [], []
    for index, name in enumerate(_names(arguments, "")):
        scene = _labelled(arguments, Path(arguments.data) / name, arguments.scene[index])
        scenes.append(scene)
        files += sorted((Path(arguments.data) / name).glob("*_vh_clean_2.labels.ply"))
        if arguments.score_only:
            continue
        scorer, track = _scorer(arguments, index, scene.gaussians), tracker(arguments)
        if arguments.protocol == "scannet-volume":
            chosen = _choosers(arguments, scorer)
            scannet_volume.predict(scene, scorer, folder, choosers=chosen, track=track)
            figures += _scannet_figures(arguments, scene, scorer, Path(arguments.data) / name)
        else:
            module = scannet_points if arguments.protocol == "scannet-points" else voxel
            module.predict(scene, scorer, folder, track=track)
    hashes = _hashes(arguments, files)
    if arguments.protocol == "voxel":
        side, threads = arguments.voxel_side, arguments.threads
        return {**voxel.score(scenes, folder, side=side, threads=threads), "files": hashes}, []
    score = {"scannet-points": scannet_points.score, "scannet-volume": scannet_volume.score}
    return {**score[arguments.protocol](scenes, folder), "files": hashes}, figures


def _scannet_figures(arguments: argparse.Namespace, scene: ScannetScene, scorer: Scorer, folder: Path) -> list[Figure]:
    """None where the scene has no cameras."""
    from .. import read_views
    from ..evaluation.figures import scannet_figures

    cameras = folder / "transforms_test.json"
    if not cameras.is_file():
        return []
    views = read_views(cameras)
    return scannet_figures(scene, views, scorer, arguments.figures, threads=arguments.threads)


def _names(arguments: argparse.Namespace, inside: str) -> list[str]:
    """Folder names of the scenes.

    Raises: InputError: none is given, and there is not exactly one.
    """
    from ..errors import InputError

    if arguments.name:
        return list(arguments.name)
    place = Path(arguments.data) / inside
    found = sorted(path.name for path in place.iterdir() if path.is_dir()) if place.is_dir() else []
    if len(found) != 1 or len(arguments.scene) != 1:
        listed = ", ".join(found[:6]) or "none"
        raise InputError(f"name the scenes of {place} that these are with --name (there: {listed})")
    return found


def _labelled(arguments: argparse.Namespace, folder: Path, scene: str) -> ScannetScene:
    from .. import read_gaussians
    from ..evaluation.label_sets import label_set
    from ..evaluation.scannet import read_nyu40_scene, read_raw_category_scene

    labels, gaussians = label_set(arguments.label_set), read_gaussians(scene)
    if arguments.prompt:
        labels = labels.prompted(arguments.prompt)
    if labels.name == "scannet200":
        table = Path(arguments.label_table) if arguments.label_table else None
        return read_raw_category_scene(folder, labels, gaussians, table)
    return read_nyu40_scene(folder, labels, gaussians)


def _scorer(arguments: argparse.Namespace, index: int, gaussians: Gaussians) -> Scorer:
    from dataclasses import replace

    from .. import load_field
    from ..evaluation.scorers import cosine_scorer, feature_scorer, read_features, relevant
    from ..query import encoder_for

    if arguments.features:
        features = read_features(Path(arguments.features[index]))
        scorer = feature_scorer(features, _encoder_of_features(arguments))
    else:
        field = load_field(arguments.field[index])
        field.check_scene(gaussians)
        encoder = encoder_for(field, arguments.vocabulary, arguments.encoder, arguments.device)
        scorer = cosine_scorer(field, encoder, threads=arguments.threads)
    if arguments.relevancy:
        scorer = relevant(scorer)
    threshold = scorer.threshold if arguments.threshold is None else arguments.threshold
    return replace(scorer, name=arguments.method or scorer.name, threshold=threshold)


def _encoder_of_features(arguments: argparse.Namespace) -> Encoder:
    from .. import load_encoder, read_vocabulary

    if arguments.vocabulary:
        return read_vocabulary(arguments.vocabulary)
    return load_encoder(arguments.encoder, arguments.device)


def _choosers(arguments: argparse.Namespace, scorer: Scorer) -> dict[str, Any]:
    from ..evaluation.choosers import automatic_choosers

    return automatic_choosers(scorer) if arguments.automatic else {}


def _hashes(arguments: argparse.Namespace, files: Sequence[Path]) -> dict[str, str]:
    from ..formats.checksums import hash_file

    given = [Path(path) for path in arguments.scene if Path(path).is_file()]
    return {f"{path.parent.name}/{path.name}": hash_file(path) for path in [*given, *files]}
