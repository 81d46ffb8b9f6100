"""The edits and annotations of a scene on show: beside its file, or in memory where it has none."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...authoring.editing import Edit, EditFile, EditList
from ...authoring.editing.draft import OBJECT_ID
from ...authoring.editing.edits import drafted, recorded
from ...base.arrays import Flags, Indices, RowIds, Vectors
from ...formats.annotations import AnnotationFile, without
from ...formats.scenes import read_gaussians
from ...kernels import SplatArrays, splat_arrays
from ...query import Scene
from ...scene.gaussians import Gaussians
from ...scene.labelled import Annotation
from .shown import Shown, base_colors, moved_shown, shown_of


@dataclass(frozen=True, eq=False)
class _State:
    """Scene after one list of edits.

    everything: all rows, those that edits added last; removed ones are not present, and have opacity 0.
    """

    listed: EditList
    everything: Gaussians
    present: Flags

    @cached_property
    def colors(self) -> Vectors:
        return base_colors(self.everything)

    @cached_property
    def splats(self) -> SplatArrays:
        return splat_arrays(self.everything)


class Notes:
    """Annotations of a scene: beside its file, or in memory. Raises: FormatError: the file is damaged."""

    def __init__(self, scene: Scene) -> None:
        self.notes = None if scene.path is None else AnnotationFile.beside(scene.path)
        self.annotations = () if self.notes is None else self.notes.read()

    def annotate(self, *annotations: Annotation) -> None:
        """Keep some more."""
        self.annotations = (*self.annotations, *annotations) if self.notes is None else self.notes.add(annotations)

    def drop(self, number: int) -> None:
        """Drop an annotation, counted from 1. Raises: InputError: there is none."""
        kept = without(self.annotations, number)
        self.annotations = kept if self.notes is None else self.notes.drop(number)

    def take(self, other: "Notes") -> None:
        """Take the edits of a copy, and what they make; annotations stay."""
        vars(self).update(vars(other) | {"annotations": self.annotations})


class Edits(Notes):
    """Edits of a scene on show, and the scene after them, at the time that is shown.

    kept: whether they are those kept beside the scene's file; else none are done at first, and none are kept.

    Raises: FormatError, MismatchError: the files are damaged, or of another scene.
    """

    def __init__(self, scene: Scene, kept: bool = True) -> None:
        super().__init__(scene)
        self._first = self._standing = self.gaussians = scene.gaussians
        if scene.field.objects:
            extra = {**self.gaussians.extra, OBJECT_ID: scene.object_ids()}
            self.gaussians = replace(self.gaussians, extra=extra)
        self.file = EditFile.beside(scene.path) if scene.path is not None and kept else None
        listed = EditList(self.gaussians.fingerprint) if self.file is None else self.file.read(self.gaussians)
        self._state = self._made(listed)
        self._drawn: tuple[_State, Shown] | None = None
        self._rows: tuple[EditList, Shown] | None = None

    @property
    def listed(self) -> EditList:
        return self._state.listed

    @property
    def is_edited(self) -> bool:
        return self.listed.done > 0

    def stand(self, gaussians: Gaussians) -> None:
        """Do them to the scene's rows as they are at another time."""
        if gaussians is not self._standing:
            self._standing = gaussians
            self._state = self._made(self.listed)

    def _made(self, listed: EditList) -> _State:
        """Apply a list of edits to the scene. Raises: as `drafted`."""
        if not listed.active:
            return _State(listed, self._now, np.ones(len(self.gaussians), bool))
        draft = drafted(self._now, listed.active, self._other)
        return _State(listed, draft.everything(), draft.present)

    @property
    def _now(self) -> Gaussians:
        """The scene's own rows before all edits, where they are now, with the objects of the field."""
        return replace(self._standing, extra=self.gaussians.extra)

    def _other(self, path: str) -> Gaussians:
        """Read a scene that an edit names; paths begin at the list's folder."""
        return read_gaussians(path) if self.file is None else self.file.other(path)

    # --- changing ---

    def add(self, edit: Edit) -> None:
        """Do one more. Raises: InputError: it cannot be done."""
        self._change(lambda listed: recorded(self._now, listed.with_edit(edit), self._other))

    def undo(self, count: int = 1) -> None:
        """Undo the last edits. Raises: InputError: there is nothing to undo."""

        def undone(listed: EditList) -> EditList:
            for _ in range(count):
                listed = listed.undone()
            return listed

        self._change(undone)

    def redo(self) -> None:
        """Do the next edit again. Raises: InputError: nothing was undone."""
        self._change(EditList.redone)

    def _change(self, change: Callable[[EditList], EditList]) -> None:
        """Change the list of edits, and keep what `drsplat edit` has added to it meanwhile."""
        state = self._state

        def tried(listed: EditList) -> EditList:
            nonlocal state
            state = self._made(change(listed))
            return state.listed

        if self.file is None:
            tried(self.listed)
        else:
            self.file.change(self.gaussians, tried)
        self._state = state

    # --- what it makes ---

    @property
    def present(self) -> Flags:
        """True for each of the scene's own rows that edits have not removed."""
        return self._state.present[: len(self.gaussians)]

    @property
    def everything(self) -> Gaussians:
        """All rows, those that edits added behind the scene's own; the opacity of removed ones is 0."""
        return self._state.everything

    @property
    def colors(self) -> Vectors:
        """Colours of all rows, without what depends on the direction of view."""
        return self._state.colors

    @property
    def splats(self) -> SplatArrays:
        """All rows, as the renderer takes them."""
        return self._state.splats

    @property
    def standing(self) -> Gaussians:
        """The scene's own rows, where they are now."""
        own = len(self.gaussians)
        return self.everything.subset(np.arange(own)) if len(self.everything) > own else self.everything

    def part(self, ids: RowIds | None) -> tuple[Gaussians, Indices]:
        """Return some rows as they are now, or all that are there, and their numbers."""
        rows = np.flatnonzero(self._state.present) if ids is None else ids
        return self.everything if len(rows) == len(self.everything) else self.everything.subset(rows), rows

    def shown(self, before: Shown, budget: int) -> Shown:
        """Return what a browser draws of the edited scene, in the frame of what it drew before.

        The rows are the same ones at all times, so that it only moves them.
        """
        if not self.is_edited and self._standing is self._first:
            return before
        if self._drawn is None or self._drawn[0] is not self._state:
            if self.is_edited and (self._rows is None or self._rows[0] is not self.listed):
                self._rows = self.listed, shown_of(self.everything, budget, before.frame)
            rows = self._rows[1] if self.is_edited and self._rows else before
            self._drawn = self._state, moved_shown(rows, self.everything)
        return self._drawn[1]
