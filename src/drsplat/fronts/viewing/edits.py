"""The edits and annotations of a scene on show: beside its file, or in memory where it has none."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...authoring.editing import Edit, EditFile, EditList
from ...authoring.editing.draft import OBJECT_ID
from ...authoring.editing.edits import drafted, recorded
from ...base.arrays import Embedding, Flags, Indices, RowIds, Vectors
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

    @classmethod
    def of(cls, gaussians: Gaussians, listed: EditList, file: EditFile | None) -> "_State":
        """Apply a list of edits to the scene. Raises: as `edited`."""
        if not listed.active:
            return cls(listed, gaussians, np.ones(len(gaussians), bool))
        draft = drafted(gaussians, listed.active, _reader(file))
        return cls(listed, draft.everything(), draft.present)

    @cached_property
    def colors(self) -> Vectors:
        return base_colors(self.everything)

    @cached_property
    def splats(self) -> SplatArrays:
        return splat_arrays(self.everything)


@dataclass(eq=False)
class Notes:
    """Annotations of a scene. notes: where they are kept, None for in memory only."""

    notes: AnnotationFile | None
    annotations: tuple[Annotation, ...]

    @staticmethod
    def beside(scene: Scene) -> tuple[AnnotationFile | None, tuple[Annotation, ...]]:
        """Return the file of a scene's annotations, and what is in it. Raises: FormatError: it is damaged."""
        notes = None if scene.path is None else AnnotationFile.beside(scene.path)
        return notes, () if notes is None else notes.read()

    def annotate(self, *annotations: Annotation) -> None:
        """Keep some more."""
        self.annotations = (*self.annotations, *annotations) if self.notes is None else self.notes.add(annotations)

    def drop(self, number: int) -> None:
        """Drop an annotation, counted from 1. Raises: InputError: there is none."""
        kept = without(self.annotations, number)
        self.annotations = kept if self.notes is None else self.notes.drop(number)


@dataclass(eq=False)
class Edits(Notes):
    """file: where edits are kept, None for in memory only."""

    gaussians: Gaussians
    file: EditFile | None
    _state: _State
    _first: Gaussians
    _standing: Gaussians
    _drawn: tuple[_State, Shown] | None = field(default=None, init=False)
    _rows: tuple[EditList, Shown] | None = field(default=None, init=False)

    @classmethod
    def of(cls, scene: Scene, kept: bool = True) -> "Edits":
        """Make the state of a scene on show, with the edits that are kept beside its file.

        kept: false leaves these out and keeps none that are made here.

        Raises: FormatError, MismatchError: their files are damaged, or of another scene.
        """
        gaussians = scene.gaussians
        if scene.field.objects:
            gaussians = replace(gaussians, extra={**gaussians.extra, OBJECT_ID: scene.object_ids()})
        file = EditFile.beside(scene.path) if scene.path is not None and kept else None
        listed = EditList(gaussians.fingerprint) if file is None else file.read(gaussians)
        first = _State.of(gaussians, listed, file)
        return cls(*cls.beside(scene), gaussians, file, first, scene.gaussians, scene.gaussians)

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

    def take(self, other: "Edits") -> None:
        """Take the list of a copy, and what it makes; annotations stay."""
        self._standing, self._state, self._drawn, self._rows = other._standing, other._state, other._drawn, other._rows

    def _made(self, listed: EditList) -> _State:
        return _State.of(self._now, listed, self.file)

    @property
    def _now(self) -> Gaussians:
        """The scene's own rows before all edits, where they are now, with the objects of the field."""
        return replace(self._standing, extra=self.gaussians.extra)

    # --- changing ---

    def add(self, edit: Edit) -> None:
        """Do one more. Raises: InputError: it cannot be done."""
        self._change(lambda listed: recorded(self._now, listed.with_edit(edit), _reader(self.file)))

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
        made: list[_State] = []

        def tried(listed: EditList) -> EditList:
            made.append(self._made(change(listed)))
            return made[-1].listed

        if self.file is None:
            tried(self.listed)
        else:
            self.file.change(self.gaussians, tried)
        self._state = made[-1]

    # --- what it makes ---

    @property
    def present(self) -> Flags:
        """True for each of the scene's own rows that edits have not removed."""
        return self._state.present[: len(self.gaussians)]

    @property
    def opacities(self) -> Embedding:
        """Opacities of all rows, added ones behind the scene's own; 0 where removed."""
        return self._state.everything.opacities

    @property
    def colors(self) -> Vectors:
        """Colours of the scene's own rows, without what depends on the direction of view."""
        return self._state.colors[: len(self.gaussians)]

    @property
    def added_colors(self) -> Vectors:
        return self._state.colors[len(self.gaussians) :]

    @property
    def splats(self) -> SplatArrays:
        """All rows, as the renderer takes them."""
        return self._state.splats

    @property
    def standing(self) -> Gaussians:
        """The scene's own rows, where they are now."""
        every = self._state.everything
        return every.subset(np.arange(len(self.gaussians))) if len(every) > len(self.gaussians) else every

    def part(self, ids: RowIds | None) -> tuple[Gaussians, Indices]:
        """Return some rows as they are now, or all that are there, and their numbers."""
        rows = np.flatnonzero(self._state.present) if ids is None else ids
        every = self._state.everything
        return every if len(rows) == len(every) else every.subset(rows), rows

    def shown(self, before: Shown, budget: int) -> Shown:
        """Return what a browser draws of the edited scene, in the frame of what it drew before."""
        if not self.is_edited and self._standing is self._first:
            return before
        if self._drawn is None or self._drawn[0] is not self._state:
            self._drawn = (self._state, moved_shown(self._chosen(before, budget), self._state.everything))
        return self._drawn[1]

    def _chosen(self, before: Shown, budget: int) -> Shown:
        """Return the rows that a browser draws, the same ones at all times, so that it only moves them."""
        if not self.is_edited:
            return before
        if self._rows is None or self._rows[0] is not self.listed:
            self._rows = (self.listed, shown_of(self._state.everything, budget, before.frame))
        return self._rows[1]


def _reader(file: EditFile | None) -> Callable[[str], Gaussians]:
    """Return what reads the scenes that edits name, whose paths begin at the list's folder."""
    return read_gaussians if file is None else file.other
