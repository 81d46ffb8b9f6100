"""Reasons why photos have no pose: one sentence for each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median

from .photos import Photo

MAX_BLURRED_SHARE = 0.35  # of the median sharpness
MIN_FEATURES = 150
MIN_MATCHES = 15  # which COLMAP requires of a pair
ENOUGH_MATCHES = 300  # for a pose, unless the camera has not moved
WALK_ROUND = (
    "Walk round what you take, a step to the side for each photo, with texture in sight; turning on the spot is not "
    "enough"
)


@dataclass(frozen=True)
class Reasons:
    """Reasons why photos are not in the first of some models.

    photos: all of the input. features: their number by file. pairs: verified matches by pair of files. models: files
    of each, that of the capture first.
    """

    photos: Sequence[Photo]
    features: Mapping[str, int]
    pairs: Mapping[tuple[str, str], int]
    models: Sequence[Sequence[str]]

    def of(self, photo: Photo) -> str:
        """Return why a photo has no pose."""
        if photo.fault is not None:
            return photo.fault
        first = self._first[photo.file]
        if first.name != photo.name:
            return f"it is the same file as {first.name}"
        if photo.file not in self.features:
            return "COLMAP could not read it"
        if self.features[photo.file] < MIN_FEATURES:
            return f"it shows hardly any texture, or is blurred: {self.features[photo.file]} features"
        if photo.file in self._others:
            return f"it shows another place, together with {self._others[photo.file] - 1} other photos"
        if photo.sharpness < MAX_BLURRED_SHARE * self._typical_sharpness:
            return "it is blurred"
        matches = self._best_matches.get(photo.file, 0)
        if matches < MIN_MATCHES:
            return "no overlap: it shows nothing that another photo shows"
        if matches < ENOUGH_MATCHES:
            return f"too little overlap or movement: at most {matches} places in common with another photo"
        return f"too little movement: {matches:,} places in common with another photo, and no depth comes of them"

    @cached_property
    def _first(self) -> dict[str, Photo]:
        """First photo of each file."""
        return {photo.file: photo for photo in reversed(self.photos) if photo.fault is None}

    @cached_property
    def _others(self) -> dict[str, int]:
        """Number of photos in the model of each file that is in a model other than the first."""
        return {file: len(model) for model in self.models[1:] for file in model}

    @cached_property
    def _typical_sharpness(self) -> float:
        return median(photo.sharpness for photo in self._first.values())

    @cached_property
    def _best_matches(self) -> dict[str, int]:
        best: dict[str, int] = {}
        for pair, count in self.pairs.items():
            for file in pair:
                best[file] = max(count, best.get(file, 0))
        return best
