"""Common parts of `drsplat add` and `drsplat remove`: the field to change, and the answer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import InputError
from .declaring import Facts, argument, declaration, option
from .query_options import FIELD_HELP

if TYPE_CHECKING:
    from ...field.growing import Change
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving


@declaration
class FieldToChange:
    """The field of a scene that registered it."""

    field: str = argument(FIELD_HELP)
    scene: str | None = option("scene that was registered (default: the one beside the field in its folder)")


def field_and_scene(given: FieldToChange) -> tuple[Path, Gaussians | Moving]:
    """Return the field's folder and its Gaussians.

    Raises: InputError: no such field, or no scene is given or beside it; as `read_scene`.
    """
    from ...formats.moving_scenes import read_scene
    from ...query.opening import registered_scene, scene_files

    files = scene_files(given.field, given.scene)
    if not files.scenes:
        raise InputError("scene: expected the Gaussians that were registered: pass scene=SCENE")
    if given.scene is not None:
        return files.field, read_scene(files.scenes[0])
    return files.field, registered_scene(files)[1]


def answer_of(change: Change, path: Path) -> Facts:
    """Return what has changed, and the new totals."""
    from ...base.system import folder_bytes, peak_memory_bytes
    from ...field.labels import LabelFile, matched

    field = change.field
    evidence = field.evidence
    assert evidence is not None
    orphans = matched(LabelFile.beside(path).read(), field).orphans if field.objects is not None else ()
    return {
        "field": str(path),
        "added": list(change.added),
        "replaced": list(change.replaced),
        "removed": list(change.removed),
        "left_out": list(change.left_out),
        "num_views_unchanged": len(change.unchanged),
        "num_views": len(evidence.masks.view_names),
        "num_masks": len(evidence.masks),
        "num_weights": int(evidence.weights.nnz),
        "num_gaussians": field.num_gaussians,
        "num_registered": len(field),
        "num_touched": change.num_touched,
        "num_coded": change.num_coded,
        "num_objects": None if field.objects is None else len(field.objects),
        "labels_of_none": [label.name for label in orphans],
        "seconds": sum(change.seconds.values()),
        "stage_seconds": dict(change.seconds),
        "field_bytes": folder_bytes(path),
        "peak_memory_bytes": peak_memory_bytes(),
    }


def show_change(answer: Facts, title: str) -> None:
    from .tables import show_facts, size_text, text_of

    stages = ", ".join(f"{name} {seconds:.1f}" for name, seconds in answer["stage_seconds"].items())
    facts = {name: _listed(answer[name]) for name in ("added", "replaced", "removed", "left_out") if answer[name]}
    if facts.keys() - {"left_out"}:
        facts["Gaussians seen by them"] = (
            f"{text_of(answer['num_touched'])}; {text_of(answer['num_coded'])} coded again"
        )
    facts |= {
        "views": answer["num_views"],
        "masks": answer["num_masks"],
        "Gaussians": f"{text_of(answer['num_registered'])} of {text_of(answer['num_gaussians'])}",
        "field": size_text(answer["field_bytes"]),
        "time": f"{answer['seconds']:.1f} s ({stages})",
    }
    if answer["num_objects"] is not None:
        facts["objects"] = f"{text_of(answer['num_objects'])}, found again" if answer["num_touched"] else "as before"
    show_facts(title, facts)
    for name in answer["labels_of_none"]:
        print(f"the label '{name}' names nothing in this field; it is kept")


def _listed(names: list[str]) -> str:
    from ...base.terminal import counted
    from ...formats.photo_files import listed

    return f"{counted(len(names), 'view')}: {listed(names)}"
