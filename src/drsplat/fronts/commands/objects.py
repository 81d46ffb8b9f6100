"""drsplat objects: a field and its scene -> a list of its objects, with or without names."""

from __future__ import annotations

import csv
import io
import json
import shutil
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.terminal import counted
from ...errors import InputError
from .declaring import Facts, argument, declaration, flag, option, part, whole, words
from .edit_options import note_own_scene
from .options import Encoders, Photos, Verb, overwrite, parts_of
from .query_options import FIELD_HELP, check_outputs, open_with
from .tables import place_text, show_table, text_of
from .workers import Workers, tiles_of

if TYPE_CHECKING:
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
DAILY = "scene all label id save picture views overwrite"

MAX_ROWS_SHOWN = 40  # on a terminal without --all; real captures have hundreds of objects
SAVED_SUFFIXES = (".npy", ".ply", ".json", ".csv", "")
TABLE_FILE = "objects.json"
FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r", "\n")  # spreadsheets compute a text that begins with one
BOX_NUMBERS = {"center": 3, "extent": 3, "axes": 9}


@declaration
class Options(Verb):
    """Options of this verb."""

    field: str = argument(FIELD_HELP)
    scene: str | None = option("scene that was registered; needed to find objects, for PLYs and for --picture")
    again: bool = flag("find objects again, even if the field has some; labels stay")
    vote: bool = flag("find objects again, and join pieces that the photos of --views, looked at again, outline as one")
    all: bool = flag("list and draw objects on which the photos agree less, too; files always have all")
    label: str | None = option("label for the object --id", "NAME", words)
    id: int | None = option("number of the object for --label", "NUMBER", whole)
    save: str | None = option(
        "OUT.npy: object of each Gaussian, int32; OUT.ply: scene with a column object_id; OUT.json, OUT.csv: table "
        "with boxes; any other name: folder with a PLY per object", "OUT", title="output",
    )  # fmt: skip
    picture: str | None = option(
        "write a contact sheet: the 60 largest objects of the list, each cut out of the photo that shows it best",
        "OUT.jpg", title="output",
    )  # fmt: skip
    views: str | None = option("poses and photos, for --picture and --vote", "CAPTURE", title="output")
    overwrite: bool = overwrite("output")
    parts: str | None = option(
        "folder for the finished blocks of an unfinished run, or an address such as s3://bucket/run; never removed "
        "(default: FIELD.parts, removed at the end)", "DIR", title="tiles",
    )  # fmt: skip
    workers: Workers = part(Workers)
    encoders: Encoders = part(Encoders)
    photos: Photos = part(Photos)


def run(options: Options) -> Facts:
    from ...formats.replacing import together
    from ...query.documents import object_documents
    from ...query.objects import objects_of
    from ...scene.views import pictures_kind, scenes_rendered

    if (options.label is None) != (options.id is None):
        raise InputError("a name is given to an object: pass label=NAME and id=NUMBER together")
    _check(options)
    scene = _with_objects(options)
    if options.label is not None and options.id is not None:
        scene.label(objects_of(scene.field).thing(options.id), options.label)
    documents = object_documents(scene, scene.objects)
    if options.save or options.picture:
        note_own_scene(scene.path, scene.rows if scene.has_gaussians else None)
    with together():
        if options.save:
            _save(Path(options.save), scene, documents, options.overwrite)
        if options.picture:
            _draw(options.picture, options.overwrite, scene, _listed(documents, options.all))
    return {
        "field": options.field,
        "num_objects": len(documents),
        "num_agreed": len(_listed(documents, every=False)),
        "num_registered": len(scene.field),
        "num_in_objects": sum(document["num_gaussians"] for document in documents),
        "objects": documents,
        "all": options.all,
        "pictures": pictures_kind(scene.field.rendered_from),
        "rendered_from": scenes_rendered(scene.field.rendered_from),
        "doubt": scene.doubt,
        "drifting": _drifting(scene),
        "labels_of_none": [label.name for label in scene.labels.orphans],
        "saved": options.save,
        "picture": options.picture,
    }


def show(answer: Facts) -> None:
    listed = _listed(answer["objects"], answer["all"])
    inside = text_of(sum(document["num_gaussians"] for document in listed))
    registered = counted(answer["num_registered"], "registered Gaussian")
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


def _listed(objects: list[Facts], every: bool) -> list[Facts]:
    """Return the objects that photos agree on, or all."""
    return [document for document in objects if every or document["agreed"]]


def _drifting(scene: Scene) -> Facts | None:
    """Count the Gaussians of a moving scene that change their object, and between which objects most do."""
    from collections import Counter

    from ...field.objects.drifting import drifting

    if scene.field.times is None:
        return None
    drift = drifting(scene.field)
    pairs = Counter(zip(drift.first.tolist(), drift.last.tolist(), strict=True))
    most = [{"from": first, "to": last, "num_gaussians": count} for (first, last), count in pairs.most_common(5)]
    return {"num_gaussians": len(drift.gaussian_ids), "between": most, "gaussian_ids": drift.gaussian_ids}


def _drifting_text(drift: Facts) -> str:
    if not drift["num_gaussians"]:
        return "No Gaussian changes what it belongs to over time."
    between = ", ".join(f"{pair['from']} to {pair['to']}: {pair['num_gaussians']:,}" for pair in drift["between"])
    changes = counted(drift["num_gaussians"], "Gaussian changes", "Gaussians change")
    return f"{changes} what it belongs to over time, by objects (-1: none): {between}"


def _row(document: Facts) -> tuple[str, ...]:
    places = map(place_text, (document["center"], document["extent"]))
    kinds = [kind for kind in ("surface", "few photos") if document[kind.replace(" ", "_")]]
    name = ", ".join(filter(None, [document["label"] or document["name"], *kinds]))
    return (
        str(document["id"]), name, f"{document['num_gaussians']:,}", *places, str(document["num_views"]),
        f"{document['sure']:.2f}",
    )  # fmt: skip


def _with_objects(options: Options) -> Scene:
    """Open the scene of a field; find its objects and store them in the field, if it has none or --again is given.

    A scene in tiles is not loaded for it. A run that was killed goes on with the blocks, or the photos, that it had
    finished.
    """
    from ...formats.replacing import claimed_output
    from ...query.opening import scene_files

    path, tiles = scene_files(options.field).field, tiles_of(options.scene, options.workers, options.parts)
    if tiles is not None and options.vote:
        raise InputError("the photos of a scene in tiles do not vote: find its objects without --vote")
    scene = open_with(options, options.field, options.scene)
    if scene.field.objects is not None and not (options.again or options.vote):
        return scene
    parts = options.parts or str(parts_of(path))
    with claimed_output(path):
        if tiles is not None:
            from ...field.tiles import finding as in_tiles

            launcher = options.workers.launcher(options.threads)
            objects = in_tiles.find_objects(scene.field, tiles, parts=parts, launcher=launcher, **options.running)
        elif options.vote:
            from ...photos.embedding.voting import vote_for_objects, votes_beside

            kept = votes_beside(path)
            objects = vote_for_objects(scene.field, scene.gaussians, scene.views, kept=kept, **options.running)
        else:
            from ...field.objects.finding import find_objects

            objects = find_objects(scene.field, scene.gaussians, threads=options.threads)
        scene.field.with_objects(objects).save(path, overwrite=True)
    if options.parts is None and tiles is not None:
        shutil.rmtree(parts, ignore_errors=True)
    return open_with(options, options.field, options.scene)


def _draw(path: str, overwrite: bool, scene: Scene, listed: list[Facts]) -> None:
    from ...drawing.pictures import write_picture
    from ...query.sheets import object_sheet

    matches = scene.objects
    if matches and not listed:
        raise InputError(f"photos agree on none of the {len(matches)} objects well: --all draws them")
    names = [document["label"] or document["name"] for document in listed]
    sheet = object_sheet(scene, [matches[document["id"]] for document in listed], names)
    write_picture(path, sheet, overwrite)


def _check(options: Options) -> None:
    """Check what can be checked before any work is done."""
    check_outputs(options.save, options.picture, options.overwrite, ("",))
    if options.save and Path(options.save).suffix.lower() not in SAVED_SUFFIXES:
        raise InputError(f"{options.save}: expected a name that ends in .npy, .ply, .json or .csv, or that of a folder")


def _save(place: Path, scene: Scene, listed: list[Facts], overwrite: bool) -> None:
    from ... import write_gaussians
    from ...formats.field_folder import replacing_folder
    from ...formats.npy import write_npy

    match place.suffix.lower():
        case ".npy":
            write_npy(place, scene.object_ids(), overwrite)
        case ".ply":
            write_gaussians(place, scene.gaussians, {"object_id": scene.object_ids()}, overwrite=overwrite)
        case ".json":
            _save_json(place, scene, listed, overwrite)
        case ".csv":
            _save_csv(place, listed, overwrite)
        case _:  # a PLY of each object and a table of them; the folder appears whole or not at all
            with replacing_folder(place, overwrite, TABLE_FILE) as folder:
                for match in scene.objects:
                    file = folder / f"object_{match.object_id:04d}.ply"
                    write_gaussians(file, scene.gaussians.subset(match.gaussian_ids))
                _save_json(folder / TABLE_FILE, scene, listed, False)


def _save_json(path: Path, scene: Scene, listed: list[Facts], overwrite: bool) -> None:
    from ...formats.replacing import replacing

    document = {"field": scene.field.fingerprint, "scene": scene.field.scene, "objects": listed}
    with replacing(path, overwrite) as file:
        file.write((json.dumps(document, indent=1) + "\n").encode())


def _save_csv(path: Path, listed: list[Facts], overwrite: bool) -> None:
    """Write a CSV table of objects.

    Each number of a box has a column, axes row by row; views share one, with semicolons between them; the last is 0 or
    1 for `agreed`.
    """
    from ...formats.replacing import replacing

    text = io.StringIO(newline="")
    columns = ("id", "label", "name", "num_gaussians", "mass", "num_views", "sure")
    rows = csv.writer(text)
    rows.writerow(
        [*columns, *(f"{key}_{i}" for key, count in BOX_NUMBERS.items() for i in range(count)), "views", "agreed"]
    )
    for document in listed:
        numbers = [*document["center"], *document["extent"], *chain(*document["axes"])]
        views = _cell(";".join(document["views"]))
        rows.writerow([*(_cell(document[key]) for key in columns), *numbers, views, int(document["agreed"])])
    with replacing(path, overwrite) as file:
        file.write(text.getvalue().encode())


def _cell(value: Any) -> Any:
    """Return a value that no spreadsheet takes for a formula: one that looks like it gets an apostrophe before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA_SIGNS) else value
