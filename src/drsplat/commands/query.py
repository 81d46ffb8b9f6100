"""drsplat query: words or a vector -> the things in the scene."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from .answers import COSINE_THRESHOLD, MIN_GAUSSIANS, RELEVANCY_THRESHOLD, Ask, Asked, asked
from .options import (
    add_capture_options,
    add_overwrite,
    add_query_encoders,
    count,
    finite,
    new_output,
    view_named,
    views_of,
)

if TYPE_CHECKING:
    from ..gaussians import Gaussians
    from ..tasks import Instance

SUMMARY = "find things in a field, in words, by an image or by a vector"
EXAMPLES = """\
  drsplat query room.field "red mug" --scene scene.ply
  drsplat query room.field "red mug" --encoder laion/CLIP-ViT-B-16-laion2B-s34B-b88K --scene scene.ply
  drsplat query room.field --image my_mug.png --encoder models/clip --threshold 0.6 --scene scene.ply
  drsplat query room.field "red mug" --vocabulary clip_texts.json --relevancy --scene scene.ply --top 3
  drsplat query room.field --vector query.npy --threshold 0.25 --scene scene.ply --save found.ply
  drsplat query room.field "red mug" --scene scene.ply --picture mug.png --views capture --view photo_003

Which threshold? Cosines of one encoder's texts are near 1 for what fits, those of CLIP between texts and photos
seldom exceed 0.3. Relevancy is the same scale for every encoder; words with --encoder are measured by it. For
the others look at the printed range."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("field", help="what `drsplat register` wrote")
    parser.add_argument("text", nargs="?", help="what to look for, in words")
    parser.add_argument(
        "--vector", metavar="FILE.npy", help="look for this embedding instead of words: (D,) floats"
    )
    parser.add_argument(
        "--image", metavar="PICTURE",
        help="look for what this picture shows instead of words, embedded by --encoder; best cut out, on black or "
        "transparent, as masks are",
    )  # fmt: skip
    add_query_encoders(parser)
    parser.add_argument(
        "--threshold", type=finite, metavar="T",
        help=f"select Gaussians above this (default: {COSINE_THRESHOLD} of the cosine, in [-1, 1], 0.6 with the "
        f"built-in words encoder; {RELEVANCY_THRESHOLD} of the relevancy, in [0, 1])",
    )  # fmt: skip
    parser.add_argument(
        "--relevancy", action="store_true",
        help="measure relevancy instead of the cosine: how much better the query fits than any negative; 0.5 is as well "
        "(default: only for words with --encoder)",
    )  # fmt: skip
    parser.add_argument(
        "--negatives", metavar="WORDS|FILE.npy",
        help="compare with these, and measure relevancy (default: those stored in the field, else "
        "object,things,stuff,texture)",
    )  # fmt: skip
    parser.add_argument(
        "--scene", help="the scene that was registered; needed for places, --save and --picture"
    )
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
    output = parser.add_argument_group("output")
    output.add_argument(
        "--save", metavar="OUT.ply",
        help="write the scene with two more columns: relevancy, what was measured; object_id, the number of the thing "
        "or -1",
    )  # fmt: skip
    output.add_argument(
        "--picture",
        metavar="OUT.png",
        help="write a photo with what was found in colour, the rest grey",
    )
    output.add_argument("--views", metavar="CAPTURE", help="the poses, for --picture")
    output.add_argument(
        "--view",
        metavar="NAME",
        help="photo for --picture (default: the one that shows most of it)",
    )
    add_overwrite(output)
    add_capture_options(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import load_field, locate, read_gaussians, select

    _check(arguments)
    answer = asked(load_field(arguments.field), _ask(arguments), arguments.threads)
    ids = select(answer.field, answer.values, answer.threshold)
    report = {
        "field": arguments.field,
        "query": arguments.text or arguments.image or arguments.vector,
        **_numbers(answer, len(ids)),
    }
    if arguments.scene is None:
        return {**report, "found": len(ids) > 0, "instances": None}
    scene = read_gaussians(arguments.scene)
    least = arguments.min_gaussians
    things = locate(answer.field, scene, answer.values, answer.threshold, min_gaussians=least)
    report |= {"found": bool(things), "num_instances": len(things)}
    report["instances"] = [_instance(answer, thing) for thing in things[: arguments.top]]
    if arguments.save:
        _save(arguments, answer, scene, things)
    if arguments.picture:
        report["view"] = _draw(arguments, scene, things)
    return report


def show(answer: dict[str, Any]) -> None:
    from .tables import said, show_table

    low, high = answer["score_range"]
    measured = f"{answer['measure']} from {low:.3f} to {high:.3f}, 99 of 100 below {answer['score_p99']:.3f}; threshold {answer['threshold']:g}"
    if not answer["found"]:
        print(f"Nothing found for '{answer['query']}'.\n{measured}")
        if answer["num_selected"]:
            print(
                f"{said(answer['num_selected'])} Gaussians are above the threshold, too few or too scattered for a thing."
            )
        return
    print(
        f"{said(answer['num_selected'])} of {said(answer['num_registered'])} Gaussians selected\n{measured}"
    )
    if answer["instances"] is None:
        print("For places, pass --scene SCENE.")
        return
    columns = ("thing", "score", "Gaussians", "centre", "extent", "seen in")
    rows = [_row(number, thing) for number, thing in enumerate(answer["instances"])]
    show_table(
        f"{answer['num_instances']} found for '{answer['query']}', in scene units", columns, rows
    )


def _row(number: int, thing: dict[str, Any]) -> tuple[str, ...]:
    photos = ", ".join(dict.fromkeys(mask["view"] for mask in thing["support"]))
    places = (" ".join(f"{x:.2f}" for x in thing[key]) for key in ("center", "extent"))
    return str(number), f"{thing['score']:.3f}", f"{thing['num_gaussians']:,}", *places, photos


def _check(arguments: argparse.Namespace) -> None:
    """All that can be known to be wrong before any work is done."""
    from ..errors import InputError

    for option, output, suffix in (
        ("--save", arguments.save, ".ply"),
        ("--picture", arguments.picture, ""),
    ):
        if output is not None:
            folder = new_output(output, arguments.overwrite, suffix).parent
            if not folder.is_dir():
                raise InputError(f"{option}: there is no folder {folder}: make it first")
            if arguments.scene is None:
                raise InputError(f"{option} needs --scene SCENE")
    if arguments.picture is not None and arguments.views is None:
        raise InputError("--picture needs --views CAPTURE, for a place to look from")


def _ask(arguments: argparse.Namespace) -> Ask:
    names = [field.name for field in fields(Ask)]
    return Ask(**{name: getattr(arguments, name) for name in names})


def _numbers(answer: Asked, num_selected: int) -> dict[str, Any]:
    import numpy as np

    values = answer.values if len(answer.values) else np.zeros(1, np.float32)
    return {
        "measure": answer.measure,
        "threshold": answer.threshold,
        "score_range": [float(values.min()), float(values.max())],
        "score_p99": float(np.percentile(values, 99)),
        "num_registered": len(answer.field),
        "num_selected": num_selected,
    }


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
    values = answer.field.dense(answer.values, fill=0.0 if answer.measure == "relevancy" else -1.0)
    columns = {"relevancy": values, "object_id": object_ids}
    write_gaussians(arguments.save, scene, columns, overwrite=arguments.overwrite)


def _draw(arguments: argparse.Namespace, scene: Gaussians, things: list[Instance]) -> str:
    """Write the picture; returns the name of its view."""
    import numpy as np

    from ..pictures import (
        best_views,
        highlighted,
        photo_or_rendering,
        titled,
        visible_share,
        write_picture,
    )

    views = views_of(arguments, arguments.views)
    ids = np.concatenate([thing.gaussian_ids for thing in things] or [np.empty(0, np.int64)])
    view = (
        view_named(views, arguments.view) if arguments.view else best_views(scene, views, [ids])[0]
    )
    share = visible_share(scene, view, ids, threads=arguments.threads)
    picture = highlighted(photo_or_rendering(scene, view, threads=arguments.threads), share)
    note = f"{len(things)} found" if things else "not found"
    title = f"“{arguments.text}”" if arguments.text else str(arguments.image or arguments.vector)
    write_picture(arguments.picture, titled(picture, title, note), arguments.overwrite)
    return view.name
