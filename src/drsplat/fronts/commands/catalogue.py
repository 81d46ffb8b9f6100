"""drsplat catalogue: the objects of many scenes in one folder, asked in words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.terminal import counted
from ...errors import InputError
from ...query.schema import Place, fields
from .declaring import Facts, argument, declaration, option, part, up_to, words
from .edit_options import note_own_scenes
from .options import Encoders, Verb, overwrite
from .query_options import asked, check_outputs, numbers, query_of
from .tables import place_text, show_table, text_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime

    from ...query.catalogue import Catalogue
    from .query_options import Asked

EXAMPLES = """\
  drsplat catalogue add flats.catalogue flats/*
  drsplat catalogue ask flats.catalogue "red mug" --picture mugs.jpg
  drsplat catalogue ask flats.catalogue "red mug" --scene kitchen --since 2026-11-01
  drsplat catalogue list flats.catalogue
  drsplat catalogue remove flats.catalogue kitchen
  drsplat catalogue index flats.catalogue

A scene is a folder as for `drsplat serve`, with objects (`drsplat objects` finds them), or a field alone; adding it
again replaces its entries. `index` makes searches over more than 100,000 objects fast."""
DAILY = "name top exclude scene picture encoder"
ACTIONS = ("add", "remove", "list", "ask", "index")
MAX_MATCHES = 1000
LISTED = ("scene", "num_objects", "num_agreed", "added")
STATES = {
    "current": "", "changed": "its field is another now: add it again", "missing": "nothing is there any more",
    "unknown": "not from a folder",
}  # fmt: skip


@declaration
class Options(Verb):
    """Options of this verb."""

    action: str = argument("action", choices=ACTIONS)
    catalogue: str = argument("folder of the catalogue; `add` makes it", None, "CATALOGUE")
    given: list[str] = argument(
        "folders of scenes to add; names of scenes to remove; query in words", words, "SCENE|NAME|TEXT", nargs="*"
    )
    name: str | None = option(
        "name of the scene in the catalogue (default: that of its folder)", None, words, title="add"
    )
    views: str | None = option("posed photos for the thumbnails, if they are elsewhere", "CAPTURE", title="add")
    top: int = option("objects to list, best first (default: 10)", "N", up_to(MAX_MATCHES), 10, title="ask")
    others: Asked = asked(fields(Place.COMMAND_LINE, Place.CATALOGUE)[1:], "ask")
    scene: list[str] = option("scene to search; may be repeated", "NAME", words, [], action="append", title="ask")
    box: str | None = option(
        "lowest and highest corner of a box, in scene coordinates, that contains the centres", "X,Y,Z,X,Y,Z", words,
        title="ask",
    )  # fmt: skip
    area: str | None = option(
        "bounds in degrees that contain the centres, for scenes with a georeference", "W,S,E,N", words, title="ask"
    )
    since: str | None = option("time of the earliest addition, such as 2026-11-22T14:00", "TIME", words, title="ask")
    picture: str | None = option(
        "write a contact sheet of the objects, cut out of their photos", "OUT.jpg", title="ask"
    )
    overwrite: bool = overwrite("ask")
    encoders: Encoders = part(Encoders)


def run(options: Options) -> Facts:
    from ...query.catalogue import Catalogue
    from ...scene.encoders import identity_text

    _check(options)
    catalogue = Catalogue.open(options.catalogue, **vars(options.encoders), threads=options.threads)
    match options.action:
        case "add":
            done = _add(options, catalogue)
        case "remove":
            removed = {name: catalogue.remove(name) for name in options.given}
            done = {"removed": removed, "num_objects": len(catalogue)}
        case "list":
            scenes = catalogue.scenes()
            done = {
                "encoder": identity_text(catalogue.encoder),
                "num_objects": sum(one.num_objects for one in scenes),
                "scenes": _scenes_json(scenes),
            }
        case "ask":
            done = _ask(options, catalogue)
        case _:
            done = {"num_objects": catalogue.build_index()}
    return {"catalogue": options.catalogue, "action": options.action, **done}


def _check(options: Options) -> None:
    """Check all that can be known to be wrong before any work is done."""
    wanted = {"add": "folders of scenes", "remove": "names of scenes"}.get(options.action)
    if wanted and not options.given:
        raise InputError(f"catalogue {options.action}: expected {wanted}")
    if options.action in ("list", "index") and options.given:
        raise InputError(f"catalogue {options.action} takes no more than the catalogue")
    if options.action == "add" and options.name and len(options.given) > 1:
        raise InputError("one name is for one scene: add them one by one, or leave name=NAME out")
    check_outputs(None, options.picture, options.overwrite)


def _add(options: Options, catalogue: Catalogue) -> Facts:
    from ...query.opening import scene_files

    note_own_scenes(map(Path, options.given))
    listed = [
        catalogue.add(scene_files(path, views=options.views), name=options.name, track=options.track)
        for path in options.given
    ]
    return {"scenes": _scenes_json(listed), "num_objects": len(catalogue), "wants_index": catalogue.wants_index}


def _ask(options: Options, catalogue: Catalogue) -> Facts:
    from ...drawing.pictures import write_picture
    from ...query.catalogue import Conditions
    from ...query.catalogue.rows import entry_sheet

    text = " ".join(options.given) or None
    said = text or options.others["image"] or options.others["vector"]
    box = None if options.box is None else numbers("--box", 6, options.box)
    area = None if options.area is None else numbers("--area", 4, options.area)
    where = Conditions(tuple(options.scene), box, area, _moment(options.since))
    answer = catalogue.answer(query_of({**options.others, "text": text}), where, top=options.top)
    drawn = options.picture if answer.entries else None
    if drawn:
        heading = f"{counted(len(answer.entries), 'match', 'matches')} for “{said}”"
        write_picture(drawn, entry_sheet(answer.entries, heading), options.overwrite)
    return {"query": said, **answer.json(), "matches": [entry.json() for entry in answer.entries], "picture": drawn}


def _scenes_json(scenes: Sequence[Any]) -> list[Facts]:
    return [{**vars(one), "added": one.added.isoformat()} for one in scenes]


def _moment(text: str | None) -> datetime | None:
    """Return the time of "2026-11-22" or "2026-11-22T14:00", on this machine's clock where no zone is given.

    Raises: InputError: no such time.
    """
    from datetime import datetime

    if text is None:
        return None
    try:
        return datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError, OSError):
        raise InputError(f"--since {text}: expected a time, e.g. 2026-11-22 or 2026-11-22T14:00") from None


def show(answer: Facts) -> None:
    number, place = counted(answer.get("num_objects", 0), "object"), answer["catalogue"]
    match answer["action"]:
        case "add":
            for one in answer["scenes"]:
                agreed = text_of(one["num_agreed"])
                unsure = f", {agreed} that photos agree on" if one["num_agreed"] < one["num_objects"] else ""
                print(f"added '{one['scene']}': {counted(one['num_objects'], 'object')}{unsure}")
            print(f"{place} has {number}")
            if answer["wants_index"]:
                print(f"Every query compares all of them: drsplat catalogue index {place}")
        case "remove":
            for name, count in answer["removed"].items():
                removed = f"removed '{name}': {counted(count or 0, 'object')}"
                print(f"'{name}' was removed before" if count is None else removed)
            print(f"{place} has {number}")
        case "list":
            title = f"{counted(len(answer['scenes']), 'scene')}, {number}; words by {answer['encoder']}"
            rows = [
                (*map(text_of, (one[key] for key in LISTED)), STATES[one["state"]], one["folder"])
                for one in answer["scenes"]
            ]
            show_table(title, ("scene", "objects", "agreed on", "added", "state", "folder"), rows)
        case "ask":
            _show_matches(answer)
        case _:
            print(f"indexed {number}")


def _show_matches(answer: Facts) -> None:
    compared = counted(answer["num_compared"], "object")
    how = f"{answer['measure']}, threshold {answer['threshold']:.4g}; {compared} compared"
    rows = []
    for one in answer["matches"]:
        places = map(place_text, (one["center"], one["extent"]))
        name, photo = one["label"] or one["name"] or "", one["photo"] or ""
        rows.append((one["scene"], str(one["object_id"]), name, f"{one['score']:.3f}", *places, photo))
    show_table(
        f"{counted(answer['num_matches'], 'match', 'matches')} for “{answer['query']}” by {how}",
        ("scene", "object", "name", "score", "centre", "extent", "photo"),
        rows,
    )
    if not answer["num_compared"]:
        print("Nothing was compared: --scene, --box, --area and --since leave no object; `list` tells the scenes.")
    elif not answer["matches"]:
        print("No object of any scene answers this: try other words, or a lower --threshold.")
    if answer["picture"]:
        print(f"written to {answer['picture']}")
