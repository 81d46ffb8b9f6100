"""Comparison of a view's masks and embeddings with those that a registration was made from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.moving import Moving
from ...scene.views import View
from ..codes import Track, untracked
from ..evidence.columns import ColumnMaker, scenery_of
from ..registration import Registration


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of views with a registration of these Gaussians whose provenance is known."""

    registration: Registration
    scene: Gaussians | Moving

    def changed(
        self, views: Sequence[tuple[View, str]], features: Mapping[str, ViewFeatures], track: Track = untracked
    ) -> list[View]:
        """Return the views whose camera, masks or embeddings have changed. views: each with its features' name."""
        return [view for view, key in track(views, "comparing views") if not self._is_same(view, features[key])]

    def _is_same(self, view: View, features: ViewFeatures) -> bool:
        return self.has_masks(view, features) and self._has_embeddings(view, features)

    def has_masks(self, view: View, features: ViewFeatures) -> bool:
        """Return whether camera and masks, and so W's columns, are those of the registration."""
        registration = self.registration
        assert registration.provenance is not None
        number = registration.masks.view_names.index(view.name)
        if int(np.count_nonzero(self._columns(view.name))) != len(features.embeddings):
            return False
        return bool(registration.provenance.keys[number].tobytes() == self._maker.key(view, features))

    def _has_embeddings(self, view: View, features: ViewFeatures) -> bool:
        return np.array_equal(self.registration.embeddings[self._columns(view.name)], features.embeddings)

    def _columns(self, name: str) -> np.ndarray:
        masks = self.registration.masks
        return np.asarray(masks.views == masks.view_names.index(name))

    @cached_property
    def _maker(self) -> ColumnMaker:
        sampling = self.registration.sampling
        if sampling is None:
            raise InputError("how the photos were looked at is not known of this registration: register again")
        return ColumnMaker(scenery_of(self.scene, sampling.near), Path(), sampling, 0)
