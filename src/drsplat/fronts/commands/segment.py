"""drsplat segment: classes in words -> what each Gaussian is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...base.terminal import counted
from ...errors import InputError
from ...query.schema import CUT
from .declaring import Facts, argument, declaration, option, part, words
from .options import Encoders, Verb, lines_of
from .query_options import FIELD_HELP, Outputs, asked, values_of
from .tables import show_table, text_of

if TYPE_CHECKING:
    from .query_options import Asked

EXAMPLES = """\
  drsplat segment room.field --classes "mug,bowl,table"
  drsplat segment room.field --classes "mug,bowl,table" --scene scene.ply --save classes.ply
  drsplat segment room.field --classes-file scannet20.txt --encoder models/clip --threshold 0 --scene scene.ply
  drsplat segment room.field --classes "mug,bowl,table" --scene scene.ply --picture classes.png --views capture

A Gaussian gets the class with the highest score if that exceeds the threshold, and otherwise none. The paper labels
every Gaussian: --threshold -1, or 0 for relevancy. With --threshold auto, each class has its own threshold.
classes.ply has a column class_id, -1 for none, and shows the colours of the classes in any viewer."""
DAILY = "classes classes_file scene encoder save picture views overwrite"


@declaration
class Options(Verb):
    """Options of this verb."""

    field: str = argument(FIELD_HELP)
    classes: str | None = option("classes, separated by commas", "A,B,C", words)
    classes_file: str | None = option("file with a class on each line, instead of --classes", "FILE.txt")
    encoders: Encoders = part(Encoders)
    cut: Asked = asked(CUT)
    outputs: Outputs = part(
        Outputs,
        save={
            "help": "write the scene in the colours of the classes, with a column class_id: the number of the class "
            "from 0, or -1"
        },
    )


def run(options: Options) -> Facts:
    import numpy as np

    from ... import write_gaussians
    from ...drawing.pictures import class_picture, colored, photo_or_rendering, write_picture
    from ...formats.replacing import together
    from ...query import Cut
    from ...query.documents import segmentation_document

    outputs = options.outputs
    outputs.check()
    # the names of --classes or --classes-file. Raises: InputError: none or both were given.
    if (options.classes is None) == (options.classes_file is None):
        raise InputError('give --classes "mug,bowl,table" or --classes-file FILE.txt')
    names = lines_of(options.classes_file, "one class") if options.classes_file else (options.classes or "").split(",")
    classes = [name.strip() for name in names if name.strip()]
    scene = outputs.open_scene(options.field, **vars(options.encoders), threads=options.threads)
    found = scene.segment(classes, Cut(**values_of(options.cut, CUT)))
    report = {"field": options.field, "threshold_rule": found.answers[0].rule, **segmentation_document(found)}
    with together():
        if outputs.save:
            painted = colored(scene.gaussians, found.labels, len(found.names))
            write_gaussians(outputs.save, painted, {"class_id": found.labels}, overwrite=outputs.overwrite)
        if outputs.picture:
            view = outputs.chosen_view(scene, np.flatnonzero(found.labels >= 0))
            photo = photo_or_rendering(scene.gaussians, view, threads=options.threads)
            names = list(found.names)
            picture = class_picture(scene.gaussians, view, photo, found.labels, names, options.threads)
            write_picture(outputs.picture, picture, outputs.overwrite)
            report["view"] = view.name
    return report


def show(answer: Facts) -> None:
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
