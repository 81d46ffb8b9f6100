"""drsplat objects: a field and its scene -> a list of its objects, with or without names."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .edit_options import note_own_scene
from .object_outputs import check, save
from .options import add_capture_options, add_overwrite, add_query_encoders, tracker, whole, words
from .parts import parts_of
from .query_options import FIELD_HELP, open_scene
from .workers import add_workers, launcher_of, tiles_of

if TYPE_CHECKING:
    from pathlib import Path

    from ...field.forest import Objects
    from ...formats.tiles import Tiles
    from ...query import Scene

EXAMPLES = """\
  drsplat objects room.field --scene scene.ply
  drsplat objects room.field --scene scene.ply --all
  drsplat objects room.field --scene scene.ply --picture objects.jpg --views capture
  drsplat objects room.field --scene scene.ply --vote --views capture
  drsplat objects room.field --scene scene.ply --save ids.npy
  drsplat objects room.field --scene scene.ply --save cut_out
  drsplat objects room.field --label "my mug" --id 7

The list has the objects on which the photos agree, and those with a label; --all adds the others, mostly fragments.

The first run finds the objects, which takes the scene, and stores them in the field. ids.npy has an int32 for each
Gaussian of the scene: its object, or -1. objects.ply is the scene with these numbers as a column object_id; a folder
gets a PLY of each object; .json and .csv get the table, with boxes. Names given with --label are stored in
NAME.labels.json beside NAME.field: they outlive the field, and a query for such a name selects exactly this object."""
DAILY = ("scene", "all", "label", "id", "save", "picture", "views", "overwrite")

MAX_ROWS_SHOWN = 40  # on a terminal without --all; real captures have hundreds of objects


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("field", help=FIELD_HELP)
    parser.add_argument("--scene", help="scene that was registered; needed to find objects, for PLYs and for --picture")
    parser.add_argument(
        "--again", action="store_true", help="find objects again, even if the field has some; labels stay"
    )
    parser.add_argument(
        "--vote", action="store_true",
        help="find objects again, and join pieces that the photos of --views, looked at again, outline as one",
    )  # fmt: skip
    parser.add_argument(
        "--all",
        action="store_true",
        help="list and draw objects on which the photos agree less, too; files always have all",
    )
    parser.add_argument("--label", type=words, metavar="NAME", help="label for the object --id")
    parser.add_argument("--id", type=whole, metavar="NUMBER", help="number of the object for --label")
    output = parser.add_argument_group("output")
    output.add_argument(
        "--save", metavar="OUT",
        help="OUT.npy: object of each Gaussian, int32; OUT.ply: scene with a column object_id; OUT.json, OUT.csv: "
        "table with boxes; any other name: folder with a PLY per object",
    )  # fmt: skip
    output.add_argument(
        "--picture", metavar="OUT.jpg",
        help="write a contact sheet: the 60 largest objects of the list, each cut out of the photo that shows it best",
    )  # fmt: skip
    output.add_argument("--views", metavar="CAPTURE", help="poses and photos, for --picture and --vote")
    add_overwrite(output)
    tiles = parser.add_argument_group("tiles")
    tiles.add_argument(
        "--parts", metavar="DIR",
        help="folder for the finished blocks of an unfinished run, or an address such as s3://bucket/run; never "
        "removed (default: FIELD.parts, removed at the end)",
    )  # fmt: skip
    add_workers(tiles)
    add_query_encoders(parser)
    add_capture_options(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...formats.replacing import together
    from ...query.documents import object_documents
    from ...query.objects import objects_of
    from ...scene.views import pictures_kind, scenes_rendered

    check(arguments)
    scene = _with_objects(arguments)
    if arguments.label is not None:
        scene.label(objects_of(scene.field).thing(arguments.id), arguments.label)
    documents = object_documents(scene, scene.objects)
    if arguments.save or arguments.picture:
        note_own_scene(scene.path, scene.rows if scene.has_gaussians else None)
    with together():
        if arguments.save:
            save(arguments.save, scene, documents, arguments.overwrite)
        if arguments.picture:
            _draw(arguments, scene, _listed(documents, arguments.all))
    return {
        "field": arguments.field,
        "num_objects": len(documents),
        "num_agreed": sum(document["agreed"] for document in documents),
        "num_registered": len(scene.field),
        "num_in_objects": sum(document["num_gaussians"] for document in documents),
        "objects": documents,
        "all": arguments.all,
        "pictures": pictures_kind(scene.field.rendered_from),
        "rendered_from": scenes_rendered(scene.field.rendered_from),
        "doubt": scene.doubt,
        "drifting": _drifting(scene),
        "labels_of_none": [label.name for label in scene.labels.orphans],
        "saved": arguments.save,
        "picture": arguments.picture,
    }


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted
    from .tables import show_table, text_of

    listed = _listed(answer["objects"], answer["all"])
    inside = text_of(sum(document["num_gaussians"] for document in listed))
    registered = counted(answer["num_registered"], "Gaussian")
    unsure = answer["num_objects"] - len(listed)
    pictures = answer["pictures"]
    photos_agree = f" that {pictures} agree on" if unsure else ""
    title = f"{counted(len(listed), 'object')}{photos_agree}, {inside} of {registered} in them; lengths in scene units"
    columns = ("object", "name", "Gaussians", "centre", "extent", pictures, "sure")
    largest = listed if answer["all"] else listed[:MAX_ROWS_SHOWN]
    show_table(title, columns, [_row(document) for document in largest])
    if len(listed) > len(largest):
        print(f"and {len(listed) - len(largest):,} with less mass: --json, or --save OUT.csv, has all")
    if unsure:
        print(f"and {unsure:,} more that {pictures} agree less on: --all lists them")
    if not answer["objects"]:
        print(f"No two masks of different {pictures} agree: more {pictures}, or larger masks, may help.")
    if answer["doubt"]:
        print(f"warning: {answer['doubt']}")
    if answer["drifting"]:
        print(_drifting_text(answer["drifting"]))
    for name in answer["labels_of_none"]:
        print(f"the label '{name}' names nothing in this field; it is kept")
    for output in (answer["saved"], answer["picture"]):
        if output:
            print(f"written to {output}")


def _listed(objects: list[dict[str, Any]], every: bool) -> list[dict[str, Any]]:
    """Return the objects that photos agree on, or all."""
    return [document for document in objects if every or document["agreed"]]


def _drifting(scene: Scene) -> dict[str, Any] | None:
    """Count the Gaussians of a moving scene that change their object, and between which objects most do."""
    from collections import Counter

    from ...field.objects.drifting import drifting

    if scene.field.times is None:
        return None
    drift = drifting(scene.field)
    pairs = Counter(zip(drift.first.tolist(), drift.last.tolist(), strict=True))
    most = [{"from": first, "to": last, "num_gaussians": count} for (first, last), count in pairs.most_common(5)]
    return {"num_gaussians": len(drift.gaussian_ids), "between": most, "gaussian_ids": drift.gaussian_ids}


def _drifting_text(drift: dict[str, Any]) -> str:
    from ...base.terminal import counted

    if not drift["num_gaussians"]:
        return "No Gaussian changes what it belongs to over time."
    between = ", ".join(f"{pair['from']} to {pair['to']}: {pair['num_gaussians']:,}" for pair in drift["between"])
    changes = counted(drift["num_gaussians"], "Gaussian changes", "Gaussians change")
    return f"{changes} what it belongs to over time, by objects (-1: none): {between}"


def _row(document: dict[str, Any]) -> tuple[str, ...]:
    places = (" ".join(f"{x:.2f}" for x in document[key]) for key in ("center", "extent"))
    name, count = document["label"] or document["name"] or "", f"{document['num_gaussians']:,}"
    return str(document["id"]), name, count, *places, str(document["num_views"]), f"{document['sure']:.2f}"


def _with_objects(arguments: argparse.Namespace) -> Scene:
    """Open the scene of a field; find its objects and store them in the field, if it has none or --again is given."""
    from ...formats.claiming import claimed_output
    from ...query.opening import scene_files

    path, tiles = scene_files(arguments.field).field, tiles_of(arguments)
    if tiles is not None and arguments.vote:
        from ...errors import InputError

        raise InputError("the photos of a scene in tiles do not vote: find its objects without --vote")
    if tiles is not None:
        _find_in_tiles(arguments, path, tiles)
        return open_scene(arguments)
    scene = open_scene(arguments)
    if scene.field.objects is not None and not (arguments.again or arguments.vote):
        return scene
    gaussians = scene.gaussians
    from ...field.objects.finding import find_objects

    with claimed_output(path):
        if arguments.vote:
            objects = _voted_for(arguments, scene, path)
        else:
            objects = find_objects(scene.field, gaussians, threads=arguments.threads)
        scene.field.with_objects(objects).save(path, overwrite=True)
    return open_scene(arguments)


def _voted_for(arguments: argparse.Namespace, scene: Scene, path: Path) -> Objects:
    """Find the objects with the votes of the photos; a run that was killed goes on with those it had looked at."""
    import shutil

    from ...photos.embedding.voting import vote_for_objects

    parts = arguments.parts or parts_of(path)
    objects = vote_for_objects(
        scene.field, scene.gaussians, scene.views, parts=parts, threads=arguments.threads, track=tracker(arguments)
    )
    if arguments.parts is None:
        shutil.rmtree(parts, ignore_errors=True)
    return objects


def _find_in_tiles(arguments: argparse.Namespace, path: Path, tiles: Tiles) -> None:
    """Find the objects of a scene in tiles, which is not loaded for it, where the field has none."""
    import shutil

    from ... import load_field
    from ...field.tiles.finding import find_objects
    from ...formats.claiming import claimed_output

    field, parts = load_field(path), str(arguments.parts or parts_of(path))
    if field.objects is not None and not arguments.again:
        return
    with claimed_output(path):
        objects = find_objects(
            field,
            tiles,
            parts=parts,
            launcher=launcher_of(arguments),
            threads=arguments.threads,
            track=tracker(arguments),
        )
        field.with_objects(objects).save(path, overwrite=True)
    if arguments.parts is None:
        shutil.rmtree(parts, ignore_errors=True)


def _draw(arguments: argparse.Namespace, scene: Scene, listed: list[dict[str, Any]]) -> None:
    from ...drawing.pictures import write_picture
    from ...errors import InputError
    from ...query.sheets import object_sheet

    if scene.objects and not listed:
        raise InputError(f"photos agree on none of the {len(scene.objects)} objects well: --all draws them")
    matches = scene.objects
    names = [document["label"] or document["name"] for document in listed]
    sheet = object_sheet(scene, [matches[document["id"]] for document in listed], names)
    write_picture(arguments.picture, sheet, arguments.overwrite)
