"""drsplat catalogue: the objects of many scenes in one table, asked in words."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...query.schema import Place, fields
from .catalogue_inputs import area, box, moment
from .edit_options import note_own_scenes
from .options import add_overwrite, add_query_encoders, new_output, tracker, up_to, words
from .query_options import add_fields, values_of

if TYPE_CHECKING:
    from ...query import Query
    from ...query.catalogue import Catalogue

EXAMPLES = """\
  drsplat catalogue add flats.catalogue flats/*
  drsplat catalogue ask flats.catalogue "red mug" --picture mugs.jpg
  drsplat catalogue ask flats.catalogue "red mug" --scene kitchen --since 2026-11-01
  drsplat catalogue list flats.catalogue
  drsplat catalogue remove flats.catalogue kitchen
  drsplat catalogue index flats.catalogue

A scene is a folder as for `drsplat serve`, with objects (`drsplat objects` finds them), or a field alone; adding it
again replaces its entries. Needs LanceDB: pip install "drsplat[catalogue]". `index` makes searches over more than
100,000 objects fast."""
DAILY = ("name", "top", "exclude", "scene", "picture", "encoder")
QUERY_FIELDS = fields(Place.COMMAND_LINE, Place.CATALOGUE)
ACTIONS = ("add", "remove", "list", "ask", "index")
MAX_MATCHES = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=ACTIONS, help="action")
    parser.add_argument("catalogue", metavar="CATALOGUE", help="folder of the catalogue; `add` makes it")
    parser.add_argument(
        "given", nargs="*", type=words, metavar="SCENE|NAME|TEXT",
        help="folders of scenes to add; names of scenes to remove; query in words",
    )  # fmt: skip
    adding = parser.add_argument_group("add")
    adding.add_argument("--name", type=words, help="name of the scene in the catalogue (default: that of its folder)")
    adding.add_argument("--views", metavar="CAPTURE", help="posed photos for the thumbnails, if they are elsewhere")
    asking = parser.add_argument_group("ask")
    asking.add_argument(
        "--top", type=up_to(MAX_MATCHES), default=10, metavar="N", help="objects to list, best first (default: 10)"
    )
    add_fields(asking, QUERY_FIELDS[1:])
    asking.add_argument(
        "--scene", type=words, action="append", default=[], metavar="NAME", help="scene to search; may be repeated"
    )
    asking.add_argument(
        "--box", type=words, metavar="X,Y,Z,X,Y,Z",
        help="lowest and highest corner of a box, in scene coordinates, that contains the centres",
    )  # fmt: skip
    asking.add_argument(
        "--area",
        type=words,
        metavar="W,S,E,N",
        help="bounds in degrees that contain the centres, for scenes with a georeference",
    )
    asking.add_argument(
        "--since", type=words, metavar="TIME", help="time of the earliest addition, such as 2026-11-22T14:00"
    )
    asking.add_argument(
        "--picture", metavar="OUT.jpg", help="write a contact sheet of the objects, cut out of their photos"
    )
    add_overwrite(asking)
    add_query_encoders(parser)


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...query.catalogue import Catalogue

    _check(arguments)
    given = {name: getattr(arguments, name) for name in ("encoder", "vocabulary", "device", "threads")}
    opened = Catalogue.open(arguments.catalogue, **given)
    return {"catalogue": arguments.catalogue, "action": arguments.action} | _RUNS[arguments.action](arguments, opened)


def show(answer: dict[str, Any]) -> None:
    from .catalogue_outputs import SHOWN

    SHOWN[answer["action"]](answer)


def _check(arguments: argparse.Namespace) -> None:
    """Check all that can be known to be wrong before any work is done."""
    from ...errors import InputError

    wanted = {"add": "folders of scenes", "remove": "names of scenes"}.get(arguments.action)
    if wanted and not arguments.given:
        raise InputError(f"catalogue {arguments.action}: expected {wanted}")
    if arguments.action in ("list", "index") and arguments.given:
        raise InputError(f"catalogue {arguments.action} takes no more than the catalogue")
    if arguments.action == "add" and arguments.name and len(arguments.given) > 1:
        raise InputError("one name is for one scene: add them one by one, or leave name=NAME out")
    if arguments.picture and not arguments.picture.lower().endswith((".jpg", ".jpeg", ".png")):
        raise InputError(f"{arguments.picture}: pictures are written as .png or .jpg")
    if arguments.picture and not new_output(arguments.picture, arguments.overwrite).parent.is_dir():
        raise InputError(f"--picture: there is no folder for {arguments.picture}: make it first")


def _add(arguments: argparse.Namespace, catalogue: Catalogue) -> dict[str, Any]:
    from ...query.opening import scene_files

    note_own_scenes(map(Path, arguments.given))
    listed = [
        catalogue.add(scene_files(path, views=arguments.views), name=arguments.name, track=tracker(arguments))
        for path in arguments.given
    ]
    return {
        "scenes": [_scene_json(one) for one in listed],
        "num_objects": len(catalogue),
        "wants_index": catalogue.wants_index,
    }


def _remove(arguments: argparse.Namespace, catalogue: Catalogue) -> dict[str, Any]:
    removed = {name: catalogue.remove(name) for name in arguments.given}
    return {"removed": removed, "num_objects": len(catalogue)}


def _list(_: argparse.Namespace, catalogue: Catalogue) -> dict[str, Any]:
    from ...scene.encoders import identity_text

    scenes = catalogue.scenes()
    return {
        "encoder": identity_text(catalogue.encoder),
        "num_objects": sum(one.num_objects for one in scenes),
        "scenes": [_scene_json(one) for one in scenes],
    }


def _index(_: argparse.Namespace, catalogue: Catalogue) -> dict[str, Any]:
    return {"num_objects": catalogue.build_index()}


def _ask(arguments: argparse.Namespace, catalogue: Catalogue) -> dict[str, Any]:
    from ...base.terminal import counted
    from ...drawing.pictures import write_picture
    from ...query.catalogue import Conditions
    from ...query.catalogue.sheets import entry_sheet

    asked = " ".join(arguments.given) or arguments.image or arguments.vector
    where = Conditions(tuple(arguments.scene), box(arguments.box), area(arguments.area), moment(arguments.since))
    answer = catalogue.answer(_query(arguments), where, top=arguments.top)
    drawn = arguments.picture if answer.entries else None
    if drawn:
        heading = f"{counted(len(answer.entries), 'match', 'matches')} for “{asked}”"
        write_picture(drawn, entry_sheet(answer.entries, heading), arguments.overwrite)
    return {"query": asked, **answer.json(), "matches": [entry.json() for entry in answer.entries], "picture": drawn}


def _query(arguments: argparse.Namespace) -> Query:
    from ...query import Query

    return Query(" ".join(arguments.given) or None, **values_of(arguments, QUERY_FIELDS))


def _scene_json(one: Any) -> dict[str, Any]:
    return {**vars(one), "added": one.added.isoformat()}


_RUNS: Mapping[str, Callable[[argparse.Namespace, Catalogue], dict[str, Any]]] = {
    "add": _add, "remove": _remove, "list": _list, "ask": _ask, "index": _index,
}  # fmt: skip
