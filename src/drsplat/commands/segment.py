"""drsplat segment: classes in words -> what each Gaussian is."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .answers import Ask, AskedOf
from .leaving_out import lines_of
from .options import add_query_encoders, words
from .query_options import (
    FIELD_HELP,
    add_measure_options,
    add_output_options,
    check_outputs,
    chosen_view,
    take_folder,
)

if TYPE_CHECKING:
    import numpy as np

    from ..asking import Asked
    from ..gaussians import Gaussians

SUMMARY = "label every Gaussian with the best of some classes, or with none of them"
EXAMPLES = """\
  drsplat segment room.field --classes "mug,bowl,table"
  drsplat segment room.field --classes "mug,bowl,table" --scene scene.ply --save classes.ply
  drsplat segment room.field --classes-file scannet20.txt --encoder models/clip --threshold 0 --scene scene.ply
  drsplat segment room.field --classes "mug,bowl,table" --scene scene.ply --picture classes.png --views capture

A Gaussian is of the class of the highest score, if that is above the threshold, and otherwise none of these.
The paper labels everything: --threshold -1, or 0 for relevancy. With --threshold auto each class has a threshold of its
own. classes.ply has a column class_id, -1 for none, and the colours of the classes in any viewer."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("field", help=FIELD_HELP)
    parser.add_argument(
        "--classes", type=words, metavar="A,B,C", help="the classes, separated by commas"
    )
    parser.add_argument(
        "--classes-file", metavar="FILE.txt", help="the classes, one on each line, instead"
    )
    add_query_encoders(parser)
    add_measure_options(parser)
    saved = "write the scene in the colours of the classes, with a column class_id: the number of the class from 0, or -1"
    add_output_options(parser, saved)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import load_field, read_gaussians
    from ..tasks import segment

    take_folder(arguments)
    check_outputs(arguments)
    classes = _classes(arguments)
    asking = AskedOf(load_field(arguments.field), _ask(arguments), arguments.threads)
    scene = None if arguments.scene is None else read_gaussians(arguments.scene)
    if scene is not None:
        asking.field.check_scene(scene)
    answers = list(asking.about_each(classes))
    thresholds = [answer.threshold for answer in answers]
    labels = segment(asking.field, (answer.values for answer in answers), thresholds)
    report = {
        "field": arguments.field,
        "measure": answers[0].measure,
        "threshold_rule": answers[0].rule,
        "num_registered": len(asking.field),
        "num_labelled": int((labels >= 0).sum()),
        "classes": _counts(classes, answers, labels),
    }
    if arguments.save and scene is not None:
        _save(arguments, scene, labels, len(classes))
    if arguments.picture and scene is not None:
        report["view"] = _draw(arguments, scene, labels, classes)
    return report


def show(answer: dict[str, Any]) -> None:
    from ..terminal import counted
    from .tables import said, show_table

    total = max(answer["num_registered"], 1)
    none = answer["num_registered"] - answer["num_labelled"]
    rows = [
        (one["name"], said(one["num_gaussians"]), f"{one['share']:.1%}", f"{one['threshold']:.3f}")
        for one in answer["classes"]
    ]
    rows.append(("none of these", said(none), f"{none / total:.1%}", ""))
    columns = ("class", "Gaussians", "share", f"{answer['measure']} above")
    show_table(f"{counted(answer['num_registered'], 'Gaussian')} with a feature", columns, rows)


def _classes(arguments: argparse.Namespace) -> list[str]:
    """Raises: InputError: not one list, an empty one, or a class twice."""
    from ..errors import InputError

    if (arguments.classes is None) == (arguments.classes_file is None):
        raise InputError('give --classes "mug,bowl,table" or --classes-file FILE.txt')
    if arguments.classes is None:
        given = lines_of(arguments.classes_file, "one class")
    else:
        given = arguments.classes.split(",")
    names = [name.strip() for name in given if name.strip()]
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"expected one or more different classes, got {', '.join(names) or 'none'}"
        )
    return names


def _ask(arguments: argparse.Namespace) -> Ask:
    names = ("vocabulary", "encoder", "device", "relevancy", "negatives", "threshold", "top_share")
    return Ask(**{name: getattr(arguments, name) for name in names})


def _counts(classes: list[str], answers: list[Asked], labels: np.ndarray) -> list[dict[str, Any]]:
    import numpy as np

    counts = np.bincount(labels[labels >= 0], minlength=len(classes))
    return [
        {
            "name": name,
            "num_gaussians": int(count),
            "share": count / max(len(answer.field), 1),
            "threshold": answer.threshold,
        }
        for name, answer, count in zip(classes, answers, counts, strict=True)
    ]


def _save(arguments: argparse.Namespace, scene: Gaussians, labels: np.ndarray, count: int) -> None:
    from .. import write_gaussians
    from .legend import colored

    columns = {"class_id": labels}
    write_gaussians(
        arguments.save, colored(scene, labels, count), columns, overwrite=arguments.overwrite
    )


def _draw(
    arguments: argparse.Namespace, scene: Gaussians, labels: np.ndarray, classes: list[str]
) -> str:
    import numpy as np

    from ..pictures import photo_or_rendering, write_picture
    from .legend import class_picture

    view = chosen_view(arguments, scene, np.flatnonzero(labels >= 0))
    photo = photo_or_rendering(scene, view, threads=arguments.threads)
    picture = class_picture(scene, view, photo, labels, classes, arguments.threads)
    write_picture(arguments.picture, picture, arguments.overwrite)
    return view.name
