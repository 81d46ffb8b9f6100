"""A scene after its kept edits, with its own rows in front, where they were."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...base.arrays import Bool
from ...formats.scenes import read_gaussians
from ...scene.gaussians import Gaussians
from ..editing import Duplicate, Edit, EditFile, EditList
from ..editing.draft import OBJECT_ID, Draft
from ..editing.edits import drafted


@dataclass(frozen=True, eq=False)
class After:
    """The rows of a scene after a list of edits.

    everything: all rows, those that edits added behind the scene's own, removed ones still in it.

    present: which of them are there. copies: per number of an object that an edit made, that of which it is a copy; -1
    for none.
    """

    everything: Gaussians
    present: Bool[np.ndarray, " d"]
    copies: dict[int, int] = field(default_factory=dict)


def after_edits(gaussians: Gaussians, path: Path | None, listed: EditList) -> After:
    """Return a scene after the edits of a list; without any, its own arrays.

    path: of the scene, which other scenes that edits name lie relative to. Raises: as `authoring.editing.edited`.
    """
    if not listed.active:
        return After(gaussians, np.ones(len(gaussians), bool))
    draft = drafted(gaussians, listed.active, read_gaussians if path is None else EditFile.beside(path).other)
    return After(draft.part(np.arange(len(draft))), draft.present, _copies(draft, listed.active))


def _copies(draft: Draft, edits: Sequence[Edit]) -> dict[int, int]:
    """Return whose copy each object is that an edit added."""
    owners, copies = draft.extra.get(OBJECT_ID), {}
    for edit, (begin, end) in zip(edits, draft.added, strict=True):
        if owners is None or begin == end:
            continue
        source = -1
        if isinstance(edit.change, Duplicate):
            own = owners[edit.target.ids(draft)]
            source = int(np.bincount(own[own >= 0], minlength=1).argmax()) if (own >= 0).any() else -1
        copies[int(owners[begin])] = source
    return copies
