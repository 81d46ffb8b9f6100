"""Options of `drsplat edit`: what is edited, and the changes in the order in which they are given."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from ...base.terminal import counted, quoted
from ...errors import DrSplatError, InputError
from .declaring import Item, count, declaration, finite, flag, length, option, several, whole, words

if TYPE_CHECKING:
    from pathlib import Path

    from ...authoring.editing.edits import KeptEdits
    from ...scene.gaussians import Gaussians
    from ...scene.moving import Moving
    from ...scene.parted import AnyGaussians

AXES = ("x", "y", "z")
AXES_VALUE = ("X", "Y", "Z")


class _Then(argparse.Action):
    """Action that appends a change, (its name, its value), to `changes`."""

    sequence = "changes"  # the name under which --config keeps all of these in their order

    def __call__(self, _: object, namespace: argparse.Namespace, values: Any, __: object = None) -> None:
        namespace.changes = [*getattr(namespace, "changes", []), (self.dest, values)]


class _Axis(argparse.Action):
    """Action that stores a direction, given as three numbers or as a letter with or without a sign."""

    def __call__(self, _: object, namespace: argparse.Namespace, values: Any, __: object = None) -> None:
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


@declaration
class Targets:
    """Target of an edit."""

    TITLE = "target of the edit (one of these)"
    text: str | None = option("all matches of a query, together", "WORDS", words, flags="--query", rivals="target")
    object: int | None = option("object, as `drsplat objects` numbers them", "NUMBER", whole, rivals="target")
    label: str | None = option("object with a label", "NAME", words, rivals="target")
    box: list[float] | None = option(
        "axis-aligned box: its centre and its full side lengths, in scene units", ("X", "Y", "Z", "SX", "SY", "SZ"),
        finite, nargs=6, rivals="target",
    )  # fmt: skip
    rows: str | None = option(
        "rows of the scene, as `drsplat select --save` writes them", "IDS.npy", rivals="target"
    )  # fmt: skip
    copies: int | None = option("Gaussians that an earlier edit added", "NUMBER", count, rivals="target")
    everything: bool = flag("all Gaussians", rivals="target")


def _then(name: str, meaning: str, value: Any = None, kind: Any = None, nargs: int | None = None) -> Item:
    own = {"help": meaning, "metavar": value, "type": kind, "nargs": nargs}
    return Item(name, [f"--{name.replace('_', '-')}"], {"action": _Then, "default": argparse.SUPPRESS, **own})


CHANGES = (
    _then("remove", "remove it", nargs=0),
    _then("isolate", "remove everything else", nargs=0),
    _then("fill", "fill the hole that it leaves with clones of the ground or wall beside it", nargs=0),
    _then("recolour", "give it one hue but keep its shading, e.g. #2060ff", "COLOUR", words),
    _then("palette", "replace its colours by these, e.g. '#203040,#d0c0a0'", "COLOURS", words),
    _then("like_photo", "match the mean and spread of its colours to those of a picture", "PICTURE"),
    _then("opacity", "multiply its opacity; 0.3 makes it faint", "FACTOR", finite),
    _then("move", "move it by this, in scene units", AXES_VALUE, finite, 3),
    _then("turn", "rotate it about --axis through its centre", "DEGREES", finite),
    _then("scale", "make it larger or smaller; its base stays in place", "FACTOR", length),
    _then("duplicate", "copy it and move the copy by this; --copies edits the copy later", AXES_VALUE, finite, 3),
    _then(
        "replace", "replace it by another scene, or by --with-object of that, at its position, size and base", "OTHER"
    ),
)  # fmt: skip


@declaration
class Changes:
    """How the target is changed: names and values in the order of the line, and how some of them are meant."""

    TITLE = "changes, applied in order"
    changes: Sequence[tuple[str, Any]] | None = several(CHANGES, lambda given: given.get("changes"))
    amount: float = option("strength of --recolour (default: 1)", "A", finite, 1.0)
    axis: list[float] | None = option(
        "axis of --turn: x, -z, or three numbers (default: up)", "AXIS", nargs="+", action=_Axis
    )
    with_object: int | None = option("object of the field in the folder OTHER", "NUMBER", whole)
    up: str | None = option("axis that points up, +x to -z (default: from the orientation of the photos)", "+z")


@declaration
class Listed:
    """Work on the kept edits and annotations."""

    TITLE = "the list"
    list: bool = flag("print the edits and annotations (default without a change)")
    undo: int | None = option("undo the last edit, or the last N", "N", count, nargs="?", const=1)
    redo: int | None = option("redo the last undone edit, or the last N", "N", count, nargs="?", const=1)
    annotate: str | None = option("attach a text to its box, or to the point --at", "TEXT", words)
    at: Sequence[float] | None = option("point of the world for --annotate", AXES_VALUE, finite, nargs=3)
    drop_annotation: int | None = option("remove an annotation", "NUMBER", count)


def kept_edits(default: str, title: str = "") -> Any:
    return option(
        f"kept: with the edits kept beside the scene; none: without them (default: {default})",
        choices=("kept", "none"), title=title,
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
    from ...formats.photo_files import listed
    from ...query.opening import scene_files

    edited = []
    for folder in folders:
        with suppress(DrSplatError):  # which is reported when somebody asks for this scene
            files = scene_files(folder)
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
    from ...authoring.editing.edits import drafted, without_kept
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


def only_one(given: Mapping[str, Any], names: Iterable[str]) -> str | None:
    """Return which of some options was given. Raises: InputError: several."""

    named = [name for name in names if given[name] is not None and given[name] is not False]
    if len(named) > 1:
        flags = " and ".join("--query" if name == "text" else f"--{name.replace('_', '-')}" for name in named)
        raise InputError(f"{flags} each name what is meant: keep one of them")
    return named[0] if named else None
