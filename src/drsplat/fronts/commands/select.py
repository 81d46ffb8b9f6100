"""drsplat select: words, a picture or a click -> which Gaussians."""

from pathlib import Path

from ...base.terminal import counted
from .declaring import Facts, declaration, part
from .options import Verb
from .query_options import Outputs, Question, answer_json, ask, draw, measured_text, print_doubt
from .tables import text_of

EXAMPLES = """\
  drsplat select room.field "red mug"
  drsplat select room.field "red mug" --threshold auto --scene scene.ply --save mug.ply
  drsplat select room.field "red mug" --top-share 0.02 --save mug_ids.npy
  drsplat select room.field "mug, not red" --scene scene.ply --picture mug.png --views capture
  drsplat select room.field --click photo_003:210,140 --views capture --scene scene.ply --save same.ply

mug.ply is the scene with the columns relevancy and selected (0 or 1); `splat-transform mug.ply -V selected,gt,0
cut.ply` cuts the mug out. mug_ids.npy holds row numbers of the scene."""
DAILY = "scene threshold top_share encoder save picture views overwrite"


@declaration
class Options(Verb):
    """Options of this verb."""

    question: Question = part(Question)
    outputs: Outputs = part(
        Outputs,
        save={
            "help": "OUT.ply: scene with two more columns, relevancy, the measured value, and selected, 0 or 1; "
            "OUT.npy: row numbers of the selected Gaussians in the scene, int64"
        },
    )


def run(options: Options) -> Facts:
    import numpy as np

    from ... import write_gaussians
    from ...formats.npy import write_npy
    from ...formats.replacing import together

    outputs = options.outputs
    scene, answer = ask(options.question, outputs, options.threads, (".ply", ".npy"))
    report = answer_json(options.question, answer) | {
        "num_gaussians": answer.field.num_gaussians,
        "share": len(answer.gaussian_ids) / max(len(answer.field), 1),
        "saved": outputs.save,
    }
    with together():
        ids = answer.gaussian_ids
        if outputs.save and outputs.save.lower().endswith(".npy"):
            write_npy(Path(outputs.save), ids, outputs.overwrite)
        elif outputs.save:
            selected = np.zeros(answer.field.num_gaussians, np.uint8)
            selected[ids] = 1
            columns = {"relevancy": answer.dense, "selected": selected}
            write_gaussians(outputs.save, scene.gaussians, columns, overwrite=outputs.overwrite)
        if outputs.picture:
            report["view"] = draw(options.question, outputs, scene, ids, counted(len(ids), "Gaussian"))
    return report


def show(answer: Facts) -> None:
    selected, registered = (text_of(answer["num_selected"]), counted(answer["num_registered"], "registered Gaussian"))
    print_doubt(answer)
    print(f"{selected} of {registered} selected for '{answer['query']}', {answer['share']:.2%}")
    print(measured_text(answer))
    if answer["saved"]:
        print(f"written to {answer['saved']}")
