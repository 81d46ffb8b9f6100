"""A list of edits, the scene that it makes, and the list as JSON beside that: NAME.edits.json of NAME.ply.

It is read strictly: it may be a stranger's.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...base.contents import AnyPath
from ...errors import DrSplatError, FormatError, InputError, MismatchError
from ...formats.json_files import (
    as_count,
    as_document,
    as_list,
    as_matrix,
    as_number,
    as_object,
    as_text,
    as_vector,
    excerpt,
    read_json,
    runs_of,
    spans_of_runs,
)
from ...formats.replacing import claimed_output, replacing
from ...formats.scenes import companion, read_gaussians
from ...scene.gaussians import Gaussians
from ...scene.parted import AnyGaussians
from .draft import Draft, Duplicate, Isolate, MatchPhoto, Move, Opacity, Palette, Recolour, Remove, Scale, Turn
from .fill_record import Clones, FillRecord
from .filling import Fill
from .replacement import Replace
from .targets import NAMED, Box, Copies, Everything, Rows, Target

Change = Remove | Isolate | Opacity | Move | Turn | Scale | Duplicate | Recolour | Palette | MatchPhoto | Replace | Fill
MAX_EDITS = 1000  # of a list


@dataclass(frozen=True, eq=False)
class Edit:
    """One change, and what it is done to."""

    target: Target
    change: Change

    def apply(self, draft: Draft) -> None:
        """Apply this edit to a draft. Raises: InputError: rows that are not there, or the change's own reasons."""
        before = len(draft)
        self.change.apply(draft, self.target.ids(draft))
        draft.added.append((before, len(draft)) if len(draft) > before else (0, 0))


@dataclass(frozen=True, eq=False)
class EditList:
    """scene: fingerprint of the Gaussians that are edited. done: how many of the edits are; later ones were undone.

    Raises: InputError: more than 1,000 edits, or more done than there are.
    """

    scene: str
    edits: tuple[Edit, ...] = ()
    done: int = 0

    def __post_init__(self) -> None:
        if len(self.edits) > MAX_EDITS or not 0 <= self.done <= len(self.edits):
            raise InputError(f"expected up to {MAX_EDITS:,} edits, {self.done} of {len(self.edits)} done")

    @property
    def active(self) -> tuple[Edit, ...]:
        """Those that are done."""
        return self.edits[: self.done]

    def with_edit(self, edit: Edit) -> "EditList":
        """Add an edit after those that are done; what was undone is forgotten."""
        return EditList(self.scene, (*self.active, edit), self.done + 1)

    def undone(self) -> "EditList":
        """Return the list with its last edit undone. Raises: InputError: there is none."""
        if not self.done:
            raise InputError("there is no edit to undo")
        return replace(self, done=self.done - 1)

    def redone(self) -> "EditList":
        """Return the list with the next edit done again. Raises: InputError: nothing was undone."""
        if self.done == len(self.edits):
            raise InputError("there is no edit to redo")
        return replace(self, done=self.done + 1)


def edited(
    gaussians: Gaussians, edits: Sequence[Edit], *, read: Callable[[str], Gaussians] = read_gaussians
) -> Gaussians:
    """Return the scene after some edits, the scene itself after none.

    The bits are the same for the same input, whatever was undone meanwhile.

    Rows that are left stand in their order, with what edits added behind them; those that no edit was done to have
    their own bits. A column `object_id` of `gaussians.extra` goes along: copies are objects of their own. read: gives
    the scenes that objects are replaced from, by the path in the edit.

    Raises: InputError: an edit that cannot be done; the message says which. MismatchError: another scene to replace
    from than was meant.
    """
    if not edits:
        return gaussians
    draft = drafted(gaussians, edits, read)
    return draft.rows.subset(draft.present)


def drafted(gaussians: Gaussians, edits: Sequence[Edit], read: Callable[[str], Gaussians] = read_gaussians) -> Draft:
    """Apply edits, and keep removed rows and the numbers of added ones; see `edited`. Raises: as `edited`."""
    draft = Draft.of(gaussians, read)
    for number, edit in enumerate(edits, start=1):
        with _numbered(number):  # what becomes no number is refused below
            edit.apply(draft)
    if not draft.is_sound:
        raise InputError("these edits move or stretch something beyond all numbers that a scene can hold: undo some")
    return draft


def recorded(
    gaussians: Gaussians, listed: EditList, read: Callable[[str], Gaussians] = read_gaussians
) -> EditList:  # fmt: skip
    """Return a list whose new fills have their records, so that it makes the same scene whatever is at hand later.

    Edits that were undone stay as they are. gaussians, read: as of `edited`, with the
    column `object_id` where objects are known.

    Raises: as `edited`. Warns: as `Fill.computed`.
    """
    edits = list(listed.edits)
    for place, edit in enumerate(listed.active):
        if isinstance(edit.change, Fill) and edit.change.record is None:
            draft = drafted(gaussians, edits[:place], read)
            with _numbered(place + 1):
                record = edit.change.computed(draft, edit.target.ids(draft))
                edits[place] = Edit(edit.target, replace(edit.change, record=record))
    return listed if edits == list(listed.edits) else replace(listed, edits=tuple(edits))


@contextmanager
def _numbered(number: int) -> Iterator[None]:
    """Name the edit in errors that the block raises, and let its numbers overflow in silence."""
    try:
        with np.errstate(all="ignore"):
            yield
    except InputError as error:
        raise InputError(f"edit {number}: {error}") from error


FORMAT, VERSION = "drsplat edits", 1
PATIENCE_S = 10.0  # for another process that writes
Read = Callable[[object, str], Any]


@dataclass(frozen=True)
class EditFile:
    """The edits of a scene. Every change is whole or not at all, and one writer's at a time."""

    path: Path

    @classmethod
    def beside(cls, scene: AnyPath) -> "EditFile":
        """Return the file of a scene's edits: NAME.edits.json beside NAME.ply or the folder NAME."""
        return cls(companion(scene, "edits"))

    def read(self, scene: AnyGaussians) -> EditList:
        """Read the edits of a scene; none where there is no file.

        Raises: FormatError: the file is damaged, or written by a newer version. MismatchError: it is of another scene.
        """
        listed = self._listed()
        if listed is None:
            return EditList(scene.fingerprint)
        if listed.scene != scene.fingerprint:
            raise MismatchError(
                f"{self.path}: these edits are of another scene, {excerpt(listed.scene)}; this one is "
                f"{scene.fingerprint}. Move the file away to edit this one"
            )
        return listed

    def _listed(self) -> EditList | None:
        return edits_of(read_json(self.path), str(self.path)) if self.path.exists() else None

    def num_done(self, scene: AnyGaussians | None = None) -> int:
        """Return how many edits are kept and done, of a scene or of whichever is there; 0 where the list is damaged."""
        try:
            listed = self._listed() if scene is None else self.read(scene)
        except DrSplatError:
            return 0
        return 0 if listed is None else listed.done

    def change(self, scene: Gaussians, change: Callable[[EditList], EditList]) -> EditList:
        """Put another list in place of that which is there, and return it as stored, with the records of its fills.

        What `change` raises leaves the file as it was. scene: with the column `object_id`, new fills heed the objects.

        Raises: InputError: another process writes the file, or it cannot be written; as `read` and `recorded`.
        """
        with self.held():
            listed = recorded(scene, change(self.read(scene)), self.other)
            self.write(listed)
        return listed

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep others from writing it while the block runs. Raises: InputError: another process does."""
        with claimed_output(self.path, PATIENCE_S):
            yield

    def write(self, listed: EditList) -> None:
        """Write the edit list atomically; the caller must hold the file.

        Raises: InputError: it cannot be written, or a fill lacks its record, which `recorded` makes.
        """
        text = json.dumps(document_of(listed), ensure_ascii=False, separators=(",", ":"))
        with replacing(self.path, overwrite=True) as file:
            file.write(f"{text}\n".encode())

    def edited(self, scene: Gaussians, listed: EditList) -> Gaussians:
        """Return the edited scene; scenes it names are read from where the file is. Raises: as `edited`."""
        return edited(scene, listed.active, read=self.other)

    def other(self, path: str) -> Gaussians:
        """Read a scene that an edit names, from the folder of this file."""
        return read_gaussians(self.path.parent / path)


def document_of(listed: EditList) -> dict[str, object]:
    """Return a list of edits as the JSON document that is stored."""
    edits = [{"of": _target_json(edit.target), **_change_json(edit.change)} for edit in listed.edits]
    return {"format": FORMAT, "version": VERSION, "scene": listed.scene, "done": listed.done, "edits": edits}


def edits_of(document: object, where: str) -> EditList:
    """Return the edits in a stored document. Raises: FormatError: no such document, or an edit that there is not."""
    document = as_document(document, where, FORMAT, VERSION)
    _only(document, ("format", "version", "scene", "done", "edits"), where)
    scene, edits = document.get("scene"), document.get("edits")
    if not isinstance(scene, str) or not isinstance(edits, list) or len(edits) > MAX_EDITS:
        raise FormatError(f"{where}: expected the fingerprint of a scene and a list of up to {MAX_EDITS:,} edits")
    try:
        read = tuple(_edit(entry, f"{where}: edit {number}") for number, entry in enumerate(edits, start=1))
        return EditList(scene, read, as_count(document.get("done"), f"{where}: done"))
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _edit(entry: object, where: str) -> Edit:
    values = dict(as_object(entry, where))
    kind, target = values.pop("do", None), values.pop("of", None)
    if not isinstance(kind, str) or kind not in _CHANGES:
        raise FormatError(f"{where}: do: expected one of {', '.join(_CHANGES)}; got {excerpt(kind)}")
    made, readers = _CHANGES[kind]
    _only(values, readers, where)
    missing = [one.name for one in fields(made) if one.default is MISSING and one.name not in values]
    if missing:
        raise FormatError(f"{where}: {missing[0]} is missing")
    try:
        read = {name: readers[name](value, f"{where}: {name}") for name, value in values.items()}
        change = made(**read)
        if isinstance(change, Fill) and change.record is None:
            raise FormatError(f"{where}: record is missing: expected what this fill removes and clones")
        return Edit(_target(target, f"{where}: of"), change)
    except InputError as error:
        raise FormatError(f"{where}: {error}") from error


def _only(entry: Mapping[str, object], known: Mapping[str, object] | tuple[str, ...], where: str) -> None:
    unknown = [name for name in entry if name not in known]
    if unknown:
        raise FormatError(f"{where}: {excerpt(unknown[0])} is not known; expected {', '.join(known) or 'nothing more'}")


# --- what an edit is done to ---


def _target(entry: object, where: str) -> Target:
    entry = as_object(entry, where)
    kind = entry.get("kind")
    if not isinstance(kind, str) or kind not in _TARGETS:
        raise FormatError(f"{where}: expected a kind, one of {', '.join(_TARGETS)}; got {excerpt(kind)}")
    keys, made = _TARGETS[kind]
    _only(entry, ("kind", *keys), where)
    return made(entry, where)


def _rows(entry: dict[str, object], where: str) -> Rows:
    name = as_text(entry.get("name", ""), f"{where}: name")
    return Rows(entry["kind"], name, spans_of_runs(entry.get("runs"), f"{where}: runs"))  # type: ignore[arg-type]


def _box(entry: dict[str, object], where: str) -> Box:
    center, extent = (as_vector(entry.get(name), 3, f"{where}: {name}") for name in ("center", "extent"))
    axes = as_matrix(entry["axes"], 3, 3, f"{where}: axes") if "axes" in entry else np.eye(3)
    return Box(center, axes, extent)


_TARGETS: dict[str, tuple[tuple[str, ...], Callable[[dict[str, object], str], Target]]] = {
    **dict.fromkeys(NAMED, (("name", "runs"), _rows)),
    "box": (("center", "axes", "extent"), _box),
    "copies": (("edit",), lambda entry, where: Copies(as_count(entry.get("edit"), f"{where}: edit"))),
    "everything": ((), lambda entry, where: Everything()),
}


def _target_json(target: Target) -> dict[str, object]:
    match target:
        case Rows():
            return {"kind": target.kind, "name": target.name, "runs": runs_of(target.spans)}
        case Box():
            return {"kind": "box"} | {name: getattr(target, name).tolist() for name in ("center", "axes", "extent")}
        case Copies():
            return {"kind": "copies", "edit": target.edit}
        case Everything():
            return {"kind": "everything"}


# --- what is done ---


def _point(value: object, where: str) -> np.ndarray:
    return as_vector(value, 3, where)


def _triple(value: object, where: str) -> tuple[float, ...]:
    return tuple(_point(value, where).tolist())


def _square(side: int) -> Read:
    return lambda value, where: as_matrix(value, side, side, where)


def _colors(value: object, where: str) -> tuple[tuple[float, ...], ...]:
    return tuple(_triple(color, where) for color in as_list(value, where))


def _record(value: object, where: str) -> FillRecord:
    if not isinstance(value, dict) or not isinstance(value.get("clones"), list):
        raise FormatError(f"{where}: expected an object with removed and a list of clones, got {excerpt(value)}")
    _only(value, ("removed", "clones"), where)
    clones = (_clones(entry, f"{where}: clones {number}") for number, entry in enumerate(value["clones"], start=1))
    return FillRecord(spans_of_runs(value.get("removed"), f"{where}: removed"), tuple(clones))


def _clones(entry: object, where: str) -> Clones:
    if not isinstance(entry, dict):
        raise FormatError(f"{where}: expected an object with runs and by, got {excerpt(entry)}")
    _only(entry, ("runs", "by"), where)
    return Clones(spans_of_runs(entry.get("runs"), f"{where}: runs"), _point(entry.get("by"), f"{where}: by"))


_CHANGES: dict[str, tuple[type[Change], dict[str, Read]]] = {
    "remove": (Remove, {}),
    "isolate": (Isolate, {}),
    "opacity": (Opacity, {"factor": as_number}),
    "move": (Move, {"by": _triple}),
    "turn": (Turn, {"degrees": as_number, "axis": _triple, "about": _triple}),
    "scale": (Scale, {"factor": as_number, "about": _triple}),
    "duplicate": (Duplicate, {"by": _triple}),
    "recolour": (Recolour, {"color": _triple, "amount": as_number}),
    "palette": (Palette, {"colors": _colors}),
    "match photo": (MatchPhoto, {"mean": _point, "covariance": _square(3)}),
    "replace": (Replace, {"scene": as_text, "fingerprint": as_text, "matrix": _square(4), "spans": spans_of_runs}),
    "fill": (Fill, {"version": as_count, "record": _record}),
}
NAMES = {made: name for name, (made, _) in _CHANGES.items()}


def _change_json(change: Change) -> dict[str, object]:
    name = NAMES[type(change)]
    values = {key: getattr(change, key) for key in _CHANGES[name][1]}
    if isinstance(change, Replace) and change.spans is not None:
        values["spans"] = runs_of(change.spans)
    if isinstance(change, Fill):
        if change.record is None:
            raise InputError("fill: its record is missing: store the list with EditFile.change, which makes it")
        clones = [{"by": one.by.tolist(), "runs": runs_of(one.spans)} for one in change.record.clones]
        values["record"] = {"removed": runs_of(change.record.removed), "clones": clones}
    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}
    return {"do": name} | {key: value for key, value in plain.items() if value is not None}


KeptEdits = Literal["kept", "none"]


def without_kept(choice: KeptEdits | None, *, changes: bool, saves: bool) -> bool:
    """Return whether a call leaves out the edits that are kept beside the scene, and keeps none of its own.

    What only shows a scene, or saves it, applies the kept edits. A change that is saved is done to the scene's own
    file: the output has what this call asked for, and the kept list stays as it was.

    Args:
        choice: what was asked for; None where nothing was.
        changes: whether the call makes edits.
        saves: whether it writes the edited scene.

    Raises: InputError: edits that would go nowhere.
    """
    if choice == "none" and changes and not saves:
        raise InputError("edits: 'none' keeps no change beside the scene, and no output is named: pass save=OUT.ply")
    return choice == "none" or (choice is None and changes and saves)
