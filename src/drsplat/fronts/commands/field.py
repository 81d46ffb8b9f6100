"""drsplat field: a field and a changed copy of its scene -> the field for that copy."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .changes import add_field_options, field_and_scene
from .options import add_overwrite, new_output

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=("carry",), help="action, the only one")
    add_field_options(parser)
    parser.add_argument("new_scene", metavar="NEW_SCENE", help="registered scene in another file or format")
    parser.add_argument("--output", "-o", required=True, metavar="DIR", help="folder to write the new field to")
    add_overwrite(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...formats.field_folder import claimed_field

    with claimed_field(new_output(arguments.output, arguments.overwrite)) as output:
        return _carry(arguments, output)


def _carry(arguments: argparse.Namespace, output: Path) -> dict[str, Any]:
    import numpy as np

    from ...field import assign, carry_field, load_field
    from ...field.labels import LabelFile

    path, old = field_and_scene(arguments)
    field = load_field(path)
    old, new = _still(old), _still(_scene(arguments.new_scene))
    field.check_scene(old)
    labels = [label for label in LabelFile.beside(path).read() if label.is_of(field)]
    assignment = assign(old, new, threads=arguments.threads)
    carried = carry_field(field, assignment)
    names = _carry_labels(labels, output, assignment)
    carried.save(output, overwrite=arguments.overwrite)  # last: a field that is there has its names, also after a kill
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


def show(answer: dict[str, Any]) -> None:
    from .tables import show_facts, text_of

    facts = {
        "Gaussians": f"{text_of(answer['num_registered'])} with a feature of {text_of(answer['num_gaussians'])}",
        "lost": text_of(answer["num_lost"]),
        "moved": f"{answer['median_distance']:.3g} units in the median, {answer['largest_distance']:.3g} at most, of "
        f"{answer['reach']:.3g} allowed",
        "objects": "none" if answer["num_objects"] is None else text_of(answer["num_objects"]),
        "names": ", ".join(answer["labels"]) or "none",
    }
    show_facts(f"carried over: {answer['field']}", facts)


def _scene(path: str) -> object:
    from ...formats.moving_scenes import read_scene

    return read_scene(path)


def _still(scene: Any) -> Any:
    """Refuse a scene that moves. Raises: InputError."""
    from ...errors import InputError
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
