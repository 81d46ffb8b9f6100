"""Other colours for an object. Every change is linear in the colour, so all harmonics go along: light and shade stay.

A colour is 0.5 + SH_C0 * sh[0] + further harmonics of the direction; A c + b has A of all harmonics, and b in the
constant one.
"""

from dataclasses import dataclass

import numpy as np

from ...base.arrays import Float32, Float64, Ids, Matrix3, Vector
from ...drawing.heat import LUMA
from ...errors import InputError
from ...scene.gaussians import SH_C0
from .draft import Draft

Number = int | float
Color = tuple[Number, Number, Number]
Colors = Float64[np.ndarray, "m 3"]
REFERENCE_LIGHT_QUANTILE = (
    0.9  # of an object's light: Gaussians at it get the colour itself, lighter ones a lighter one
)
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

    color: Color
    amount: Number = 1.0

    def __post_init__(self) -> None:
        check_color(self.color)
        if not 0 <= self.amount <= 1:
            raise InputError(f"amount: expected a number from 0 to 1, got {self.amount:g}")

    def apply(self, draft: Draft, ids: Ids) -> None:
        light = np.einsum("nc,c->n", _colors(draft.sh[ids]), LUMA)
        reference = max(float(np.quantile(light, REFERENCE_LIGHT_QUANTILE)) if len(light) else 1.0, MIN_CLUSTER_LIGHT)
        full = np.outer(self.color, LUMA) / reference
        _map(draft, ids, (1 - self.amount) * np.eye(3) + self.amount * full, np.zeros(3))


@dataclass(frozen=True)
class Palette:
    """The object's own colours, told apart by k-means, become these: its darkest the darkest, and so on.

    Raises: InputError: not 1 to 16 colours in [0, 1].
    """

    colors: tuple[Color, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.colors) <= MAX_COLORS:
            raise InputError(f"palette: expected 1 to {MAX_COLORS} colours, got {len(self.colors)}")
        for color in self.colors:
            check_color(color)

    def apply(self, draft: Draft, ids: Ids) -> None:
        colors = _colors(draft.sh[ids])
        groups = grouped(colors, draft.opacities[ids].astype(np.float64), len(self.colors))
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

    mean: Vector
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
        pixels = pixels[pixels.any(axis=1)] / 255.0
        if len(pixels) < 2:
            raise InputError("the photo is black: expected a picture with colours to take over")
        mean, covariance = _statistics(pixels, np.ones(len(pixels)))
        return cls(mean, covariance)

    def apply(self, draft: Draft, ids: Ids) -> None:
        if not len(ids):
            return
        weights = draft.opacities[ids].astype(np.float64) + 1e-6
        mean, covariance = _statistics(_colors(draft.sh[ids]), weights)
        root = _power(covariance + MIN_COLOR_SPREAD**2 * np.eye(3), 0.5)
        back = _power(covariance + MIN_COLOR_SPREAD**2 * np.eye(3), -0.5)
        matrix = back @ _power(root @ self.covariance @ root, 0.5) @ back
        _map(draft, ids, matrix, self.mean - matrix @ mean)


def color_of(text: str) -> Color:
    """Return the colour of "#2060ff", or of a name such as steelblue. Raises: InputError: no colour."""
    from PIL import ImageColor

    try:
        red, green, blue = ImageColor.getrgb(text.strip())[:3]
    except ValueError:
        raise InputError(f"expected a colour, e.g. #2060ff or steelblue; got {text!a:.60}") from None
    return red / 255, green / 255, blue / 255


def check_color(color: Color) -> None:
    """Check a colour. Raises: InputError: not three numbers from 0 to 1."""
    if len(color) != 3 or not all(0 <= part <= 1 for part in color):
        raise InputError(f"a colour: expected red, green and blue from 0 to 1, got {color}")


def grouped(colors: Colors, weights: Float64[np.ndarray, " m"], count: int) -> Ids:
    """Return up to `count` groups of like colours, hue before light, by k-means from quantiles of light."""
    total = colors.sum(axis=1, keepdims=True)
    light = np.einsum("nc,c->n", colors, LUMA)
    features = np.column_stack([colors / np.maximum(total, 3 * MIN_CLUSTER_LIGHT), LUMA_WEIGHT * light])
    order = np.argsort(light, kind="stable")
    starts = order[((np.arange(count) + 0.5) / count * len(order)).astype(int)] if len(order) else order
    centers, groups = features[starts], np.zeros(len(colors), np.int64)
    for _ in range(KMEANS_STEPS):
        groups = ((features[:, None] - centers[None]) ** 2).sum(axis=2).argmin(axis=1)
        for k in range(len(centers)):
            mine = groups == k
            if weights[mine].sum() > 0:
                centers[k] = np.average(features[mine], axis=0, weights=weights[mine])
    return groups


def _colors(sh: Float32[np.ndarray, "m k 3"]) -> Colors:
    return np.asarray(np.clip(0.5 + SH_C0 * sh[:, 0].astype(np.float64), 0, 1))


def _map(draft: Draft, ids: Ids, matrix: Matrix3, offset: Vector) -> None:
    """Apply c -> matrix c + offset, for the colour in every direction."""
    sh = np.einsum("rc,nkc->nkr", matrix, draft.sh[ids].astype(np.float64))
    sh[:, 0] += (matrix.sum(axis=1) * 0.5 + offset - 0.5) / SH_C0
    draft.sh[ids] = sh.astype(np.float32)


def _statistics(colors: Colors, weights: Float64[np.ndarray, " m"]) -> tuple[Vector, Matrix3]:
    shares = weights / weights.sum()
    mean = np.einsum("n,nc->c", shares, colors)
    away = colors - mean
    return mean, np.einsum("n,nc,nd->cd", shares, away, away)


def _power(matrix: Matrix3, exponent: float) -> Matrix3:
    """Return a power of a symmetric matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray(vectors * np.maximum(values, 1e-12) ** exponent @ vectors.T)
