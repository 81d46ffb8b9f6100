"""drsplat segment: classes in words -> what each Gaussian is."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ...query.schema import CUT
from .leaving_out import lines_of
from .options import add_query_encoders, words
from .query_options import (
    FIELD_HELP,
    add_fields,
    add_output_options,
    check_outputs,
    chosen_view,
    cut_of,
    open_scene_for_output,
)

if TYPE_CHECKING:
    from ...query import Scene, Segmentation

EXAMPLES = """\
  drsplat segment room.field --classes "mug,bowl,table"
  drsplat segment room.field --classes "mug,bowl,table" --scene scene.ply --save classes.ply
  drsplat segment room.field --classes-file scannet20.txt --encoder models/clip --threshold 0 --scene scene.ply
  drsplat segment room.field --classes "mug,bowl,table" --scene scene.ply --picture classes.png --views capture

A Gaussian gets the class with the highest score if that exceeds the threshold, and otherwise none. The paper labels
every Gaussian: --threshold -1, or 0 for relevancy. With --threshold auto, each class has its own threshold.
classes.ply has a column class_id, -1 for none, and shows the colours of the classes in any viewer."""
DAILY = ("classes", "classes_file", "scene", "encoder", "save", "picture", "views", "overwrite")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("field", help=FIELD_HELP)
    parser.add_argument("--classes", type=words, metavar="A,B,C", help="classes, separated by commas")
    parser.add_argument(
        "--classes-file", metavar="FILE.txt", help="file with a class on each line, instead of --classes"
    )
    add_query_encoders(parser)
    add_fields(parser, CUT)
    saved = (
        "write the scene in the colours of the classes, with a column class_id: the number of the class from 0, or -1"
    )
    add_output_options(parser, saved)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...formats.replacing import together
    from ...query.documents import segmentation_document

    check_outputs(arguments)
    classes = _classes(arguments)
    scene = open_scene_for_output(arguments)
    found = scene.segment(classes, cut_of(arguments))
    rule = found.answers[0].rule
    report = {"field": arguments.field, "threshold_rule": rule, **segmentation_document(found)}
    with together():
        if arguments.save:
            _save(arguments, scene, found)
        if arguments.picture:
            report["view"] = _draw(arguments, scene, found)
    return report


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted
    from .tables import show_table, text_of

    total = max(answer["num_registered"], 1)
    none = answer["num_registered"] - answer["num_labelled"]
    rows = [
        (one["name"], text_of(one["num_gaussians"]), f"{one['share']:.1%}", f"{one['threshold']:.3f}")
        for one in answer["classes"]
    ]
    rows.append(("none of these", text_of(none), f"{none / total:.1%}", ""))
    columns = ("class", "Gaussians", "share", f"{answer['measure']} above")
    show_table(f"{counted(answer['num_registered'], 'Gaussian')} with a feature", columns, rows)
    if answer["doubt"]:
        print(f"warning: {answer['doubt']}")


def _classes(arguments: argparse.Namespace) -> list[str]:
    """Return the names of --classes or --classes-file. Raises: InputError: none or both were given."""
    from ...errors import InputError

    if (arguments.classes is None) == (arguments.classes_file is None):
        raise InputError('give --classes "mug,bowl,table" or --classes-file FILE.txt')
    given = lines_of(arguments.classes_file, "one class") if arguments.classes is None else arguments.classes.split(",")
    return [name.strip() for name in given if name.strip()]


def _save(arguments: argparse.Namespace, scene: Scene, found: Segmentation) -> None:
    from ... import write_gaussians
    from ...drawing.legend import colored

    painted = colored(scene.gaussians, found.labels, len(found.names))
    columns = {"class_id": found.labels}
    write_gaussians(arguments.save, painted, columns, overwrite=arguments.overwrite)


def _draw(arguments: argparse.Namespace, scene: Scene, found: Segmentation) -> str:
    import numpy as np

    from ...drawing.legend import class_picture
    from ...drawing.pictures import photo_or_rendering, write_picture

    view = chosen_view(arguments, scene, np.flatnonzero(found.labels >= 0))
    photo = photo_or_rendering(scene.gaussians, view, threads=arguments.threads)
    picture = class_picture(scene.gaussians, view, photo, found.labels, list(found.names), arguments.threads)
    write_picture(arguments.picture, picture, arguments.overwrite)
    return view.name
