"""drsplat edit: change objects of a scene, without touching its file."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.terminal import counted
from ...errors import FormatError, InputError
from ...query.schema import CUT, EXCLUDE, SUBJECTS
from .declaring import Facts, argument, declaration, option, part, words
from .edit_options import Changes, Listed, Targets, kept_edits, note_applied, note_left_out, only_one
from .options import Encoders, Photos, Verb, overwrite
from .query_options import asked, check_outputs, open_with, query_of, query_text
from .tables import show_table

if TYPE_CHECKING:
    from ...authoring.editing import EditFile, EditList
    from ...authoring.editing.draft import Draft
    from ...authoring.editing.edits import Change, KeptEdits
    from ...authoring.editing.targets import Target
    from ...base.arrays import Array
    from ...formats.annotations import AnnotationFile
    from ...query import Scene
    from ...scene.gaussians import Gaussians
    from ...scene.labelled import Annotation
    from ...scene.views import View
    from .query_options import Asked

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
DAILY = "field text object everything remove recolour move turn scale list undo save picture overwrite"
USAGE = "%(prog)s SCENE [--field FIELD] [what] [change ...] [options]"
QUERIES = tuple(field.name for field in SUBJECTS)
TARGETS = (*QUERIES, "object", "label", "box", "rows", "copies", "everything")


@declaration
class Options(Verb):
    """Options of this verb."""

    scene: str = argument("scene to edit, or a folder with a field, its scene and photos")
    field: str | None = option("field of the scene, for queries, objects and labels")
    target: Targets = part(Targets)
    others: Asked = asked((*SUBJECTS[1:], EXCLUDE), "other queries")
    change: Changes = part(Changes)
    listed: Listed = part(Listed)
    save: str | None = option(
        "write the scene with only the changes of this command or, without any, with all kept edits", "OUT.ply",
        title="output",
    )  # fmt: skip
    edits: KeptEdits | None = kept_edits("none with a change and --save, else kept", "output")
    picture: str | None = option("write the scene before and after, side by side", "OUT.png", title="output")
    views: str | None = option("poses, for --picture and to find up", "CAPTURE", title="output")
    view: str | None = option(
        "view for --picture (default: the one that shows most of it)", "NAME", words, title="output"
    )
    overwrite: bool = overwrite("output")
    encoders: Encoders = part(Encoders)
    cut: Asked = asked(CUT)
    photos: Photos = part(Photos)

    @property
    def asked(self) -> Asked:
        """Values that say what is edited, by name."""
        return {**vars(self.target), **self.others, **self.cut}


def run(options: Options) -> Facts:
    from ...authoring.editing import EditList
    from ...authoring.editing.edits import without_kept
    from ...formats.replacing import together

    work, changes, wanted = _work(options), options.change.changes, options.listed
    saved = options.save or options.picture
    alone = without_kept(options.edits, changes=bool(changes), saves=bool(options.save))
    writes = wanted.undo or wanted.redo or wanted.annotate or wanted.drop_annotation or (changes and not alone)
    with ExitStack() as held, together():
        for file in (work.file, work.notes) if writes else ():
            held.enter_context(file.held())  # against other processes
        kept, noted = work.file.read(work.gaussians), work.notes.read()
        first = EditList(kept.scene) if alone else kept
        edits = work.changed(first)
        annotations = work.annotated(noted, kept if alone else edits)
        after = work.file.edited(work.gaussians, edits) if saved or changes or wanted.redo else None
        if edits is not first and not alone:
            work.file.write(edits)
        if annotations is not noted:
            work.notes.write(annotations)
        view = None if after is None else work.write(edits, after)
    if alone:
        note_left_out(kept.done)
    elif saved:
        note_applied(kept.done if changes else edits.done)
    return {
        "scene": work.path,
        "edits_file": work.file.path,
        "kept": not alone,
        "num_edits": edits.done,
        "num_undone": len(edits.edits) - edits.done,
        "edits": _edits_json(edits),
        "annotations": [_annotation_json(one) for one in annotations],
        "num_gaussians_before": len(work.gaussians),
        "num_gaussians": None if after is None else len(after),
        "saved": options.save,
        "picture": options.picture,
        "view": None if view is None else view.name,
    }


def show(answer: Facts) -> None:
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


def _edits_json(listed: EditList) -> list[Facts]:
    from ...authoring.editing.edits import NAMES

    return [
        {"number": number, "do": NAMES[type(edit.change)], "of": str(edit.target), "done": number <= listed.done}
        for number, edit in enumerate(listed.edits, start=1)
    ]


def _annotation_json(one: Annotation) -> Facts:
    box = {} if one.outline is None else {"extent": one.outline.extent, "axes": one.outline.axes}
    return {"text": one.text, "center": one.center, **box}


def _work(options: Options) -> _Work:
    """Open the scene that is meant; each Gaussian has the number of its object, where the field knows objects.

    Raises: InputError: as `check_outputs`.
    """
    from ...authoring.editing import EditFile
    from ...authoring.editing.draft import OBJECT_ID
    from ...formats.annotations import AnnotationFile
    from ...formats.moving_scenes import read_scene
    from ...query.opening import find_scene, registered_scene
    from ...scene.moving import still

    check_outputs(options.save, options.picture, options.overwrite)
    path, field, scene = Path(options.scene), options.field, None
    if field is None and path.is_dir() and any(path.glob("*.field")):
        field = options.scene
        path, found = registered_scene(find_scene(path))
    else:
        found, scene = read_scene(path), options.scene
    gaussians, opened = still(found), None
    if field is not None:
        opened = open_with(options, field, scene)
        if opened.field.objects is not None:
            gaussians = replace(gaussians, extra={**gaussians.extra, OBJECT_ID: opened.object_ids()})
    return _Work(options, path, EditFile.beside(path), AnnotationFile.beside(path), gaussians, opened)


@dataclass(frozen=True)
class _Work:
    """One call of the verb.

    path: of the scene. file: its edits. notes: its annotations. opened: with its field, None where it has none.
    """

    options: Options
    path: Path
    file: EditFile
    notes: AnnotationFile
    gaussians: Gaussians
    opened: Scene | None

    @property
    def scene(self) -> Scene:
        if self.opened is None:
            raise InputError("queries, objects and labels need the field of the scene: pass field=FIELD")
        return self.opened

    @cached_property
    def posed(self) -> Scene | None:
        """The scene with what is known of its photos, for pictures and to know what is up; None for nothing."""
        from ..viewing.bare import open_bare

        if self.opened is not None or self.options.views is None:
            return self.opened
        return open_bare(self.path, self.options.views, self.options.threads)

    def draft(self, edits: EditList) -> Draft:
        """Return the scene after some edits."""
        from ...authoring.editing.edits import drafted

        return drafted(self.gaussians, edits.active, self.file.other)

    # --- what is edited ---

    def target(self) -> Target:
        """Return the target that the options name. Raises: InputError: none, or several; nothing is there."""
        import numpy as np

        from ...authoring.editing import Box, Copies, Everything, Rows
        from ...authoring.editing.resolving import label_rows, object_rows, query_rows
        from ...formats.npy import map_npy

        given = self.options.asked
        which = only_one(given, TARGETS)
        if which is None:
            raise InputError("nothing to edit was named: pass --query WORDS, --object NUMBER or --everything")
        value = given[which]
        match which:
            case "object":
                return object_rows(self.scene, value)
            case "label":
                return label_rows(self.scene, value)
            case "box":
                return Box(np.array(value[:3]), np.eye(3), np.array(value[3:]))
            case "rows":
                rows = map_npy(Path(value))
                if rows.ndim != 1 or rows.dtype.kind not in "iu" or not len(rows):
                    raise FormatError(f"{value}: expected whole numbers (m,), got {rows.dtype} {rows.shape}")
                return Rows.of(np.asarray(rows, np.int64))
            case "copies":
                return Copies(value)
            case "everything":
                return Everything()
        return query_rows(self.scene, query_of(given), query_text(given))

    # --- what is done ---

    def changed(self, edits: EditList) -> EditList:
        """Return the list with the changes that the options name; the same list if they name none.

        Raises: InputError: it cannot be.
        """
        from ...authoring.editing import Edit
        from ...authoring.editing.edits import recorded

        options, undo, redo = self.options, self.options.listed.undo, self.options.listed.redo
        changes = options.change.changes or ()
        if sum(map(bool, (undo, redo, changes))) > 1:
            raise InputError("--undo, --redo and changes: give one of them at a time")
        if options.edits == "none" and (undo or redo):
            raise InputError("--undo and --redo are of the kept edits: drop --edits none")
        if options.target.copies is not None and options.save and options.edits is None and changes:
            raise InputError(
                "copies: they are of a kept edit, and a change that is saved is done alone: add --edits kept"
            )
        for _ in range(undo or 0):
            edits = edits.undone()
        for _ in range(redo or 0):
            edits = edits.redone()
        if not changes:
            return edits
        target = self.target()
        for name, value in changes:
            draft = self.draft(edits)
            made = self._made(name, value, draft.rows.subset(target.ids(draft)))
            edits = recorded(self.gaussians, edits.with_edit(Edit(target, made)), self.file.other)
        return edits

    def _made(self, name: str, value: Any, part: Gaussians) -> Change:
        from ...authoring import editing
        from ...authoring.editing.draft import color_of
        from ...authoring.editing.replacement import replaced_by, scaled_on_its_foot
        from .query_options import read_picture

        change = self.options.change
        match name:
            case "remove":
                return editing.Remove()
            case "isolate":
                return editing.Isolate()
            case "fill":
                return editing.Fill()
            case "recolour":
                return editing.Recolour(color_of(value), change.amount)
            case "palette":
                return editing.Palette(tuple(color_of(one) for one in value.split(",")))
            case "like_photo":
                return editing.MatchPhoto.of(read_picture(value))
            case "opacity":
                return editing.Opacity(value)
            case "move":
                return editing.Move(tuple(value))
            case "duplicate":
                return editing.Duplicate(tuple(value))
            case "turn":
                return editing.Turn(value, tuple(change.axis or self._needed_up.tolist()))
            case "scale":
                return scaled_on_its_foot(part, value, self._up)
        return replaced_by(part, self._needed_up, value, change.with_object, self.file.path.parent)

    @property
    def _up(self) -> Array | None:
        from ...authoring.filming.looking import named_up

        if self.options.change.up:
            return named_up(self.options.change.up)
        return None if self.posed is None else self.posed.up

    @property
    def _needed_up(self) -> Array:
        """Raises: InputError: nothing tells."""
        if self._up is None:
            raise InputError("nothing tells which way is up: pass up=DIRECTION, e.g. --up +z, or views=CAPTURE")
        return self._up

    # --- annotations ---

    def annotated(self, known: tuple[Annotation, ...], edits: EditList) -> tuple[Annotation, ...]:
        """Return the annotations after some edits, with what the options add and drop.

        New ones are boxes at each match of a query, else at what is edited; where it is after all edits.
        """
        import numpy as np

        from ...formats.annotations import without
        from ...kernels.boxes import box_of
        from ...scene.boxes import solid
        from ...scene.labelled import Annotation

        wanted, given = self.options.listed, self.options.asked
        if wanted.drop_annotation is not None:
            known = without(known, wanted.drop_annotation)
        if wanted.annotate is None:
            if wanted.at is not None:
                raise InputError("--at is for --annotate TEXT: pass both, or none")
            return known
        if wanted.at is not None:
            return (*known, Annotation.at(wanted.annotate, wanted.at))
        draft = self.draft(edits)
        if only_one(given, TARGETS) in QUERIES:
            parts = [one.gaussian_ids for one in self.scene.locate(query_of(given))]
        else:
            parts = [self.target().ids(draft)]
        up = None if self.posed is None else self.posed.up
        wholes = [draft.rows.subset(ids) for ids in parts]
        boxes = [box_of(part, solid(part, np.arange(len(part))), up) for part in wholes]
        return (
            *known,
            *(Annotation.box(wanted.annotate, box.center, box.axes, np.maximum(box.extent, 1e-6)) for box in boxes),
        )

    # --- pictures ---

    def write(self, edits: EditList, after: Gaussians) -> View | None:
        """Write --save and --picture; returns the view that the picture is from."""
        from ... import write_gaussians
        from ...authoring.editing.draft import Draft
        from ...authoring.editing.pictures import before_after
        from ...authoring.editing.targets import Rows
        from ...drawing.pictures import write_picture

        options, last = self.options, edits.active[-1] if edits.active else None
        if options.save:
            write_gaussians(options.save, after, overwrite=options.overwrite, is_edited=True)
        if options.picture is None:
            return None
        scene = self.posed
        if scene is None:
            raise InputError("a picture needs a place to be seen from: pass views=CAPTURE, the photos' poses")
        rows = last.target.ids(Draft.of(self.gaussians)) if last and isinstance(last.target, Rows) else None
        view = scene.view(options.view) if options.view else scene.best_view(rows)
        said = ", ".join(f"{one['do']} {one['of']}" for one in _edits_json(edits)[: edits.done][-2:])
        picture = before_after(self.gaussians, after, view, said, options.threads)
        write_picture(options.picture, picture, options.overwrite)
        return view
