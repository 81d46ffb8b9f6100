"""Options of all verbs that search a field, and what they stand for."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...query.schema import CUT, FIELDS, SUBJECTS, Place, QueryField, fields
from .edit_options import note_own_scene
from .options import (
    CAPTURE_OPTIONS,
    add_capture_options,
    add_overwrite,
    add_query_encoders,
    add_search_device,
    new_output,
    words,
)
from .query_inputs import WAYS

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np

    from ...query import Answer, Cut, Query, Scene
    from ...scene.views import View


ENDINGS_WITHOUT_SCENE = (".npy", ".json", ".csv")  # of outputs that hold no Gaussians
FIELD_HELP = "field that `drsplat register` wrote, or a folder with a field, its scene and photos"


def add_query_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is looked for, who embeds it, and where its scores are cut."""
    parser.add_argument("field", help=FIELD_HELP)
    text, *others = fields(Place.COMMAND_LINE)
    parser.add_argument(text.name, nargs="?", type=words, metavar=text.value, help=text.meaning)
    add_fields(parser, others)
    add_query_encoders(parser)
    add_search_device(parser)


def add_fields(parser: argparse._ActionsContainer, offered: Iterable[QueryField]) -> None:
    """Add an option for each of some fields of a query."""
    groups: dict[str, argparse._ActionsContainer] = {"": parser}
    for field in offered:
        if field.group not in groups:
            groups[field.group] = parser.add_mutually_exclusive_group()
        way, flag = WAYS[field.kind], f"--{field.name.replace('_', '-')}"
        more: dict[str, Any] = {"choices": field.choices, "default": field.default} if field.choices else {}
        if not field.choices and field.kind != "flag":
            more["metavar"] = field.value
        groups[field.group].add_argument(flag, help=field.meaning + way.note, **{**more, **way.options})


def add_output_options(parser: argparse.ArgumentParser, saved: str) -> None:
    """Add --scene, --save, --picture and the poses for it."""
    parser.add_argument("--scene", help="scene that was registered; needed for positions, --save and --picture")
    output = parser.add_argument_group("output")
    output.add_argument("--save", metavar="OUT.ply", help=saved)
    output.add_argument(
        "--picture", metavar="OUT.png", help="write a photo with the answer in colour and the rest in grey"
    )
    output.add_argument("--views", metavar="CAPTURE", help="poses and photos, for --picture and --click")
    output.add_argument(
        "--view", type=words, metavar="NAME",
        help="photo for --picture (default: the photo that shows most of the answer)",
    )  # fmt: skip
    add_overwrite(output)
    add_capture_options(parser)


def check_outputs(arguments: argparse.Namespace, suffixes: tuple[str, ...] = (".ply",)) -> None:
    """Check all that can be known to be wrong before any work is done.

    suffixes: those of --save; a .npy needs no scene.
    """
    from ...errors import InputError

    for option, output in (("--save", arguments.save), ("--picture", arguments.picture)):
        if output is None:
            continue
        folder = new_output(output, arguments.overwrite).parent
        if option == "--save" and not output.lower().endswith(suffixes):
            raise InputError(f"{output}: expected a name that ends in {' or '.join(suffixes)}")
        if not folder.is_dir():
            raise InputError(f"{option}: there is no folder {folder}: make it first")


def ask(arguments: argparse.Namespace, suffixes: tuple[str, ...] = (".ply",)) -> tuple[Scene, Answer]:
    """Open the scene that the options name and ask it; wrong outputs are refused before any work.

    Raises: as `check_outputs` and `open_scene`.
    """
    check_outputs(arguments, suffixes)
    scene = open_scene_for_output(arguments)
    return scene, scene.ask(query_of(arguments))


SCENE_OPTIONS = ("scene", "views", "encoder", "vocabulary", "device", "search_device", "threads")


def open_scene(arguments: argparse.Namespace, field: str | None = None) -> Scene:
    """Open the scene of the options: --scene, --views, those of encoders and captures, and a field.

    field: None for the verb's own.

    Raises: as `drsplat.open_scene`.
    """
    from ... import open_scene as opened

    _refuse_swapped(arguments)
    given = {name: value for name, value in vars(arguments).items() if name in SCENE_OPTIONS + CAPTURE_OPTIONS}
    return opened(field or arguments.field, **given)


def _refuse_swapped(arguments: argparse.Namespace) -> None:
    """Refuse words in the place of the field where the field stands in theirs."""
    from ...errors import InputError

    field, text = getattr(arguments, "field", None), getattr(arguments, "text", None)
    if isinstance(field, str) and text and not Path(field).exists() and Path(text).exists():
        raise InputError(f"the field comes first, then the words: {text} {shlex.quote(field)}")


def open_scene_for_output(arguments: argparse.Namespace) -> Scene:
    """Open the scene, if --save and --picture can be made of it. Raises: InputError: they cannot; as `open_scene`."""
    scene = open_scene(arguments)
    drawn = arguments.picture is not None
    if drawn or (arguments.save is not None and not arguments.save.lower().endswith(ENDINGS_WITHOUT_SCENE)):
        _ = scene.rows  # or the error that says what is missing, before any work
    if drawn:
        scene.best_view()
    if drawn or arguments.save is not None:
        note_own_scene(scene.path, scene.rows if scene.has_gaussians else None)
    return scene


def values_of(arguments: argparse.Namespace, offered: Iterable[QueryField] = FIELDS) -> dict[str, Any]:
    """Return what the options of some fields give, as `Query` takes it."""
    given = {field: getattr(arguments, field.name, None) for field in offered}
    return {field.name: WAYS[field.kind].read(value) for field, value in given.items() if value not in (None, [])}


def query_of(arguments: argparse.Namespace) -> Query:
    """Return the query that the options of a verb describe."""
    from ...query import Query

    return Query(**values_of(arguments))


def cut_of(arguments: argparse.Namespace) -> Cut:
    """Return how the options of a verb measure and cut."""
    from ...query import Cut

    return Cut(**values_of(arguments, CUT))


def query_text(arguments: argparse.Namespace) -> str:
    """Return the query in the words of the command line."""
    nots = "".join(f", not {words}" for words in arguments.exclude)
    return f"{next(getattr(arguments, one.name) for one in SUBJECTS if getattr(arguments, one.name))}{nots}"


def answer_json(arguments: argparse.Namespace, answer: Answer) -> dict[str, Any]:
    """Return what every answer says of its values, and what was asked."""
    from ...query.documents import answer_document

    return {"field": arguments.field, "query": query_text(arguments), **answer_document(answer)}


RULES = {
    "given": "as given", "top share": "for the given share", "auto": "chosen for this query",
    "list": "above which the query fits better than a list of other words", "encoder": "that of the encoder",
    "default": "the default", "object": "the whole object at this place", "label": "the objects of this name",
}  # fmt: skip


def measured_text(answer: dict[str, Any]) -> str:
    """Return a line of the scores and the threshold."""
    low, high = answer["score_range"]
    return (
        f"{answer['measure']} from {low:.3f} to {high:.3f}, 99 of 100 below {answer['score_p99']:.3f}; "
        f"threshold {answer['threshold']:.4g}, {RULES[answer['threshold_rule']]}"
    )


def print_doubt(answer: dict[str, Any]) -> None:
    """Print what to know before the answer: why to doubt it, and the photo that sides are meant from."""
    if answer["doubt"]:
        print(f"warning: {answer['doubt']}")
    if answer["seen_from"]:
        print(f"left and right are those of the photo {answer['seen_from']}")


def draw(arguments: argparse.Namespace, scene: Scene, ids: np.ndarray, note: str) -> str:
    """Write --picture: the photo, in colour where the Gaussians at `ids` are; returns its name."""
    from ...drawing.pictures import titled, write_picture

    view = chosen_view(arguments, scene, ids)
    title = f"“{query_text(arguments)}”" if arguments.text else query_text(arguments)
    picture = titled(scene.picture(view, ids, photo=True), title, note)
    write_picture(arguments.picture, picture, arguments.overwrite)
    return view.name


def chosen_view(arguments: argparse.Namespace, scene: Scene, ids: np.ndarray) -> View:
    """Return the named view, else the one that shows most of the Gaussians at `ids`."""
    return scene.view(arguments.view) if arguments.view else scene.best_view(ids)
