"""Another encoder for a registered scene: W of its field, embeddings of the same masks, and no photo is looked at."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...errors import InputError, MismatchError
from ...formats.photo_files import listed
from ...scene.encoders import EncoderIdentity
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.moving import Moving
from ...scene.views import View
from .. import LanguageField
from ..codes import Track, untracked
from ..registration import UNKNOWN_ENCODER, Registration, with_features
from .changing import Comparison, kept_out, registration_of, warn_of_isa


def with_weights_of(
    field: LanguageField,
    scene: Gaussians | Moving,
    views: Sequence[View],
    features: Mapping[str, ViewFeatures],
    *,
    track: Track = untracked,
) -> Registration:
    """Return a field's registration with other embeddings of its masks; equal to the bit to a full one.

    Warns: DrSplatWarning: another instruction set than the field's.
    Raises: InputError: the field does not know how it was made; views of the one that the other has not.
    MismatchError: another scene, or other masks or poses.
    """
    before = registration_of(field, scene)
    warn_of_isa(before.provenance)
    new = [(view, key) for view, key in with_features(views, features) if view.name not in kept_out(field)]
    known, given = set(before.masks.view_names), {view.name for view, _ in new}
    missing, more = sorted(known - given), sorted(given - known)
    if missing or more:
        raise InputError(
            f"expected features of exactly the views of the field: {len(missing)} of it have none here, {len(more)} "
            f"are not in it: {listed([*missing, *more])}"
        )
    compared = Comparison(before, scene)
    others, embeddings, dim = [], [], 0
    for view, key in track(new, "comparing masks"):
        seen = features[key]
        dim = seen.embeddings.shape[1]
        embeddings.append(seen.embeddings)
        others += [] if compared.has_masks(view, seen) else [view.name]
    if others:
        raise MismatchError(
            f"{len(others)} of {len(new)} views have other masks or poses than the field: register them without "
            f"weights_of=FIELD: {listed(others)}"
        )
    encoder = getattr(features, "encoder", None) or EncoderIdentity(UNKNOWN_ENCODER, dim)
    return before.with_embeddings(np.concatenate(embeddings), encoder)
