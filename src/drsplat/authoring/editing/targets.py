"""Targets of edits: rows that somebody named, the inside of a box, what an earlier edit added, or everything.

Words, objects and labels are turned into rows once, when the edit is made: later fields, encoders and thresholds change
nothing about it.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ...base.arrays import Matrix3, RowIds, Spans, Vector3
from ...errors import InputError
from ...formats.json_files import are_rows, count_in, ids_of, is_text, spans_of
from .draft import Draft

Named = Literal["object", "label", "query", "rows"]
NAMED: tuple[Named, ...] = get_args(Named)
MAX_NAME_CHARACTERS = 400


@dataclass(frozen=True, eq=False)
class Rows:
    """spans: rows of the scene, or that edits added, from the first number of a pair to before the second, ascending.

    kind, name: what a person said that they are: object 7, a label, a query in words, or just rows.

    Raises: InputError: no rows, another kind, or a name that cannot be written.
    """

    kind: Named
    name: str
    spans: Spans

    @classmethod
    def of(cls, ids: RowIds, kind: Named = "rows", name: str = "") -> "Rows":
        return cls(kind, name, spans_of(np.unique(ids)))

    def __post_init__(self) -> None:
        if self.kind not in NAMED or not is_text(self.name) or len(self.name) > MAX_NAME_CHARACTERS:
            raise InputError(
                f"rows: expected one of {', '.join(NAMED)} and up to {MAX_NAME_CHARACTERS} characters, "
                f"got {self.kind!a:.40}"
            )
        if not are_rows(self.spans):
            raise InputError(f"{self}: expected ascending rows of a scene, one or more")

    def __str__(self) -> str:
        return {"object": f"object {self.name}", "rows": f"{len(self):,} rows"}.get(self.kind, f"“{self.name}”")

    def __len__(self) -> int:
        return count_in(self.spans)

    def ids(self, draft: Draft) -> RowIds:
        """Return the rows that are there. Raises: InputError: numbers that no row has."""
        if int(self.spans[-1, 1]) > len(draft):
            raise InputError(f"{self}: has row {self.spans[-1, 1] - 1:,} of a scene of {len(draft):,}")
        return ids_of(self.spans)


@dataclass(frozen=True, eq=False)
class Box:
    """The inside of an oriented box when the edit is done.

    Row a of axes is the unit direction of full length extent[a].

    Raises: InputError: numbers that are not finite, lengths not above 0, or axes at no right angles.
    """

    center: Vector3
    axes: Matrix3
    extent: Vector3

    def __post_init__(self) -> None:
        if not (np.isfinite(self.center).all() and np.isfinite(self.extent).all() and (self.extent > 0).all()):
            raise InputError("a box: expected a finite center and lengths above 0")
        if not np.abs(self.axes @ self.axes.T - np.eye(3)).max() < 1e-4:
            raise InputError("a box: expected axes of length one at right angles")

    def __str__(self) -> str:
        return "the box at " + " ".join(f"{x:.2f}" for x in self.center)

    def ids(self, draft: Draft) -> RowIds:
        away = draft.rows.means.astype(np.float64) + (draft.rows.origin - self.center)
        inside = (np.abs(np.einsum("ni,ai->na", away, self.axes)) <= self.extent / 2).all(1)
        return np.flatnonzero(inside & draft.present)


@dataclass(frozen=True)
class Copies:
    """Rows that an earlier edit added, by its number, counted from 1."""

    edit: int

    def __str__(self) -> str:
        return f"what edit {self.edit} added"

    def ids(self, draft: Draft) -> RowIds:
        """Return the rows. Raises: InputError: there is no such edit before this one, or it added nothing."""
        first, last = draft.added[self.edit - 1] if 1 <= self.edit <= len(draft.added) else (0, 0)
        if first == last:
            raise InputError(f"edit {self.edit} added nothing: duplicate, replace and fill do")
        return np.arange(first, last, dtype=np.int64)


@dataclass(frozen=True)
class Everything:
    """All that is there."""

    def __str__(self) -> str:
        return "everything"

    def ids(self, draft: Draft) -> RowIds:
        return np.flatnonzero(draft.present)


Target = Rows | Box | Copies | Everything
