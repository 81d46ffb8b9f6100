"""drsplat edit: change objects of a scene, without touching its file."""

from __future__ import annotations

import argparse
import shlex
from contextlib import contextmanager, nullcontext
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...query.schema import CUT, EXCLUDE, SUBJECTS
from .edit_options import (
    add_change_options,
    add_kept_edits,
    add_list_options,
    add_target_options,
    note_applied,
    note_left_out,
    only_one,
)
from .options import add_capture_options, add_overwrite, add_query_encoders, words
from .query_options import add_fields, check_outputs, open_scene, query_of, query_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np

    from ...authoring.editing import EditFile, EditList
    from ...authoring.editing.draft import Draft
    from ...authoring.editing.edits import Change
    from ...authoring.editing.targets import Target
    from ...formats.annotations import AnnotationFile
    from ...query import Scene
    from ...scene.annotations import Annotation
    from ...scene.gaussians import Gaussians
    from ...scene.views import View

EXAMPLES = """\
  drsplat edit scene.ply --field room.field --query "red mug" --recolour "#2060ff"
  drsplat edit scene.ply --field room.field --object 7 --move 0.2 0 0 --save edited.ply
  drsplat edit drsplat-demo --query "red vase" --remove --fill --picture before_after.png
  drsplat edit drsplat-demo --object 4 --palette "#203040,#d0c0a0"
  drsplat edit scene.ply --field room.field --label "my mug" --replace other_room --with-object 3
  drsplat edit scene.ply --undo
  drsplat edit drsplat-demo --query "red vase" --annotate "from Delft"

Changes are kept in NAME.edits.json beside the scene NAME.ply, in order; a query is turned into rows once. --save
without a change writes the scene with all kept edits. --save with a change writes the scene with only that change
and keeps nothing; with --edits kept, the change is applied after the kept edits and kept too. Saved scenes have a
column object_id if the field has objects; every verb, and SuperSplat, open them. Annotations are kept in
NAME.annotations.json."""
DAILY = (
    "field",
    "text",
    "object",
    "everything",
    "remove",
    "recolour",
    "move",
    "turn",
    "scale",
    "list",
    "undo",
    "save",
    "picture",
    "overwrite",
)
QUERIES = tuple(field.name for field in SUBJECTS)
TARGETS = (*QUERIES, "object", "label", "box", "rows", "copies", "everything")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.usage = f"{parser.prog} SCENE [--field FIELD] [what] [change ...] [options]"
    parser.add_argument("scene", help="scene to edit, or a folder with a field, its scene and photos")
    parser.add_argument("--field", help="field of the scene, for queries, objects and labels")
    add_target_options(parser)
    add_fields(parser.add_argument_group("other queries"), (*SUBJECTS[1:], EXCLUDE))
    add_change_options(parser)
    add_list_options(parser)
    output = parser.add_argument_group("output")
    output.add_argument(
        "--save", metavar="OUT.ply",
        help="write the scene with only the changes of this command or, without any, with all kept edits",
    )  # fmt: skip
    add_kept_edits(output, "none with a change and --save, else kept")
    output.add_argument("--picture", metavar="OUT.png", help="write the scene before and after, side by side")
    output.add_argument("--views", metavar="CAPTURE", help="poses, for --picture and to find up")
    output.add_argument(
        "--view", type=words, metavar="NAME", help="view for --picture (default: the one that shows most of it)"
    )
    add_overwrite(output)
    add_query_encoders(parser)
    add_fields(parser, CUT)
    add_capture_options(parser)


class _Outcome(NamedTuple):
    """Outcome of a call. num_kept: edits that were kept before. after: the scene, None if nobody needs it."""

    num_kept: int
    edits: EditList
    annotations: tuple[Annotation, ...]
    after: Gaussians | None
    view: View | None


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    from ...authoring.editing import EditFile
    from ...authoring.editing.kept import without_kept
    from ...formats.annotations import AnnotationFile
    from ...formats.replacing import together

    check_outputs(arguments)
    work = _Work(arguments)
    edits, notes = EditFile.beside(work.path), AnnotationFile.beside(work.path)
    alone = without_kept(arguments.edits, changes=bool(arguments.changes), saves=bool(arguments.save))
    with _held(edits, notes) if work.writes(alone) else nullcontext(), together():
        outcome = _done(work, edits, notes, alone)
    if alone:
        note_left_out(outcome.num_kept)
    elif arguments.save or arguments.picture:
        note_applied(outcome.num_kept if arguments.changes else outcome.edits.done)
    return {
        "scene": str(work.path),
        "edits_file": str(edits.path),
        "kept": not alone,
        "num_edits": outcome.edits.done,
        "num_undone": len(outcome.edits.edits) - outcome.edits.done,
        "edits": _edits_json(outcome.edits),
        "annotations": [_annotation_json(one) for one in outcome.annotations],
        "num_gaussians_before": len(work.gaussians),
        "num_gaussians": None if outcome.after is None else len(outcome.after),
        "saved": arguments.save,
        "picture": arguments.picture,
        "view": None if outcome.view is None else outcome.view.name,
    }


def _done(work: _Work, file: EditFile, notes: AnnotationFile, alone: bool) -> _Outcome:
    """Change the lists as the options say, and write them and the outputs. alone: the kept edits are left out."""
    from ...authoring.editing import EditList

    arguments, view, after = work.arguments, None, None
    kept, noted = file.read(work.gaussians), notes.read()
    first = EditList(kept.scene) if alone else kept
    edits = work.changed(first, file)
    annotations = work.annotated(noted, kept if alone else edits, file)
    if arguments.save or arguments.picture or arguments.changes or arguments.redo:
        after = file.edited(work.gaussians, edits)
    if edits is not first and not alone:
        file.write(edits)
    if annotations is not noted:
        notes.write(annotations)
    if arguments.save and after is not None:
        _save(arguments, after)
    if arguments.picture and after is not None:
        view = work.draw(edits, after)
    return _Outcome(kept.done, edits, annotations, after, view)


@contextmanager
def _held(edits: EditFile, notes: AnnotationFile) -> Iterator[None]:
    with edits.held(), notes.held():
        yield


def show(answer: dict[str, Any]) -> None:
    from ...base.terminal import counted
    from .tables import show_table

    edits, scene = counted(answer["num_edits"], "edit"), answer["scene"]
    title = f"{edits} kept beside {scene}, {answer['num_undone']} undone" if answer["kept"] else f"{edits} of this call"
    rows = [(str(one["number"]), one["do"], one["of"], "" if one["done"] else "undone") for one in answer["edits"]]
    if rows:
        show_table(title, ("edit", "what", "of", ""), rows)
    else:
        print(title)
    for number, one in enumerate(answer["annotations"], start=1):
        print(f"annotation {number}: {one['text']}, at {' '.join(f'{x:.2f}' for x in one['center'])}")
    if answer["num_gaussians"] is not None:
        print(f"{answer['num_gaussians_before']:,} Gaussians before, {answer['num_gaussians']:,} after")
    for output in (answer["saved"], answer["picture"]):
        if output:
            print(f"written to {output}")
    if answer["kept"] and answer["num_edits"] and not answer["saved"]:
        call = f"drsplat edit {shlex.quote(scene)} --save OUT.ply"
        print(f"The scene's file is unchanged: {call} applies the kept edits.")


def _edits_json(listed: EditList) -> list[dict[str, Any]]:
    from ...authoring.editing.stored import NAMES

    return [
        {"number": number, "do": NAMES[type(edit.change)], "of": str(edit.target), "done": number <= listed.done}
        for number, edit in enumerate(listed.edits, start=1)
    ]


def _annotation_json(one: Annotation) -> dict[str, Any]:
    box = {} if one.outline is None else {"extent": one.outline.extent, "axes": one.outline.axes}
    return {"text": one.text, "center": one.center} | box


def _save(arguments: argparse.Namespace, after: Gaussians) -> None:
    from ... import write_gaussians

    write_gaussians(arguments.save, after, overwrite=arguments.overwrite, is_edited=True)


class _Work:
    """One call of the verb: the scene that is meant, opened as far as it is needed."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        from ...formats.moving_scenes import read_scene
        from ...query.opening import find_scene, registered_scene
        from ...scene.moving import still

        self.arguments = arguments
        path = Path(arguments.scene)
        if arguments.field is None and path.is_dir() and any(path.glob("*.field")):
            files = find_scene(path)
            self.path, scene = registered_scene(files)
            gaussians = still(scene)
            arguments.field, arguments.scene = str(path), None
        else:
            self.path, gaussians = path, still(read_scene(path))
        self._scene: Scene | None = None if arguments.field is None else open_scene(arguments)
        self.gaussians = self._with_objects(gaussians)

    def _with_objects(self, gaussians: Gaussians) -> Gaussians:
        """Add the number of each one's object, where the field knows objects."""
        from dataclasses import replace

        from ...authoring.editing.draft import OBJECT_ID

        if self._scene is None or self._scene.field.objects is None:
            return gaussians
        return replace(gaussians, extra={**gaussians.extra, OBJECT_ID: self._scene.object_ids()})

    @property
    def scene(self) -> Scene:
        from ...errors import InputError

        if self._scene is None:
            raise InputError("queries, objects and labels need the field of the scene: pass field=FIELD")
        return self._scene

    @cached_property
    def posed(self) -> Scene | None:
        """The scene with what is known of its photos, for pictures and to know what is up; None for nothing."""
        from ..viewing.bare import open_bare

        if self._scene is not None or self.arguments.views is None:
            return self._scene
        return open_bare(self.path, self.arguments.views, self.arguments.threads)

    # --- what is edited ---

    def target(self) -> Target:
        """Return the target that the options name. Raises: InputError: none, or several; nothing is there."""
        import numpy as np

        from ...authoring.editing import Box, Copies, Everything, Rows
        from ...authoring.editing.resolving import label_rows, object_rows, query_rows
        from ...errors import InputError
        from ...formats.npy import map_npy

        arguments = self.arguments
        which = only_one(arguments, TARGETS)
        if which is None:
            raise InputError("nothing to edit was named: pass --query WORDS, --object NUMBER or --everything")
        if which in QUERIES:
            return query_rows(self.scene, query_of(arguments), query_text(arguments))
        match which:
            case "object":
                return object_rows(self.scene, arguments.object)
            case "label":
                return label_rows(self.scene, arguments.label)
            case "rows":
                return Rows.of(_row_numbers(map_npy(Path(arguments.rows)), arguments.rows))
            case "copies":
                return Copies(arguments.copies)
            case "everything":
                return Everything()
        return Box(np.array(arguments.box[:3]), np.eye(3), np.array(arguments.box[3:]))

    # --- what is done ---

    def writes(self, alone: bool) -> bool:
        """Return whether the lists beside the scene may change. alone: changes are not kept."""
        arguments = self.arguments
        options = [arguments.undo, arguments.redo, arguments.annotate, arguments.drop_annotation]
        options += [] if alone else [arguments.changes]
        return any(option is not None for option in options)

    def changed(self, listed: EditList, file: EditFile) -> EditList:
        """Return the list with the changes that the options name; the same list if they name none.

        Raises: InputError: it cannot be.
        """
        from ...authoring.editing import Edit
        from ...authoring.editing.edits import drafted, recorded
        from ...errors import InputError

        arguments = self.arguments
        steps = [arguments.undo is not None, arguments.redo is not None, bool(arguments.changes)]
        if sum(steps) > 1:
            raise InputError("--undo, --redo and changes: give one of them at a time")
        if arguments.edits == "none" and (steps[0] or steps[1]):
            raise InputError("--undo and --redo are of the kept edits: drop --edits none")
        if arguments.copies is not None and arguments.save and arguments.edits is None and arguments.changes:
            raise InputError(
                "copies: they are of a kept edit, and a change that is saved is done alone: add --edits kept"
            )
        target = self.target() if arguments.changes else None
        for _ in range(arguments.undo or 0):
            listed = listed.undone()
        for _ in range(arguments.redo or 0):
            listed = listed.redone()
        for name, value in arguments.changes or ():
            assert target is not None
            draft = drafted(self.gaussians, listed.active, file.other)
            made = self._made(name, value, draft.part(target.ids(draft)), file.path.parent)
            listed = recorded(self.gaussians, listed.with_edit(Edit(target, made)), file.other)
        return listed

    def _made(self, name: str, value: Any, part: Gaussians, folder: Path) -> Change:
        from ...authoring import editing
        from ...authoring.editing.colouring import color_of
        from ...authoring.editing.making import replaced_by, scaled_on_its_foot
        from .query_inputs import read_picture

        arguments = self.arguments
        makers: dict[str, Callable[[], Change]] = {
            "remove": editing.Remove,
            "isolate": editing.Isolate,
            "fill": editing.Fill,
            "recolour": lambda: editing.Recolour(color_of(value), arguments.amount),
            "palette": lambda: editing.Palette(tuple(color_of(one) for one in value.split(","))),
            "like_photo": lambda: editing.MatchPhoto.of(read_picture(value)),
            "opacity": lambda: editing.Opacity(value),
            "move": lambda: editing.Move(tuple(value)),
            "duplicate": lambda: editing.Duplicate(tuple(value)),
            "turn": lambda: editing.Turn(value, tuple(arguments.axis or self._needed_up.tolist())),
            "scale": lambda: scaled_on_its_foot(part, value, self._up),
            "replace": lambda: replaced_by(part, self._needed_up, value, arguments.with_object, folder),
        }
        return makers[name]()

    @property
    def _up(self) -> np.ndarray | None:
        from ...authoring.filming.looking import named_up

        if self.arguments.up:
            return named_up(self.arguments.up)
        return None if self.posed is None else self.posed.up

    @property
    def _needed_up(self) -> np.ndarray:
        """Raises: InputError: nothing tells."""
        from ...errors import InputError

        if self._up is None:
            raise InputError("nothing tells which way is up: pass up=DIRECTION, e.g. --up +z, or views=CAPTURE")
        return self._up

    # --- annotations ---

    def annotated(self, known: tuple[Annotation, ...], listed: EditList, file: EditFile) -> tuple[Annotation, ...]:
        """Return the annotations after the edits, with what the options add and drop."""
        from ...authoring.editing.edits import drafted
        from ...errors import InputError
        from ...formats.annotations import without
        from ...scene.annotations import Annotation

        arguments = self.arguments
        if arguments.drop_annotation is not None:
            known = without(known, arguments.drop_annotation)
        if arguments.annotate is None:
            if arguments.at is not None:
                raise InputError("--at is for --annotate TEXT: pass both, or none")
            return known
        if arguments.at is not None:
            return (*known, Annotation.at(arguments.annotate, arguments.at))
        return (*known, *self._boxed(arguments.annotate, drafted(self.gaussians, listed.active, file.other)))

    def _boxed(self, text: str, draft: Draft) -> list[Annotation]:
        """Return boxes at each match of a query, else at what is edited; where it is after all edits."""
        import numpy as np

        from ...kernels.boxes import box_of
        from ...scene.annotations import Annotation
        from ...scene.boxes import solid

        if only_one(self.arguments, TARGETS) in QUERIES:
            parts = [one.gaussian_ids for one in self.scene.locate(query_of(self.arguments))]
        else:
            parts = [self.target().ids(draft)]
        up = None if self.posed is None else self.posed.up
        wholes = [draft.part(ids) for ids in parts]
        boxes = [box_of(part, solid(part, np.arange(len(part))), up) for part in wholes]
        return [Annotation.box(text, box.center, box.axes, np.maximum(box.extent, 1e-6)) for box in boxes]

    # --- pictures ---

    def draw(self, listed: EditList, after: Gaussians) -> View:
        """Write --picture; returns the view that it is from."""
        from ...authoring.editing.draft import Draft
        from ...authoring.editing.pictures import before_after
        from ...authoring.editing.targets import Rows
        from ...drawing.pictures import write_picture
        from ...errors import InputError

        scene, last = self.posed, listed.active[-1] if listed.active else None
        if scene is None:
            raise InputError("a picture needs a place to be seen from: pass views=CAPTURE, the photos' poses")
        rows = last.target.ids(Draft.of(self.gaussians)) if last and isinstance(last.target, Rows) else None
        view = scene.view(self.arguments.view) if self.arguments.view else scene.best_view(rows)
        said = ", ".join(f"{one['do']} {one['of']}" for one in _edits_json(listed)[: listed.done][-2:])
        picture = before_after(self.gaussians, after, view, said, self.arguments.threads)
        write_picture(self.arguments.picture, picture, self.arguments.overwrite)
        return view


def _row_numbers(array: np.ndarray, path: str) -> np.ndarray:
    import numpy as np

    from ...errors import FormatError

    if array.ndim != 1 or array.dtype.kind not in "iu" or not len(array):
        raise FormatError(f"{path}: expected whole numbers (m,), got {array.dtype} {array.shape}")
    return np.asarray(array, np.int64)
