"""A scene while it is edited, and changes of its rows.

Rows keep their numbers, whatever is removed, and new ones come behind the last. Every change of colours is linear in
the colour, so all harmonics go along: light and shade stay. A colour is 0.5 + SH_C0 * sh[0] + further harmonics of the
direction; A c + b has A of all harmonics, and b in the constant one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...base.arrays import Doubles, Flags, Float64, Harmonics, Matrix3, RowIds, Vector3, Vectors, WholeNumbers
from ...drawing.heat import LUMA
from ...errors import InputError
from ...formats.scenes import read_gaussians
from ...scene.boxes import solid
from ...scene.gaussians import SH_C0, Gaussians, filled
from ...scene.moving import counted_from
from ...scene.similarity import Similarity

ARRAYS = ("means", "quats", "scales", "opacities", "sh")
ByRow = Sequence[int | float] | Float64[np.ndarray, "*rows 3"]
OBJECT_ID = "object_id"  # the column that says whose a row is, -1 for none
MAX_COORDINATE = 1e30  # of positions and sizes: their differences still fit float32
MIN_ROW_LIMIT = 1_000_000  # rows that edits of any scene may make
MAX_ROW_GROWTH = 4  # times a larger scene's rows, likewise


@dataclass(eq=False)
class Draft:
    """All rows of a scene while it is edited, those of the scene first.

    rows: in arrays of the draft's own, which changes write into. present: false where a row was removed. homes: means
    of rows as they came. most: rows that there may be, removed ones included. read: gives other scenes. added: the rows
    that each edit brought, from the first to before the last, (0, 0) for none; of the edits so far.
    """

    rows: Gaussians
    present: Flags
    homes: Vectors
    most: int
    read: Callable[[str], Gaussians] = read_gaussians
    added: list[tuple[int, int]] = field(default_factory=list)

    @classmethod
    def of(cls, scene: Gaussians, read: Callable[[str], Gaussians] = read_gaussians) -> "Draft":
        present = np.ones(len(scene), bool)
        return cls(scene.subset(present), present, scene.means.copy(), most_rows(len(scene)), read)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def owners(self) -> WholeNumbers | None:
        """The object of each row, -1 for none; None where objects are not known."""
        return self.rows.extra.get(OBJECT_ID)

    @property
    def is_sound(self) -> bool:
        """Return whether all rows are still Gaussians, with numbers that can be computed with."""
        rows = self.rows
        finite = np.isfinite(rows.quats).all() and np.isfinite(rows.sh).all()
        near = all((np.abs(column) <= MAX_COORDINATE).all() for column in (rows.means, rows.scales))  # NaN is not
        return bool(finite and near and (rows.scales > 0).all())

    def everything(self) -> Gaussians:
        """Return all rows under their numbers, removed ones with opacity 0."""
        return replace(self.rows, opacities=np.where(self.present, self.rows.opacities, np.float32(0)))

    def put(self, ids: RowIds, part: Gaussians) -> None:
        """Put rows where and as `part` has them."""
        rows = self.rows
        rows.means[ids] = counted_from(part, rows.origin).means
        rows.quats[ids], rows.scales[ids], rows.sh[ids] = part.quats, part.scales, part.sh

    def shift(self, ids: WholeNumbers, by: ByRow) -> None:
        """Move rows by the same vector, or each by its own."""
        self.rows.means[ids] = (self.rows.means[ids] + np.asarray(by, np.float64)).astype(np.float32)

    def add(self, part: Gaussians, object_id: int | None = None, by: ByRow = (0.0, 0.0, 0.0)) -> None:
        """Append rows behind the last.

        object_id: whose they are, None for the column of `part`. by: how far they are moved from where `part` has them,
        all or each. What else only one of the two knows is 0.

        Raises: InputError: more rows than there may be.
        """
        self.check_room(len(part))
        own, most, extra = self.rows, max(self.rows.sh.shape[1], part.sh.shape[1]), {}
        means = (counted_from(part, own.origin).means + np.asarray(by, np.float64)).astype(np.float32)
        for name, column in own.extra.items():
            more = part.extra.get(name, np.zeros(len(part), column.dtype))
            if name == OBJECT_ID and object_id is not None:
                more = np.full(len(part), object_id)
            extra[name] = np.concatenate([column, more.astype(column.dtype)])
        both = [replace(own, sh=filled(own.sh, most)), replace(part, means=means, sh=filled(part.sh, most))]
        arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in both]) for name in ARRAYS}
        self.rows = replace(own, **arrays, extra=extra)
        self.homes = np.concatenate([self.homes, means])
        self.present = np.concatenate([self.present, np.ones(len(part), bool)])

    def check_room(self, count: int) -> None:
        """Check that so many rows may be added. Raises: InputError: more than there may be."""
        if len(self) + count > self.most:
            raise InputError(
                f"adds {count:,} Gaussians to {len(self):,}, and edits of this scene make up to {self.most:,}, removed "
                "ones included: undo it, or save the scene as it is now and edit what was saved"
            )

    def next_object(self) -> int:
        """Return a number that no object has."""
        return 0 if self.owners is None else int(self.owners.max(initial=-1)) + 1


def most_rows(rows: int) -> int:
    """Return how many rows edits may make where the largest scene that takes part has so many."""
    return max(MIN_ROW_LIMIT, MAX_ROW_GROWTH * rows)


Number = int | float
Triple = tuple[Number, Number, Number]
MAX_FACTOR_OR_DEGREES = 1e6


@dataclass(frozen=True)
class Remove:
    """Not there any more."""

    def apply(self, draft: Draft, ids: RowIds) -> None:
        draft.present[ids] = False


@dataclass(frozen=True)
class Isolate:
    """Nothing but these."""

    def apply(self, draft: Draft, ids: RowIds) -> None:
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

    def apply(self, draft: Draft, ids: RowIds) -> None:
        opacities = draft.rows.opacities
        opacities[ids] = np.minimum(opacities[ids] * np.float32(self.factor), np.float32(1))


@dataclass(frozen=True)
class Move:
    """by: in scene units, along the axes of the world."""

    by: Triple

    def apply(self, draft: Draft, ids: RowIds) -> None:
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

    def apply(self, draft: Draft, ids: RowIds) -> None:
        from scipy.spatial.transform import Rotation

        axis = np.array(self.axis) / max(map(abs, self.axis))  # so that no square overflows
        axis /= np.linalg.norm(axis)
        rotation = Rotation.from_rotvec(np.radians(self.degrees) * axis).as_matrix()
        draft.put(ids, _around(draft.rows.subset(ids), 1.0, rotation, self.about))


@dataclass(frozen=True)
class Scale:
    """Larger or smaller from `about`; None: the middle of what is scaled. Raises: InputError: a factor not above 0."""

    factor: Number
    about: Triple | None = None

    def __post_init__(self) -> None:
        if not 1 / MAX_FACTOR_OR_DEGREES <= self.factor <= MAX_FACTOR_OR_DEGREES:
            raise InputError(f"scale: expected a factor above 0, got {self.factor:g}")

    def apply(self, draft: Draft, ids: RowIds) -> None:
        draft.put(ids, _around(draft.rows.subset(ids), self.factor, np.eye(3), self.about))


@dataclass(frozen=True)
class Duplicate:
    """A copy, as it is now, moved by so much: an object of its own."""

    by: Triple

    def apply(self, draft: Draft, ids: RowIds) -> None:
        draft.add(draft.rows.subset(ids[draft.present[ids]]), draft.next_object(), self.by)


def _around(part: Gaussians, scale: Number, rotation: Matrix3, about: Triple | None) -> Gaussians:
    """Turn and scale, with one point staying where it is.

    about: that point; None for the middle of the box, along the world's axes, of the centres of what can be seen.
    """
    fixed = np.zeros(3) if about is None else np.array(about, np.float64)
    if about is None and len(part):
        positions = part.positions[solid(part, np.arange(len(part)))]
        fixed = (positions.min(0) + positions.max(0)) / 2
    return Similarity(float(scale), rotation, fixed - scale * rotation @ fixed).moved(part)


Colors = Float64[np.ndarray, "n 3"]
REFERENCE_LIGHT_QUANTILE = 0.9  # of an object's light: Gaussians at it get the colour, lighter ones a lighter one
MIN_CLUSTER_LIGHT = 0.05
LUMA_WEIGHT = 0.3  # against chroma, when colours are clustered for a palette
KMEANS_STEPS = 20
MAX_COLORS = 16
MIN_COLOR_SPREAD = 0.02  # along each direction, so that noise is not made a pattern


@dataclass(frozen=True)
class Recolour:
    """One hue with its own light and shade. color: RGB in [0, 1]. amount: 0 nothing, 1 all of it.

    Raises: InputError: numbers outside of these.
    """

    color: Triple
    amount: Number = 1.0

    def __post_init__(self) -> None:
        check_color(self.color)
        if not 0 <= self.amount <= 1:
            raise InputError(f"amount: expected a number from 0 to 1, got {self.amount:g}")

    def apply(self, draft: Draft, ids: RowIds) -> None:
        light = np.einsum("nc,c->n", _colors(draft.rows.sh[ids]), LUMA)
        reference = max(float(np.quantile(light, REFERENCE_LIGHT_QUANTILE)) if len(light) else 1.0, MIN_CLUSTER_LIGHT)
        full = np.outer(self.color, LUMA) / reference
        _map(draft, ids, (1 - self.amount) * np.eye(3) + self.amount * full, np.zeros(3))


@dataclass(frozen=True)
class Palette:
    """The object's own colours, told apart by k-means, become these: its darkest the darkest, and so on.

    Raises: InputError: not 1 to 16 colours in [0, 1].
    """

    colors: tuple[Triple, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.colors) <= MAX_COLORS:
            raise InputError(f"palette: expected 1 to {MAX_COLORS} colours, got {len(self.colors)}")
        for color in self.colors:
            check_color(color)

    def apply(self, draft: Draft, ids: RowIds) -> None:
        colors = _colors(draft.rows.sh[ids])
        groups = grouped(colors, draft.rows.opacities[ids].astype(np.float64), len(self.colors))
        light = np.einsum("nc,c->n", colors, LUMA)
        means = [float(light[groups == k].mean()) if (groups == k).any() else np.inf for k in range(len(self.colors))]
        wanted = sorted(self.colors, key=lambda color: float(np.dot(color, LUMA)))
        for k, color in zip(np.argsort(means, kind="stable").tolist(), wanted, strict=True):
            _map(draft, ids[groups == k], np.outer(color, LUMA) / max(means[k], MIN_CLUSTER_LIGHT), np.zeros(3))


@dataclass(frozen=True, eq=False)
class MatchPhoto:
    """Colours get the mean and the covariance of a photo's: by the linear map that changes them least.

    mean (3,), covariance (3, 3): of RGB in [0, 1]. Raises: InputError: no such numbers.
    Source: Pitie and Kokaram 2007, "The linear Monge-Kantorovitch linear colour mapping".
    """

    mean: Vector3
    covariance: Matrix3

    def __post_init__(self) -> None:
        check_color(tuple(self.mean.tolist()))
        symmetric = np.abs(self.covariance - self.covariance.T).max() <= 1e-6
        if not symmetric or not np.linalg.eigvalsh(self.covariance).min() >= -1e-6 or np.abs(self.covariance).max() > 1:
            raise InputError("a photo's statistics: expected a covariance of colours in [0, 1]")

    @classmethod
    def of(cls, photo: np.ndarray) -> "MatchPhoto":
        """Return the change to the statistics of a picture, uint8 (H, W, 3); black pixels lie outside of a cut-out."""
        pixels = photo.reshape(-1, 3)
        pixels = pixels[pixels.any(1)] / 255.0
        if len(pixels) < 2:
            raise InputError("the photo is black: expected a picture with colours to take over")
        mean, covariance = _statistics(pixels, np.ones(len(pixels)))
        return cls(mean, covariance)

    def apply(self, draft: Draft, ids: RowIds) -> None:
        if not len(ids):
            return
        weights = draft.rows.opacities[ids].astype(np.float64) + 1e-6
        mean, covariance = _statistics(_colors(draft.rows.sh[ids]), weights)
        root = _power(covariance + MIN_COLOR_SPREAD**2 * np.eye(3), 0.5)
        back = _power(covariance + MIN_COLOR_SPREAD**2 * np.eye(3), -0.5)
        matrix = back @ _power(root @ self.covariance @ root, 0.5) @ back
        _map(draft, ids, matrix, self.mean - matrix @ mean)


def color_of(text: str) -> Triple:
    """Return the colour of "#2060ff", or of a name such as steelblue. Raises: InputError: no colour."""
    from PIL import ImageColor

    try:
        red, green, blue = ImageColor.getrgb(text.strip())[:3]
    except ValueError:
        raise InputError(f"expected a colour, e.g. #2060ff or steelblue; got {text!a:.60}") from None
    return red / 255, green / 255, blue / 255


def check_color(color: Triple) -> None:
    """Check a colour. Raises: InputError: not three numbers from 0 to 1."""
    if len(color) != 3 or not all(0 <= part <= 1 for part in color):
        raise InputError(f"a colour: expected red, green and blue from 0 to 1, got {color}")


def grouped(colors: Colors, weights: Doubles, count: int) -> WholeNumbers:
    """Return up to `count` groups of like colours, hue before light, by k-means from quantiles of light."""
    total = colors.sum(1, keepdims=True)
    light = np.einsum("nc,c->n", colors, LUMA)
    features = np.column_stack([colors / np.maximum(total, 3 * MIN_CLUSTER_LIGHT), LUMA_WEIGHT * light])
    order = np.argsort(light, kind="stable")
    starts = order[((np.arange(count) + 0.5) / count * len(order)).astype(int)] if len(order) else order
    centers, groups = features[starts], np.zeros(len(colors), np.int64)
    for _ in range(KMEANS_STEPS):
        groups = ((features[:, None] - centers[None]) ** 2).sum(2).argmin(1)
        for k in range(len(centers)):
            mine = groups == k
            if weights[mine].sum() > 0:
                centers[k] = np.average(features[mine], axis=0, weights=weights[mine])
    return groups


def _colors(sh: Harmonics) -> Colors:
    return np.clip(0.5 + SH_C0 * sh[:, 0].astype(np.float64), 0, 1)


def _map(draft: Draft, ids: RowIds, matrix: Matrix3, offset: Vector3) -> None:
    """Apply c -> matrix c + offset, for the colour in every direction."""
    sh = np.einsum("rc,nkc->nkr", matrix, draft.rows.sh[ids].astype(np.float64))
    sh[:, 0] += (matrix.sum(1) * 0.5 + offset - 0.5) / SH_C0
    draft.rows.sh[ids] = sh.astype(np.float32)


def _statistics(colors: Colors, weights: Doubles) -> tuple[Vector3, Matrix3]:
    shares = weights / weights.sum()
    mean = np.einsum("n,nc->c", shares, colors)
    away = colors - mean
    return mean, np.einsum("n,nc,nd->cd", shares, away, away)


def _power(matrix: Matrix3, exponent: float) -> Matrix3:
    """Return a power of a symmetric matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return vectors * np.maximum(values, 1e-12) ** exponent @ vectors.T
