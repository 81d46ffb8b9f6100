"""Fields of one scene and one kind of masks, by aggregator; what they share is made once."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from drsplat import (
    PQ,
    Codebook,
    EncoderIdentity,
    Gaussians,
    LanguageField,
    MiniEncoder,
    Registration,
    View,
    ViewFeatures,
    register,
)
from drsplat.evaluation.scorers import Scorer, cosine_scorer, feature_scorer
from drsplat.field.codes import CodeSpecification
from drsplat.field.evidence.aggregation import Sampling
from drsplat.field.objects.finding import find_objects

from .aggregators import MEASURED
from .masks import features_of
from .rendered import STEPS, rendered_scorer
from .rivals import FITTED
from .scenes import BenchScene
from .scoring import Methods

if TYPE_CHECKING:
    from .rivals.rasterising import Photos

DEFAULT = Sampling()
OBJECTS = "objects"
"""The mean, answered in whole objects."""


class Registered:
    """A set of Gaussians and what the photos say of them, by sampling."""

    def __init__(
        self, gaussians: Gaussians, views: list[View], features: Mapping[str, ViewFeatures], encoder: EncoderIdentity
    ) -> None:
        self.gaussians, self.views, self.features = gaussians, views, features
        self.encoder = encoder
        self.registrations: dict[Sampling, Registration] = {}

    @property
    def seen(self) -> dict[View, ViewFeatures]:
        return {view: self.features[view.name] for view in self.views}

    def registration(self, sampling: Sampling, threads: int) -> Registration:
        if sampling not in self.registrations:
            found = register(self.gaussians, self.views, self.features, sampling=sampling, threads=threads)
            self.registrations[sampling] = replace(found, encoder=self.encoder)
        return self.registrations[sampling]

    def field(self, name: str, code: CodeSpecification, threads: int) -> LanguageField:
        how = MEASURED[name]
        found = self.registration(how.sampling or DEFAULT, threads)
        return found.to_field(code, aggregator=how, gaussians=self.gaussians, threads=threads)


class Workshop:
    """Everything that the methods of one scene and one kind of masks share.

    All aggregators have one codebook, that of the mean: differences between them are then not those of k-means.
    """

    def __init__(
        self,
        scene: BenchScene,
        masks: str,
        encoder: MiniEncoder,
        threads: int,
        efforts: Mapping[str, float],
        device: str = "cpu",
    ) -> None:
        self.scene, self.encoder, self.threads, self.efforts, self.device = scene, encoder, threads, efforts, device
        features = features_of(scene, masks, encoder)
        self.num_masks = sum(len(found.embeddings) for found in features.values())
        frozen = scene.points.gaussians
        self._photos: dict[Registered, Photos] = {}
        self.volume = Registered(scene.gaussians, scene.views, features, encoder.identity)
        self.points = Registered(frozen, scene.views, features, encoder.identity)

    @cached_property
    def codebook(self) -> Codebook:
        return self.volume.field("mean", PQ(), self.threads).codebook

    def methods(self, name: str) -> Methods:
        return Methods(self._scorer(self.volume, name), self._scorer(self.points, name))

    def _scorer(self, registered: Registered, name: str) -> Scorer:
        if name in STEPS:
            return rendered_scorer(name, registered.gaussians, registered.seen, self.encoder, self.threads)
        if name in FITTED:
            return self._fitted(registered, name)
        if name == OBJECTS:
            field = registered.field("mean", self.codebook, self.threads)
            field = field.with_objects(find_objects(field, registered.gaussians, threads=self.threads))
        else:
            field = registered.field(name, self.codebook, self.threads)
        return cosine_scorer(field, self.encoder, name, threads=self.threads)

    def _fitted(self, registered: Registered, name: str) -> Scorer:
        from .rivals.fitting import make
        from .rivals.rasterising import photos_of

        if registered not in self._photos:  # of one set of Gaussians at a time: they are large
            found = photos_of(registered.gaussians, registered.seen, threads=self.threads, device=self.device)
            self._photos = {registered: found}
        made = make(name, registered.gaussians, self._photos[registered], self.efforts.get(name, 1.0))
        return feature_scorer(made.features, self.encoder, name)
