"""The hole that a removal leaves: ground and wall Gaussians cloned from beside it, along their plane."""

from dataclasses import dataclass

from ...base.arrays import RowIds
from ...errors import InputError
from .draft import Draft
from .fill_record import FillRecord

VERSION = 4


@dataclass(frozen=True)
class Fill:
    """Change that clones what is missing where rows stood at first from the planes that they stood on or before.

    A table goes on below a vase, a floor and a wall behind a shelf; what training left there unseen goes. Nothing is
    made up: no edge, no pattern with a place of its own; shadows and reflections stay, and what no plane holds is open.

    version: of the rules, of which there is one.
    record: what it does, None where that is still to be computed, from the scene and the objects at hand.

    Raises: InputError: another version.
    """

    version: int = VERSION
    record: FillRecord | None = None

    def __post_init__(self) -> None:
        if self.version != VERSION:
            raise InputError(f"fill: expected version {VERSION}, got {self.version}: undo it, and fill anew")

    def apply(self, draft: Draft, ids: RowIds) -> None:
        """Close the hole that the target leaves. Raises: InputError: as `computed`, or a record that does not fit."""
        (self.record or self.computed(draft, ids)).apply(draft)

    def computed(self, draft: Draft, ids: RowIds) -> FillRecord:
        """Return the record of what this change does to a draft, which stays as it is.

        Raises: InputError: too few rows to leave a hole, or no plane was found. Warns: DrSplatWarning: a hole that
        could be closed in part only.
        """
        from .closing import closing  # with it comes much of SciPy, which a list of edits does without

        return closing(draft, ids)
