"""The hole that a removal leaves: ground and wall Gaussians cloned from beside it, along their plane."""

from dataclasses import dataclass, replace

import numpy as np

from ...base.arrays import Int64
from ...errors import InputError
from .draft import Draft
from .fill_record import FIRST_RECORDED_VERSION, FillRecord

VERSIONS = (1, 2, 3, 4)
Ids = Int64[np.ndarray, " m"]


@dataclass(frozen=True)
class Fill:
    """Change that clones what is missing where rows stood at first from the planes that they stood on or before.

    A table goes on below a vase, a floor and a wall behind a shelf; what training left there unseen goes. Nothing is
    made up: no edge, no pattern with a place of its own; shadows and reflections stay, and what no plane holds is open.

    version: 2 clones nothing that lies on the plane or stands out from it, and by the shift with the best seam; 3 also
    lets other things in the hole be, such as what stands below a table; 4 closes more of the hole, leaves no specks
    where it can close little, takes what stands off the plane in the thing's place, and is stored with its record; 1 is
    what lists of edits without a version mean, and does none of it.

    record: what it does, None where that is still to be computed, from the scene and the objects at hand.

    Raises: InputError: another version, or a record of an earlier one.
    """

    version: int = VERSIONS[-1]
    record: FillRecord | None = None

    def __post_init__(self) -> None:
        if self.version not in VERSIONS:
            raise InputError(f"fill: expected version 1 to 4, got {self.version}: a newer drsplat may know it")
        if self.record is not None and self.version < FIRST_RECORDED_VERSION:
            raise InputError(f"fill: version {self.version} has no record: leave it out, or give version 4")

    @property
    def lacks_record(self) -> bool:
        """True if this version is stored with a record, and there is none yet."""
        return self.record is None and self.version >= FIRST_RECORDED_VERSION

    def apply(self, draft: Draft, ids: Ids) -> None:
        """Close the hole that the target leaves. Raises: InputError: as `recorded`, or a record that does not fit."""
        (self.record or self._computed(draft, ids)).apply(draft)

    def recorded(self, draft: Draft, ids: Ids) -> "Fill":
        """Return this change with the record of what it does to a draft, which stays as it is.

        Raises: InputError: too few rows to leave a hole, or no plane was found. Warns: DrSplatWarning: a hole that
        could be closed in part only.
        """
        return replace(self, record=self._computed(draft, ids))

    def _computed(self, draft: Draft, ids: Ids) -> FillRecord:
        from .closing import closing  # with it comes much of SciPy, which a list of edits does without

        return closing(draft, ids, self.version)
