"""A list of edits, and the scene that it makes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...formats.scenes import read_gaussians
from ...scene.gaussians import Gaussians
from .changes import Duplicate, Isolate, Move, Opacity, Remove, Scale, Turn
from .colouring import MatchPhoto, Palette, Recolour
from .draft import Draft
from .filling import Fill
from .replacement import Replace
from .targets import Target

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
    return drafted(gaussians, edits, read).gaussians() if edits else gaussians


def drafted(
    gaussians: Gaussians, edits: Sequence[Edit], read: Callable[[str], Gaussians] = read_gaussians
) -> Draft:  # fmt: skip
    """Apply edits, and keep removed rows and the numbers of added ones; see `edited`. Raises: as `edited`."""
    draft = Draft.of(gaussians)
    draft.read = read
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

    Raises: as `edited`. Warns: as `Fill.recorded`.
    """
    edits = list(listed.edits)
    for place, edit in enumerate(listed.active):
        if isinstance(edit.change, Fill) and edit.change.record is None:
            draft = drafted(gaussians, edits[:place], read)
            with _numbered(place + 1):
                edits[place] = Edit(edit.target, edit.change.recorded(draft, edit.target.ids(draft)))
    return listed if edits == list(listed.edits) else replace(listed, edits=tuple(edits))


@contextmanager
def _numbered(number: int) -> Iterator[None]:
    """Name the edit in errors that the block raises, and let its numbers overflow in silence."""
    try:
        with np.errstate(all="ignore"):
            yield
    except InputError as error:
        raise InputError(f"edit {number}: {error}") from error
