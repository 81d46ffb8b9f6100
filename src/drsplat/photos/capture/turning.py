"""Check that the camera moved: photos of a camera that only turned have no parallax, so nothing gives their depth.

COLMAP notices this only where it knows the focal length. Otherwise a made-up one and a bent lens turn rotations into
depths that fit to a fraction of a pixel. So before mapping, a rotation is fitted to each pair of photos, with one lens
for all. A homography would explain a flat scene, too; such rotations explain it only if the camera was shifted straight
along it, as if a very long lens turned, so shifts are fitted for comparison.

Source: Kabsch, Acta Cryst. A32 (1976) 922, for rotations; Fitzgibbon, CVPR 2001, for the lens (division model).

Reasons why photos have no pose: one sentence for each.
"""

from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import TypeAlias

import numpy as np

from ...base.arrays import Float64
from ...errors import InputError, warn
from .photos import Photo

MAX_BLURRED_SHARE = 0.35  # of the median sharpness
MIN_FEATURES = 150
PAIR_MATCHES = 15  # which COLMAP requires of a pair
ENOUGH_MATCHES = 300  # for a pose, unless the camera has not moved
WALK_ROUND = (
    "Walk round what you take, a step to the side for each photo, with texture in sight; turning on the spot is not "
    "enough"
)


class Reasons:
    """Reasons why photos are not in the first of some models.

    photos: all of the input. features: their number by file. pairs: verified matches by pair of files. models: files
    of each, that of the capture first.
    """

    def __init__(
        self,
        photos: Sequence[Photo],
        features: Mapping[str, int],
        pairs: Mapping[tuple[str, str], int],
        models: Sequence[Sequence[str]],
    ) -> None:
        self._features = features
        self._first = {photo.file: photo for photo in reversed(photos) if photo.fault is None}
        self._others = {file: len(model) for model in models[1:] for file in model}
        self._typical_sharpness = median(photo.sharpness for photo in self._first.values())
        self._best_matches: dict[str, int] = {}
        for pair, count in sorted(pairs.items(), key=lambda item: item[1]):
            self._best_matches |= dict.fromkeys(pair, count)

    def of(self, photo: Photo) -> str:
        """Return why a photo has no pose."""
        if photo.fault is not None:
            return photo.fault
        first = self._first[photo.file]
        if first.name != photo.name:
            return f"it is the same file as {first.name}"
        if photo.file not in self._features:
            return "COLMAP could not read it"
        if self._features[photo.file] < MIN_FEATURES:
            return f"it shows hardly any texture, or is blurred: {self._features[photo.file]} features"
        if photo.file in self._others:
            return f"it shows another place, together with {self._others[photo.file] - 1} other photos"
        if photo.sharpness < MAX_BLURRED_SHARE * self._typical_sharpness:
            return "it is blurred"
        matches = self._best_matches.get(photo.file, 0)
        if matches < PAIR_MATCHES:
            return "no overlap: it shows nothing that another photo shows"
        if matches < ENOUGH_MATCHES:
            return f"too little overlap or movement: at most {matches} places in common with another photo"
        return f"too little movement: {matches:,} places in common with another photo, and no depth comes of them"


MIN_PAIRS, MIN_MATCHES, MATCHES_PER_PAIR = 3, 30, 100
TOLERANCE = 0.003  # of the diagonal
STILL_SHARE = 0.005  # of the diagonal: what moves less may move with the camera, as a robot's gripper does
EXPLAINED_SHARE = 0.8  # of the matches of a pair
TURNING_SHARE, DOUBTFUL_SHARE = 0.95, 0.75  # of the pairs
MIN_SHIFT_ERROR = 1.5  # times the rotations' error
FOCAL_FACTORS, EXIF_FOCAL_FACTORS = np.geomspace(0.4, 2.5, 25), np.geomspace(0.8, 1.25, 7)
SHIFT_FACTOR = 50.0  # of the focal length: rays are nearly parallel
BENDS = np.linspace(-0.4, 0.2, 13)  # near the negative term of COLMAP's radial lens

Places = Float64[np.ndarray, "pairs matches 2"]
Focals = Float64[np.ndarray, "pairs 1 1"]
Errors = Float64[np.ndarray, "pairs matches"]
Matches: TypeAlias = tuple[Float64[np.ndarray, "2 _ 2"], Float64[np.ndarray, "2 1 1"]]
"""Matches of two photos: their places from the photos' middles, and focal lengths, as shares of the diagonals."""


def check_moved(pairs: Sequence[Matches], from_exif: bool) -> None:
    """Check that the camera did more than turn. from_exif: whether focal lengths are, rather than guesses.

    Raises: InputError: it turned on the spot. Warns: DrSplatWarning: it may have.
    """
    share, is_turn = turning(pairs, from_exif)
    explained = f"rotations alone explain {share:.0%} of the pairs of photos"
    if share >= TURNING_SHARE and is_turn:
        raise InputError(f"{explained}, as if the camera turned on the spot: nothing gives a depth. {WALK_ROUND}")
    if share >= DOUBTFUL_SHARE:
        doubt = "the camera hardly moved, or straight along something flat, and the poses may be wrong"
        warn(f"{explained}: {doubt}. {WALK_ROUND}", 1)


def turning(pairs: Sequence[Matches], from_exif: bool) -> tuple[float, bool]:
    """Return the share of pairs that rotations explain, and whether they do so better than shifts; 0.0 of few pairs."""
    moved = [(np.linalg.norm(places[0] - places[1], axis=1) > STILL_SHARE).nonzero()[0] for places, _ in pairs]
    used = [(*pair, rows) for pair, rows in zip(pairs, moved, strict=True) if len(rows) >= MIN_MATCHES]
    if len(used) < MIN_PAIRS:
        return 0.0, False
    evenly = np.linspace(0, 1, MATCHES_PER_PAIR, endpoint=False)
    matches = np.stack([places[:, rows[(evenly * len(rows)).astype(int)]] for places, _, rows in used], 1)
    focals = np.stack([focal for _, focal, _ in used], 1)
    turned = _least_errors(matches, focals, EXIF_FOCAL_FACTORS if from_exif else FOCAL_FACTORS, BENDS)
    shifted = _least_errors(matches, focals, [SHIFT_FACTOR], BENDS * SHIFT_FACTOR**2)
    explained = (turned < TOLERANCE).mean(1) >= EXPLAINED_SHARE
    return float(explained.mean()), bool(np.median(shifted) >= MIN_SHIFT_ERROR * np.median(turned))


def _least_errors(matches: np.ndarray, focals: np.ndarray, factors: Iterable[float], bends: Iterable[float]) -> Errors:
    """Return the errors of all matches with the lens that explains most of them."""
    fits = (_errors(matches, factor * focals, bend) for factor in factors for bend in bends)
    return max(fits, key=lambda errors: np.count_nonzero(errors < TOLERANCE))


def _errors(matches: Float64[np.ndarray, "2 pairs matches 2"], focals: np.ndarray, bend: float) -> Errors:
    """Return how far off places are after the best rotation of each pair, which wrong matches hardly disturb."""
    first, second = (_rays(places, focal, bend) for places, focal in zip(matches, focals, strict=True))
    weights = np.ones((*first.shape[:2], 1))
    for _ in range(3):
        left, _, right = np.linalg.svd((weights * second).swapaxes(1, 2) @ first)
        left[..., 2] *= np.linalg.det(left @ right)[:, None]
        turned = first @ (left @ right).swapaxes(1, 2)
        away: np.ndarray = np.linalg.norm(_places(turned, focals[1], bend) - matches[1], axis=-1)
        weights = (1 + (away[..., None] / TOLERANCE) ** 2) ** -2
    return away


def _rays(places: Places, focal: Focals, bend: float) -> Float64[np.ndarray, "pairs matches 3"]:
    depth = focal + bend / focal * (places**2).sum(-1, keepdims=True)
    rays = np.concatenate([places, depth], -1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _places(rays: Float64[np.ndarray, "pairs matches 3"], focal: Focals, bend: float) -> Places:
    """Return the places of rays, the inverse of `_rays`; those of rays behind the camera are far away."""
    depth, aside2 = rays[..., 2:], (rays[..., :2] ** 2).sum(-1, keepdims=True)
    root = depth + np.sqrt(np.maximum(depth**2 - 4 * bend * aside2, 0))
    return 2 * focal * rays[..., :2] / np.maximum(root, 1e-6)
