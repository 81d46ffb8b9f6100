"""Options of `drsplat edit`: what is edited, and the changes in the order in which they are given."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from ...base.terminal import counted, quoted
from .options import count, finite, length, whole, words

if TYPE_CHECKING:
    from pathlib import Path

    from ...authoring.editing.kept import KeptEdits
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.parted import AnyGaussians

AXES = ("x", "y", "z")


class _Then(argparse.Action):
    """Action that appends a change, (its name, its value), to `changes`."""

    sequence = "changes"  # the name under which --config keeps all of these in their order

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        namespace.changes = [*(namespace.changes or []), (self.dest, values)]


class _Axis(argparse.Action):
    """Action that stores a direction, given as three numbers or as a letter with or without a sign."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        sign, letter = (-1.0 if values[0][:1] == "-" else 1.0), values[0].lstrip("+-")
        if len(values) == 1 and letter in AXES:
            namespace.axis = [sign * (letter == name) for name in AXES]
            return
        try:
            namespace.axis = [finite(value) for value in values]
        except argparse.ArgumentTypeError:  # which argparse expects of types only
            namespace.axis = []
        if len(namespace.axis) != 3:
            raise argparse.ArgumentError(self, f"expected x, y, z or three numbers, got {quoted(' '.join(values))}")


def add_target_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("target of the edit (one of these)")
    which = group.add_mutually_exclusive_group()
    which.add_argument("--query", dest="text", type=words, metavar="WORDS", help="all matches of a query, together")
    which.add_argument("--object", type=whole, metavar="NUMBER", help="object, as `drsplat objects` numbers them")
    which.add_argument("--label", type=words, metavar="NAME", help="object with a label")
    which.add_argument(
        "--box", type=finite, nargs=6, metavar=("X", "Y", "Z", "SX", "SY", "SZ"),
        help="axis-aligned box: its centre and its full side lengths, in scene units",
    )  # fmt: skip
    which.add_argument("--rows", metavar="IDS.npy", help="rows of the scene, as `drsplat select --save` writes them")
    which.add_argument("--copies", type=count, metavar="NUMBER", help="Gaussians that an earlier edit added")
    which.add_argument("--everything", action="store_true", help="all Gaussians")


def add_change_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("changes, applied in order")

    def then(flag: str, **more: Any) -> None:
        group.add_argument(flag, action=_Then, default=argparse.SUPPRESS, **more)

    then("--remove", nargs=0, help="remove it")
    then("--isolate", nargs=0, help="remove everything else")
    then("--fill", nargs=0, help="fill the hole that it leaves with clones of the ground or wall beside it")
    then("--recolour", type=words, metavar="COLOUR", help="give it one hue but keep its shading, e.g. #2060ff")
    then("--palette", type=words, metavar="COLOURS", help="replace its colours by these, e.g. '#203040,#d0c0a0'")
    then("--like-photo", metavar="PICTURE", help="match the mean and spread of its colours to those of a picture")
    then("--opacity", type=finite, metavar="FACTOR", help="multiply its opacity; 0.3 makes it faint")
    then("--move", type=finite, nargs=3, metavar=("X", "Y", "Z"), help="move it by this, in scene units")
    then("--turn", type=finite, metavar="DEGREES", help="rotate it about --axis through its centre")
    then("--scale", type=length, metavar="FACTOR", help="make it larger or smaller; its base stays in place")
    then(
        "--duplicate", type=finite, nargs=3, metavar=("X", "Y", "Z"), help="copy it and move the copy by this; "
        "--copies edits the copy later",
    )  # fmt: skip
    then(
        "--replace", metavar="OTHER", help="replace it by another scene, or by --with-object of that, at its position, "
        "size and base",
    )  # fmt: skip
    group.add_argument("--amount", type=finite, default=1.0, metavar="A", help="strength of --recolour (default: 1)")
    group.add_argument(
        "--axis", nargs="+", action=_Axis, metavar="AXIS", help="axis of --turn: x, -z, or three numbers (default: up)"
    )
    group.add_argument("--with-object", type=whole, metavar="NUMBER", help="object of the field in the folder OTHER")
    group.add_argument(
        "--up", metavar="+z", help="axis that points up, +x to -z (default: from the orientation of the photos)"
    )
    parser.set_defaults(changes=None)


def add_list_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("the list")
    group.add_argument("--list", action="store_true", help="print the edits and annotations (default without a change)")
    group.add_argument("--undo", type=count, nargs="?", const=1, metavar="N", help="undo the last edit, or the last N")
    group.add_argument(
        "--redo", type=count, nargs="?", const=1, metavar="N", help="redo the last undone edit, or the last N"
    )
    group.add_argument("--annotate", type=words, metavar="TEXT", help="attach a text to its box, or to the point --at")
    group.add_argument("--at", type=finite, nargs=3, metavar=("X", "Y", "Z"), help="point of the world for --annotate")
    group.add_argument("--drop-annotation", type=count, metavar="NUMBER", help="remove an annotation")


def add_kept_edits(parser: argparse._ActionsContainer, default: str) -> None:
    parser.add_argument(
        "--edits", choices=("kept", "none"),
        help=f"kept: with the edits kept beside the scene; none: without them (default: {default})",
    )  # fmt: skip


def note_applied(number: int) -> None:
    """Report on stderr that kept edits are part of what is shown or written."""
    if number:
        _note(f"{counted(number, 'kept edit')} applied (--edits none to leave them out)")


def note_left_out(number: int, cure: str = "--edits kept to apply them") -> None:
    """Report on stderr that kept edits are left out of what is shown or written."""
    if number:
        _note(f"{counted(number, 'kept edit')} left out ({cure})")


SAVES_THEM = "`drsplat edit SCENE --save OUT.ply` writes the scene with them"


def note_own_scene(path: str | Path | None, gaussians: AnyGaussians | None) -> None:
    """Report on stderr that what is drawn or written of a scene's own file lacks the edits kept beside it."""
    from ...formats.scenes import companion

    if path is not None and gaussians is not None and companion(path, "edits").exists():
        from ...authoring.editing import EditFile

        number = EditFile.beside(path).num_done(gaussians)
        note_left_out(number, SAVES_THEM)


def note_own_scenes(folders: Iterable[Path]) -> None:
    """Report on stderr which scenes have kept edits that answers on their own files lack."""
    from ...authoring.editing import EditFile
    from ...errors import DrSplatError
    from ...formats.photo_files import listed
    from ...query.opening import scene_files

    edited = []
    for folder in folders:
        try:
            files = scene_files(folder)
        except DrSplatError:
            continue  # it is reported when somebody asks for this scene
        if any(EditFile.beside(scene).num_done() for scene in files.scenes):
            edited.append(files.name)
    if edited:
        _note(f"kept edits of {counted(len(edited), 'scene')} left out ({SAVES_THEM}): {listed(edited)}")


def as_edited(path: str, scene: Gaussians | Moving, choice: KeptEdits | None) -> Gaussians | Moving:
    """Return a scene with the edits kept beside it, all rows under their numbers, and report these on stderr.

    A scene that moves, or one that nobody edited, is returned as it is, and so is any with the choice "none".

    Raises: FormatError, MismatchError: the list of edits is damaged, or of another scene.
    """
    from ...authoring.editing import EditFile
    from ...authoring.editing.edits import drafted
    from ...authoring.editing.kept import without_kept
    from ...scene.moving import Moving

    if isinstance(scene, Moving):
        return scene
    edits = EditFile.beside(path)
    if without_kept(choice, changes=False, saves=False):
        note_left_out(edits.num_done(scene))
        return scene
    listed = edits.read(scene)
    note_applied(listed.done)
    return drafted(scene, listed.active, edits.other).everything() if listed.active else scene


def _note(text: str) -> None:
    print(f"drsplat: {text}", file=sys.stderr, flush=True)


def only_one(arguments: argparse.Namespace, names: Sequence[str]) -> str | None:
    """Return which of some options was given. Raises: InputError: several."""
    from ...errors import InputError

    given = [name for name in names if getattr(arguments, name) is not None and getattr(arguments, name) is not False]
    if len(given) > 1:
        named = " and ".join(arguments.flags.get(name) or name for name in given)
        raise InputError(f"{named} each name what is meant: keep one of them")
    return given[0] if given else None
