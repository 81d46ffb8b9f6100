"""Texts that people wrote at points and boxes of a scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..base.arrays import Matrix3, Vector3
from ..errors import InputError

MAX_TEXT_CHARACTERS = 200
MAX_COORDINATE = 1e30
ORTHONORMAL_TOLERANCE = 1e-4  # of the axes' lengths and right angles


class Outline(NamedTuple):
    """A box's directions and lengths: row a of axes is the unit direction of the full length extent[a]."""

    axes: Matrix3
    extent: Vector3


@dataclass(frozen=True, eq=False)
class Annotation:
    """A text at a place of the world: at a point, or at a box about it, in scene units.

    outline: of the box, None for a point.

    Raises: InputError: a text that is empty, too long or cannot be written; numbers that are not finite; axes that are
    not at right angles, lengths that are not above 0.
    """

    text: str
    center: Vector3
    outline: Outline | None = None

    @classmethod
    def at(cls, text: str, point: Sequence[int | float] | Vector3) -> "Annotation":
        """Annotate a point."""
        return cls(text.strip(), np.asarray(point, np.float64))

    @classmethod
    def box(
        cls, text: str, center: Vector3, axes: Matrix3,
        extent: Vector3,
    ) -> "Annotation":  # fmt: skip
        """Annotate the box of a match or of an object."""
        return cls(text.strip(), center, Outline(axes, extent))

    def __post_init__(self) -> None:
        writable = self.text == self.text.encode(errors="ignore").decode()
        if not writable or not self.text.strip() or len(self.text) > MAX_TEXT_CHARACTERS:
            raise InputError(
                f"an annotation: expected a text of 1 to {MAX_TEXT_CHARACTERS} characters, got {self.text!a:.80}"
            )
        if self.center.shape != (3,) or not (np.abs(self.center) <= MAX_COORDINATE).all():
            raise InputError(f"annotation '{self.text}': expected a place of three finite numbers")
        if self.outline is not None:
            self._check(*self.outline)

    def _check(self, axes: Matrix3, extent: Vector3) -> None:
        if not ((extent > 0) & (extent <= MAX_COORDINATE)).all():
            raise InputError(f"annotation '{self.text}': expected a box of finite lengths above 0")
        if not np.abs(axes @ axes.T - np.eye(3)).max() <= ORTHONORMAL_TOLERANCE:
            raise InputError(f"annotation '{self.text}': expected axes of length one at right angles")
