"""drsplat field: a field and a changed copy of its scene -> the field for that copy."""

from __future__ import annotations

from ...errors import InputError
from .add import FieldToChange
from .declaring import Facts, argument, declaration, option, part
from .options import Verb, new_output, overwrite
from .tables import show_facts, text_of

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
    import numpy as np

    from ...field import assign, carry_field, carry_label, load_field
    from ...field.labels import LabelFile
    from ...formats.field_folder import claimed_field
    from ...formats.moving_scenes import read_scene
    from ...scene.gaussians import Gaussians

    with claimed_field(new_output(options.output, options.overwrite)) as output:
        path, old = options.of.read()
        field, new = load_field(path), read_scene(options.new_scene)
        if not (isinstance(old, Gaussians) and isinstance(new, Gaussians)):
            raise InputError("expected scenes that stand still, got one that moves: register it with its motion again")
        field.check_scene(old)
        labels = [label for label in LabelFile.beside(path).read() if label.is_of(field)]
        assignment = assign(old, new, threads=options.threads)
        carried = carry_field(field, assignment)
        names = [there for label in labels if (there := carry_label(label, assignment)) is not None]
        LabelFile.beside(output).carry(names)
        # last: a field that is there has its names, also after a kill
        carried.save(output, overwrite=options.overwrite)
        distances = assignment.distances[assignment.rows >= 0]
        return {
            "field": output,
            "scene": carried.scene,
            "num_gaussians": carried.num_gaussians,
            "num_registered": len(carried),
            "num_lost": len(field) - len(carried),
            "reach": assignment.reach,
            "median_distance": float(np.median(distances)) if len(distances) else 0.0,
            "largest_distance": float(distances.max(initial=0.0)),
            "num_objects": None if carried.objects is None else len(carried.objects),
            "labels": [label.name for label in names],
        }


def show(answer: Facts) -> None:
    facts = {
        "Gaussians": f"{text_of(answer['num_registered'])} with a feature of {text_of(answer['num_gaussians'])}",
        "lost": answer["num_lost"],
        "moved": f"{answer['median_distance']:.3g} units in the median, {answer['largest_distance']:.3g} at most, of "
        f"{answer['reach']:.3g} allowed",
        "objects": answer["num_objects"],
        "names": ", ".join(answer["labels"]) or "none",
    }
    show_facts(f"carried over: {answer['field']}", facts)
