"""Why photos have no pose: one sentence for each."""

from collections.abc import Mapping, Sequence
from statistics import median

from .photos import Photo

BLURRED_SHARE = 0.35  # of the median sharpness
FEW_FEATURES = 150
FEW_MATCHES = 15  # which COLMAP asks of a pair


def reason_of(
    photo: Photo,
    photos: Sequence[Photo],
    features: Mapping[str, int],
    pairs: Mapping[tuple[str, str], int],
    models: Sequence[Sequence[str]],
) -> str:
    """Return why a photo is not in the first model.

    features: number by file. pairs: verified matches by pair of files. models: files of each model, the kept one first.
    """
    if photo.fault is not None:
        return photo.fault
    twin = next((other for other in photos if other.file == photo.file and other.name != photo.name), None)
    if twin is not None and photos.index(twin) < photos.index(photo):
        return f"it is the same file as {twin.name}"
    if photo.file not in features:
        return "COLMAP could not read it"
    if features[photo.file] < FEW_FEATURES:
        return f"it shows hardly any texture, or is blurred: {features[photo.file]} features"
    for others in models[1:]:
        if photo.file in others:
            return f"it shows another place, together with {len(others) - 1} other photos"
    typical = median(each.sharpness for each in photos if each.fault is None)
    if photo.sharpness < BLURRED_SHARE * typical:
        return "it is blurred"
    matches = max((count for pair, count in pairs.items() if photo.file in pair), default=0)
    if matches < FEW_MATCHES:
        return "no overlap: it shows nothing that another photo shows"
    return f"too little overlap: at most {matches} places in common with another photo"
