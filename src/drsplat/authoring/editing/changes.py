"""Changes of rows of a scene in all but colour: whether they are there, and where."""

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Float64, Ids, Matrix3
from ...errors import InputError
from ...scene.boxes import solid
from ...scene.gaussians import Gaussians
from ...scene.similarity import Similarity
from .draft import Draft

Number = int | float
Vector = tuple[Number, Number, Number]
MAX_FACTOR_OR_DEGREES = 1e6


@dataclass(frozen=True)
class Remove:
    """Not there any more."""

    def apply(self, draft: Draft, ids: Ids) -> None:
        draft.present[ids] = False


@dataclass(frozen=True)
class Isolate:
    """Nothing but these."""

    def apply(self, draft: Draft, ids: Ids) -> None:
        kept = draft.present[ids]
        draft.present[:] = False
        draft.present[ids] = kept


@dataclass(frozen=True)
class Opacity:
    """Times `factor`, up to opaque. Raises: InputError: below 0."""

    factor: Number

    def __post_init__(self) -> None:
        if not 0 <= self.factor <= MAX_FACTOR_OR_DEGREES:
            raise InputError(f"opacity: expected a factor of 0 or more, got {self.factor:g}")

    def apply(self, draft: Draft, ids: Ids) -> None:
        draft.opacities[ids] = np.minimum(draft.opacities[ids] * np.float32(self.factor), np.float32(1))


@dataclass(frozen=True)
class Move:
    """by: in scene units, along the axes of the world."""

    by: Vector

    def apply(self, draft: Draft, ids: Ids) -> None:
        draft.shift(ids, self.by)


@dataclass(frozen=True)
class Turn:
    """By an angle about an axis, right-handed, through `about`; None: the middle of what is turned.

    Raises: InputError: an axis without a direction, or more than a million degrees.
    """

    degrees: Number
    axis: Vector
    about: Vector | None = None

    def __post_init__(self) -> None:
        if not max(map(abs, self.axis)) > 0:
            raise InputError(f"turn: expected an axis with a direction, got {self.axis}")
        if not abs(self.degrees) <= MAX_FACTOR_OR_DEGREES:
            raise InputError(
                f"turn: expected up to {MAX_FACTOR_OR_DEGREES:,.0f} degrees either way, got {self.degrees:g}"
            )

    def apply(self, draft: Draft, ids: Ids) -> None:
        from scipy.spatial.transform import Rotation

        axis = np.array(self.axis) / max(map(abs, self.axis))  # so that no square overflows
        axis /= np.linalg.norm(axis)
        rotation = Rotation.from_rotvec(np.radians(self.degrees) * axis).as_matrix()
        part = draft.part(ids)
        draft.put(ids, around(part, 1.0, rotation, self.about).moved(part))


@dataclass(frozen=True)
class Scale:
    """Larger or smaller from `about`; None: the middle of what is scaled. Raises: InputError: a factor not above 0."""

    factor: Number
    about: Vector | None = None

    def __post_init__(self) -> None:
        if not 1 / MAX_FACTOR_OR_DEGREES <= self.factor <= MAX_FACTOR_OR_DEGREES:
            raise InputError(f"scale: expected a factor above 0, got {self.factor:g}")

    def apply(self, draft: Draft, ids: Ids) -> None:
        part = draft.part(ids)
        draft.put(ids, around(part, self.factor, np.eye(3), self.about).moved(part))


@dataclass(frozen=True)
class Duplicate:
    """A copy, as it is now, moved by so much: an object of its own."""

    by: Vector

    def apply(self, draft: Draft, ids: Ids) -> None:
        present = ids[draft.present[ids]]
        copies = draft.add(draft.part(present), draft.next_object())
        draft.shift(copies, self.by)
        draft.homes[copies] = draft.means[copies]


def around(
    part: Gaussians, scale: Number, rotation: Matrix3, about: Vector | None
) -> Similarity:  # fmt: skip
    """Return the similarity that turns and scales with one point staying where it is."""
    fixed = middle_of(part) if about is None else np.array(about, np.float64)
    return Similarity(float(scale), rotation, fixed - scale * rotation @ fixed)


def middle_of(part: Gaussians) -> Float64[np.ndarray, " 3"]:
    """Return the middle of the box, along the world's axes, of the centres of what can be seen."""
    if not len(part):
        return np.zeros(3)
    positions = part.positions[solid(part, np.arange(len(part)))]
    return np.asarray((positions.min(axis=0) + positions.max(axis=0)) / 2)
