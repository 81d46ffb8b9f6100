"""drsplat field: a field and a changed copy of its scene -> the field for that copy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...errors import InputError
from .add import FieldToChange, field_and_scene
from .declaring import Facts, argument, declaration, option, part
from .options import Verb, new_output, overwrite

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ...field import Assignment
    from ...field.labels import Label

EXAMPLES = """\
  drsplat field carry room.field room.spz --scene scene.ply --output room_spz.field
  drsplat locate room_spz.field "red mug" --scene room.spz

Compression to SOG, SPZ and the like moves Gaussians slightly and reorders them, and a field works only with its own
scene. `field carry` matches each Gaussian by position, opacity and colour, and transfers features, evidence,
objects and labels. It fails if more than one in a hundred Gaussians has no match."""


@declaration
class Options(Verb):
    """Options of this verb."""

    action: str = argument("action, the only one", choices=("carry",))
    of: FieldToChange = part(FieldToChange)
    new_scene: str = argument("registered scene in another file or format", value="NEW_SCENE")
    output: str = option("folder to write the new field to", "DIR", flags="-o", required=True)
    overwrite: bool = overwrite()


def run(options: Options) -> Facts:
    from ...formats.field_folder import claimed_field

    with claimed_field(new_output(options.output, options.overwrite)) as output:
        return _carry(options, output)


def _carry(options: Options, output: Path) -> Facts:
    import numpy as np

    from ...field import assign, carry_field, load_field
    from ...field.labels import LabelFile
    from ...formats.moving_scenes import read_scene

    path, old = field_and_scene(options.of)
    field = load_field(path)
    old, new = _still(old), _still(read_scene(options.new_scene))
    field.check_scene(old)
    labels = [label for label in LabelFile.beside(path).read() if label.is_of(field)]
    assignment = assign(old, new, threads=options.threads)
    carried = carry_field(field, assignment)
    names = _carry_labels(labels, output, assignment)
    carried.save(output, overwrite=options.overwrite)  # last: a field that is there has its names, also after a kill
    distances = assignment.distances[assignment.rows >= 0]
    return {
        "field": str(output),
        "scene": carried.scene,
        "num_gaussians": carried.num_gaussians,
        "num_registered": len(carried),
        "num_lost": len(field) - len(carried),
        "reach": assignment.reach,
        "median_distance": float(np.median(distances)) if len(distances) else 0.0,
        "largest_distance": float(distances.max(initial=0.0)),
        "num_objects": None if carried.objects is None else len(carried.objects),
        "labels": names,
    }


def show(answer: Facts) -> None:
    from .tables import show_facts, text_of

    facts = {
        "Gaussians": f"{text_of(answer['num_registered'])} with a feature of {text_of(answer['num_gaussians'])}",
        "lost": answer["num_lost"],
        "moved": f"{answer['median_distance']:.3g} units in the median, {answer['largest_distance']:.3g} at most, of "
        f"{answer['reach']:.3g} allowed",
        "objects": answer["num_objects"],
        "names": ", ".join(answer["labels"]) or "none",
    }
    show_facts(f"carried over: {answer['field']}", facts)


def _still(scene: Any) -> Any:
    """Refuse a scene that moves. Raises: InputError."""
    from ...scene.gaussians import Gaussians

    if not isinstance(scene, Gaussians):
        raise InputError("expected scenes that stand still, got one that moves: register it with its motion again")
    return scene


def _carry_labels(labels: Sequence[Label], output: Path, assignment: Assignment) -> list[str]:
    """Write the names beside the new field that people gave to objects of the old one, and return them."""
    from ...field import carry_label
    from ...field.labels import LabelFile

    carried = [new for label in labels if (new := carry_label(label, assignment)) is not None]
    LabelFile.beside(output).carry(carried)
    return [label.name for label in carried]
