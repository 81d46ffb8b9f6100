"""drsplat locate (also: query): words, a picture or a click -> the things in the scene."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ..defaults import MIN_GAUSSIANS
from .answers import asked
from .options import count
from .query_options import (
    add_output_options,
    add_query_options,
    ask_of,
    check_outputs,
    draw,
    measured_said,
    numbers_of,
    query_said,
    take_folder,
)

if TYPE_CHECKING:
    from ..asking import Asked
    from ..gaussians import Gaussians
    from ..tasks import Instance

ALIASES = ("query",)
SUMMARY = "find things in a field: where they are, how large, and which photos say so"
EXAMPLES = """\
  drsplat locate room.field "red mug" --scene scene.ply
  drsplat locate room.field "mug, not red" --scene scene.ply --threshold auto
  drsplat locate room.field "red mug" --encoder laion/CLIP-ViT-B-16-laion2B-s34B-b88K --scene scene.ply
  drsplat locate room.field --image my_mug.png --encoder models/clip --threshold 0.6 --scene scene.ply
  drsplat locate room.field --click photo_003:210,140 --views capture --scene scene.ply
  drsplat locate room.field "red mug" --vocabulary clip_texts.json --relevancy --scene scene.ply --top 3
  drsplat locate room.field --vector query.npy --threshold 0.25 --scene scene.ply --save found.ply
  drsplat locate room.field "red mug" --scene scene.ply --picture mug.png --views capture --view photo_003

Which threshold? Cosines of one encoder's texts are near 1 for what fits, those of CLIP between texts and photos
seldom exceed 0.3. Relevancy is the same scale for every encoder; words with --encoder are measured by it. With
--threshold auto each query is cut at a place of its own. For the others look at the printed range."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_query_options(parser)
    parser.add_argument(
        "--top",
        type=count,
        default=10,
        metavar="N",
        help="things to list, best first (default: 10)",
    )
    parser.add_argument(
        "--min-gaussians", type=count, default=MIN_GAUSSIANS, metavar="N",
        help=f"smaller things are specks and left out (default: {MIN_GAUSSIANS})",
    )  # fmt: skip
    parser.add_argument(
        "--box", choices=("upright", "free"), default="upright",
        help="upright: boxes stand on the ground, where the photos told which way is up; free: along the thing's own "
        "axes (default: upright)",
    )  # fmt: skip
    saved = "write the scene with two more columns: relevancy, what was measured; object_id, the number of the thing or -1"
    add_output_options(parser, saved)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import load_field, locate, read_gaussians, select

    take_folder(arguments)
    check_outputs(arguments)
    field = load_field(arguments.field)
    scene = None if arguments.scene is None else read_gaussians(arguments.scene)
    answer = asked(field, ask_of(arguments, scene), arguments.threads)
    ids = select(field, answer.values, answer.threshold)
    report = {
        "field": arguments.field,
        "query": query_said(arguments),
        **numbers_of(answer, len(ids)),
    }
    if scene is None:
        return {**report, "found": len(ids) > 0, "instances": None}
    least = arguments.min_gaussians
    things = locate(
        field, scene, answer.values, answer.threshold, min_gaussians=least, box=arguments.box
    )
    report |= {"found": bool(things), "num_instances": len(things)}
    report["instances"] = [_instance(answer, thing) for thing in things[: arguments.top]]
    if arguments.save:
        _save(arguments, answer, scene, things)
    if arguments.picture:
        report["view"] = _draw(arguments, scene, things)
    return report


def show(answer: dict[str, Any]) -> None:
    from ..terminal import counted
    from .tables import said, show_table

    measured = measured_said(answer)
    if not answer["found"]:
        print(f"Nothing found for '{answer['query']}'.\n{measured}")
        if answer["num_selected"]:
            above = counted(answer["num_selected"], "Gaussian is", "Gaussians are")
            print(f"{above} above the threshold, too few or too scattered for a thing.")
        return
    of = counted(answer["num_registered"], "Gaussian")
    print(f"{said(answer['num_selected'])} of {of} selected\n{measured}")
    if answer["instances"] is None:
        print("For places, pass --scene SCENE.")
        return
    columns = ("thing", "score", "Gaussians", "centre", "extent")
    rows = [_row(number, thing) for number, thing in enumerate(answer["instances"])]
    show_table(
        f"{answer['num_instances']} found for '{answer['query']}', in scene units", columns, rows
    )
    for number, thing in enumerate(
        answer["instances"]
    ):  # names of photos are long, and people copy them
        if thing["support"]:
            photos = dict.fromkeys(mask["view"] for mask in thing["support"])
            print(f"thing {number} is seen in {', '.join(photos)}")


def _row(number: int, thing: dict[str, Any]) -> tuple[str, ...]:
    places = (" ".join(f"{x:.2f}" for x in thing[key]) for key in ("center", "extent"))
    return str(number), f"{thing['score']:.3f}", f"{thing['num_gaussians']:,}", *places


def _instance(answer: Asked, thing: Instance) -> dict[str, Any]:
    from ..support import supporting_masks

    support = (
        supporting_masks(answer.field, thing.gaussian_ids, answer.query, top=3)
        if answer.field.evidence
        else []
    )
    return {
        "score": thing.score,
        "num_gaussians": len(thing),
        "center": thing.center,
        "extent": thing.extent,
        "axes": thing.axes,
        "support": [
            {"view": m.view_name, "segment": m.segment_id, "share": m.share} for m in support
        ],
    }


def _save(
    arguments: argparse.Namespace, answer: Asked, scene: Gaussians, things: list[Instance]
) -> None:
    import numpy as np

    from .. import write_gaussians

    object_ids = np.full(len(scene), -1, np.int32)
    for number, thing in enumerate(things):
        object_ids[thing.gaussian_ids] = number
    columns = {"relevancy": answer.dense, "object_id": object_ids}
    write_gaussians(arguments.save, scene, columns, overwrite=arguments.overwrite)


def _draw(arguments: argparse.Namespace, scene: Gaussians, things: list[Instance]) -> str:
    import numpy as np

    ids = np.concatenate([thing.gaussian_ids for thing in things] or [np.empty(0, np.int64)])
    return draw(arguments, scene, ids, f"{len(things)} found" if things else "not found")
