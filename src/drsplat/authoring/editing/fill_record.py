"""Record of what a fill did, by row numbers: it is done again from this, without the field or its objects."""

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Spans, Vector3
from ...errors import InputError
from ...formats.json_files import are_rows, count_in, ids_of
from .draft import Draft


@dataclass(frozen=True, eq=False)
class Clones:
    """Rows that are cloned, and by how far the clones are moved, in scene units along the axes of the world.

    Raises: InputError: rows that do not ascend, or none.
    """

    spans: Spans
    by: Vector3

    def __post_init__(self) -> None:
        if not are_rows(self.spans):
            raise InputError("fill: clones: expected ascending rows of the scene, one or more")

    def __len__(self) -> int:
        return count_in(self.spans)


@dataclass(frozen=True, eq=False)
class FillRecord:
    """Rows that a fill removes, possibly none, and those that it clones, in the order in which the clones are added.

    Raises: InputError: removed rows that do not ascend.
    """

    removed: Spans
    clones: tuple[Clones, ...]

    def __post_init__(self) -> None:
        if len(self.removed) and not are_rows(self.removed):
            raise InputError("fill: removed: expected ascending rows of the scene")

    def apply(self, draft: Draft) -> None:
        """Remove and clone the rows. Raises: InputError: rows that are not there, or more than there may be."""
        # Compare all numbers with the draft before any array of their size is made
        spans = (self.removed, *(one.spans for one in self.clones))
        end = max((int(one[-1, 1]) for one in spans if len(one)), default=0)
        if end > len(draft):
            raise InputError(
                f"fill: its record has row {end - 1:,} of a scene of {len(draft):,}: undo this edit and make it anew"
            )
        draft.check_room(sum(map(len, self.clones)))
        draft.present[ids_of(self.removed)] = False
        if self.clones:
            rows = np.concatenate([ids_of(one.spans) for one in self.clones])
            by = np.repeat([one.by for one in self.clones], [len(one) for one in self.clones], axis=0)
            draft.add(draft.rows.subset(rows), by=by)
