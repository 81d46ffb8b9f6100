"""drsplat select: words, a picture or a click -> which Gaussians."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .query_options import add_output_options, add_query_options, answer_json, ask, draw, measured_text, print_doubt

if TYPE_CHECKING:
    from ...query import Answer, Scene

EXAMPLES = """\
  drsplat select room.field "red mug"
  drsplat select room.field "red mug" --threshold auto --scene scene.ply --save mug.ply
  drsplat select room.field "red mug" --top-share 0.02 --save mug_ids.npy
  drsplat select room.field "mug, not red" --scene scene.ply --picture mug.png --views capture
  drsplat select room.field --click photo_003:210,140 --views capture --scene scene.ply --save same.ply

mug.ply is the scene with the columns relevancy and selected (0 or 1); `splat-transform mug.ply -V selected,gt,0
cut.ply` cuts the mug out. mug_ids.npy holds row numbers of the scene."""
DAILY = ("scene", "threshold", "top_share", "encoder", "save", "picture", "views", "overwrite")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_query_options(parser)
    saved = "OUT.ply: scene with two more columns, relevancy, the measured value, and selected, 0 or 1; OUT.npy: row "
    add_output_options(parser, saved + "numbers of the selected Gaussians in the scene, int64")


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...base.terminal import counted
    from ...formats.replacing import together

    scene, answer = ask(arguments, (".ply", ".npy"))
    report = answer_json(arguments, answer) | {
        "num_gaussians": answer.field.num_gaussians,
        "share": len(answer.gaussian_ids) / max(len(answer.field), 1),
        "saved": arguments.save,
    }
    with together():
        if arguments.save:
            _save(arguments, scene, answer)
        if arguments.picture:
            ids = answer.gaussian_ids
            report["view"] = draw(arguments, scene, ids, counted(len(ids), "Gaussian"))
    return report


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted
    from .tables import text_of

    selected, registered = (text_of(answer["num_selected"]), counted(answer["num_registered"], "Gaussian"))
    print_doubt(answer)
    print(f"{selected} of {registered} selected for '{answer['query']}', {answer['share']:.2%}")
    print(measured_text(answer))
    if answer["saved"]:
        print(f"written to {answer['saved']}")


def _save(arguments: argparse.Namespace, scene: Scene, answer: Answer) -> None:
    import numpy as np

    from ... import write_gaussians
    from ...formats.npy import write_npy

    ids = answer.gaussian_ids
    if arguments.save.lower().endswith(".npy"):
        write_npy(Path(arguments.save), ids, arguments.overwrite)
        return
    selected = np.zeros(answer.field.num_gaussians, np.uint8)
    selected[ids] = 1
    columns = {"relevancy": answer.dense, "selected": selected}
    write_gaussians(arguments.save, scene.gaussians, columns, overwrite=arguments.overwrite)
