"""A scene while it is edited, and changes of its rows in all but colour.

Rows keep their numbers, whatever is removed, and new ones come behind the last.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...base.arrays import Flags, Float32, Float64, Ids, Matrix3, Rows3, Vector
from ...errors import InputError
from ...formats.scenes import read_gaussians
from ...scene.boxes import solid
from ...scene.gaussians import Gaussians, filled
from ...scene.similarity import Similarity

OBJECT_ID = "object_id"  # the column that says whose a row is, -1 for none
MAX_COORDINATE = 1e30  # of positions and sizes: their differences still fit float32
MIN_ROW_LIMIT = 1_000_000  # rows that edits of any scene may make
MAX_ROW_GROWTH = 4  # times a larger scene's rows, likewise


@dataclass(eq=False)
class Draft:
    """The arrays of all rows, those of the scene first. Its own: changes write into them.

    present: false where a row was removed. homes: means of rows as they came. added: the rows that each edit brought,
    from the first to before the last, (0, 0) for none; of the edits so far. read: gives other scenes. most: rows that
    there may be, removed ones included. antialiased: as of `Gaussians`.
    """

    means: Rows3
    quats: Float32[np.ndarray, "n 4"]
    scales: Rows3
    opacities: Float32[np.ndarray, " n"]
    sh: Float32[np.ndarray, "n k 3"]
    extra: dict[str, np.ndarray]
    origin: Vector
    present: Flags
    homes: Rows3
    most: int = MIN_ROW_LIMIT
    added: list[tuple[int, int]] = field(default_factory=list)
    read: Callable[[str], Gaussians] = read_gaussians
    antialiased: bool = False

    @classmethod
    def of(cls, scene: Gaussians) -> "Draft":
        extra = {name: column.copy() for name, column in scene.extra.items()}
        present, homes = np.ones(len(scene), bool), scene.means.copy()
        return cls(
            scene.means.copy(), scene.quats.copy(), scene.scales.copy(), scene.opacities.copy(), scene.sh.copy(), extra,
            scene.origin, present, homes, most_rows(len(scene)), antialiased=scene.antialiased,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.means)

    @property
    def is_sound(self) -> bool:
        """Return whether all rows are still Gaussians, with numbers that can be computed with."""
        finite = all(np.isfinite(column).all() for column in (self.quats, self.sh))
        near = all(
            (np.abs(column) <= MAX_COORDINATE).all() for column in (self.means, self.scales)
        )  # NaN is not either
        return finite and near and bool((self.scales > 0).all())

    def gaussians(self) -> Gaussians:
        """Return the scene as it is now, without removed rows."""
        return self.part(np.flatnonzero(self.present))

    def everything(self) -> Gaussians:
        """Return all rows under their numbers, removed ones with opacity 0."""
        opacities = np.where(self.present, self.opacities, np.float32(0))
        columns = (self.means, self.quats, self.scales, opacities, self.sh, self.extra, self.origin)
        return Gaussians(*columns, self.antialiased)

    def part(self, ids: Ids) -> Gaussians:
        """Return some rows, removed ones as well."""
        extra = {name: column[ids] for name, column in self.extra.items()}
        columns = (self.means[ids], self.quats[ids], self.scales[ids], self.opacities[ids], self.sh[ids])
        return Gaussians(*columns, extra, self.origin, self.antialiased)

    def put(self, ids: Ids, part: Gaussians) -> None:
        """Put rows where and as `part` has them."""
        self.means[ids] = self._means(part)
        self.quats[ids], self.scales[ids], self.sh[ids] = part.quats, part.scales, part.sh

    def shift(self, ids: Ids, by: Sequence[int | float] | Float64[np.ndarray, "*rows 3"]) -> None:
        """Move rows by the same vector, or each by its own."""
        self.means[ids] = (self.means[ids] + np.asarray(by, np.float64)).astype(np.float32)

    def add(self, part: Gaussians, object_id: int | None = None) -> Ids:
        """Append rows behind the last, and return their numbers.

        object_id: whose they are, None for the column of `part`. What else only one of the two knows is 0.

        Raises: InputError: more rows than there may be.
        """
        first, count = len(self), len(part)
        self.check_room(count)
        most = max(self.sh.shape[1], part.sh.shape[1])
        self.sh = np.concatenate([filled(self.sh, most), filled(part.sh, most)])
        self.means = np.concatenate([self.means, self._means(part)])
        self.homes = np.concatenate([self.homes, self.means[first:]])
        self.quats = np.concatenate([self.quats, part.quats])
        self.scales = np.concatenate([self.scales, part.scales])
        self.opacities = np.concatenate([self.opacities, part.opacities])
        self.present = np.concatenate([self.present, np.ones(count, bool)])
        for name, column in self.extra.items():
            own = part.extra.get(name, np.zeros(count, column.dtype)).astype(column.dtype)
            own = np.full(count, object_id, column.dtype) if name == OBJECT_ID and object_id is not None else own
            self.extra[name] = np.concatenate([column, own])
        return np.arange(first, first + count, dtype=np.int64)

    def check_room(self, count: int) -> None:
        """Check that so many rows may be added. Raises: InputError: more than there may be."""
        if len(self) + count > self.most:
            raise InputError(
                f"adds {count:,} Gaussians to {len(self):,}, and edits of this scene make up to {self.most:,}, removed "
                "ones included: undo it, or save the scene as it is now and edit what was saved"
            )

    def next_object(self) -> int:
        """Return a number that no object has."""
        ids = self.extra.get(OBJECT_ID)
        return 0 if ids is None else int(ids.max(initial=-1)) + 1

    def _means(self, part: Gaussians) -> Float32[np.ndarray, "m 3"]:
        """Return the centres of a part, counted from this draft's origin."""
        if (part.origin == self.origin).all():
            return part.means
        return np.asarray((part.positions - self.origin).astype(np.float32))


def most_rows(rows: int) -> int:
    """Return how many rows edits may make where the largest scene that takes part has so many."""
    return max(MIN_ROW_LIMIT, MAX_ROW_GROWTH * rows)


Number = int | float
Triple = tuple[Number, Number, Number]
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

    by: Triple

    def apply(self, draft: Draft, ids: Ids) -> None:
        draft.shift(ids, self.by)


@dataclass(frozen=True)
class Turn:
    """By an angle about an axis, right-handed, through `about`; None: the middle of what is turned.

    Raises: InputError: an axis without a direction, or more than a million degrees.
    """

    degrees: Number
    axis: Triple
    about: Triple | None = None

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
    about: Triple | None = None

    def __post_init__(self) -> None:
        if not 1 / MAX_FACTOR_OR_DEGREES <= self.factor <= MAX_FACTOR_OR_DEGREES:
            raise InputError(f"scale: expected a factor above 0, got {self.factor:g}")

    def apply(self, draft: Draft, ids: Ids) -> None:
        part = draft.part(ids)
        draft.put(ids, around(part, self.factor, np.eye(3), self.about).moved(part))


@dataclass(frozen=True)
class Duplicate:
    """A copy, as it is now, moved by so much: an object of its own."""

    by: Triple

    def apply(self, draft: Draft, ids: Ids) -> None:
        present = ids[draft.present[ids]]
        copies = draft.add(draft.part(present), draft.next_object())
        draft.shift(copies, self.by)
        draft.homes[copies] = draft.means[copies]


def around(
    part: Gaussians, scale: Number, rotation: Matrix3, about: Triple | None
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
