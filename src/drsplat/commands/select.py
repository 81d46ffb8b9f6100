"""drsplat select: words, a picture or a click -> which Gaussians."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .answers import asked
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
    import numpy as np

    from ..asking import Asked

SUMMARY = "select the Gaussians that a query fits: by a threshold, an automatic one or a share"
EXAMPLES = """\
  drsplat select room.field "red mug"
  drsplat select room.field "red mug" --threshold auto --scene scene.ply --save mug.ply
  drsplat select room.field "red mug" --top-share 0.02 --save mug_ids.npy
  drsplat select room.field "mug, not red" --scene scene.ply --picture mug.png --views capture
  drsplat select room.field --click photo_003:210,140 --views capture --scene scene.ply --save same.ply

mug.ply is the scene with relevancy and selected (0 or 1) as columns; `splat-transform mug.ply -V selected,gt,0 cut.ply`
cuts the mug out. mug_ids.npy are row numbers of the scene."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_query_options(parser)
    saved = "OUT.ply: the scene with two more columns, relevancy, what was measured, and selected, 0 or 1; OUT.npy: the row "
    add_output_options(parser, saved + "numbers of the selected Gaussians in the scene, int64")


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from .. import load_field, read_gaussians, select
    from ..terminal import counted

    take_folder(arguments)
    check_outputs(arguments, (".ply", ".npy"))
    field = load_field(arguments.field)
    scene = None if arguments.scene is None else read_gaussians(arguments.scene)
    if scene is not None:
        field.check_scene(scene)
    answer = asked(field, ask_of(arguments, scene), arguments.threads)
    ids = select(field, answer.values, answer.threshold)
    if arguments.save:
        _save(arguments, answer, ids)
    report = {
        "field": arguments.field,
        "query": query_said(arguments),
        **numbers_of(answer, len(ids)),
        "num_gaussians": field.num_gaussians,
        "share": len(ids) / max(len(field), 1),
        "saved": arguments.save,
    }
    if arguments.picture and scene is not None:
        report["view"] = draw(arguments, scene, ids, counted(len(ids), "Gaussian"))
    return report


def show(answer: dict[str, Any]) -> None:
    from ..terminal import counted
    from .tables import said

    selected, registered = (
        said(answer["num_selected"]),
        counted(answer["num_registered"], "Gaussian"),
    )
    print(f"{selected} of {registered} selected for '{answer['query']}', {answer['share']:.2%}")
    print(measured_said(answer))
    if answer["saved"]:
        print(f"written to {answer['saved']}")


def _save(arguments: argparse.Namespace, answer: Asked, ids: np.ndarray) -> None:
    import numpy as np

    from .. import read_gaussians, write_gaussians
    from ..formats.npy import write_npy

    if arguments.save.lower().endswith(".npy"):
        write_npy(Path(arguments.save), ids, arguments.overwrite)
        return
    selected = np.zeros(answer.field.num_gaussians, np.uint8)
    selected[ids] = 1
    columns = {"relevancy": answer.dense, "selected": selected}
    scene = read_gaussians(arguments.scene)
    write_gaussians(arguments.save, scene, columns, overwrite=arguments.overwrite)
