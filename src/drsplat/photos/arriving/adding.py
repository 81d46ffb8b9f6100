"""Views that wait are masked and embedded, and added to the field of their scene, all in one change.

A view that cannot be added is refused with the reason, and the others are added. What is no view's fault, such as a
full disk or another program that writes the field, is raised, and all views go on waiting.
"""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import DrSplatError, InputError, MissingExtraError
from ...field import LanguageField, load_field
from ...field.growing import Change
from ...formats.langsplat import FeatureFolder, level_index
from ...formats.live_views import LiveView, LiveViews
from ...formats.replacing import ClaimedError, NoRoom
from ...scene.gaussians import Gaussians
from ...scene.masks.features import ViewFeatures
from ...scene.moving import Moving
from ...scene.photos import load_image
from ...scene.views import View
from ..embedding.embed import embed
from ..embedding.growing import grow_field
from .models import FEATURES, PhotoModels
from .taking import field_level

Load = Callable[[LanguageField, Path], PhotoModels]
_NO_FAULT_OF_A_VIEW = (NoRoom, ClaimedError, MissingExtraError)


@dataclass(frozen=True)
class GrowingScene:
    """A scene that views are added to.

    Attributes:
        field: folder of the field.
        capture: folder that has the photos.
        scene: the Gaussians that were registered.
        threads: 0 for all cores; the field does not depend on it.
    """

    field: Path
    capture: Path
    scene: Gaussians | Moving
    threads: int = 0


@dataclass(frozen=True)
class Outcome:
    """Views that were added and refused, each in its last state, and the change of the field, if there was one."""

    added: tuple[LiveView, ...]
    refused: tuple[LiveView, ...]
    change: Change | None


def add_waiting(target: GrowingScene, load: Load, names: Collection[str] | None = None) -> Outcome:
    """Add the views that wait to the field. load: makes the models; names: only these views.

    Raises: NoRoom: the disk is full. ClaimedError: another process writes the field or its features. DrSplatError: the
    field or the models cannot be loaded.
    """
    batch = _Batch(target)
    batch.collect(names)
    own = [view for view in batch.views if not view.has_features]
    if own:
        batch.embed(load, own)
    batch.read_features()
    return batch.added()


def refuse_view(capture: Path, name: str, reason: str) -> None:
    """Refuse a view that waits; nothing happens where it does not."""
    live = LiveViews(capture)
    view = live.find(name)
    if view is not None and view.state == "waiting":
        live.refuse(view, reason, time.time())


class _Batch:
    """Views on their way into the field; those that are refused leave it."""

    def __init__(self, target: GrowingScene) -> None:
        self.target, self.live = target, LiveViews(target.capture)
        self.field = load_field(target.field)
        self.views: list[LiveView] = []
        self._refused: list[LiveView] = []
        self._posed: dict[str, View] = {}
        self._features: dict[str, ViewFeatures] = {}
        self._changes: list[Change] = []

    def collect(self, names: Collection[str] | None) -> None:
        """Take the views that wait and whose photos can be decoded."""
        self.views = [view for view in self.live.every("waiting") if names is None or view.name in names]
        self._try(self._pose, list(self.views), alone=True)

    def embed(self, load: Load, views: Sequence[LiveView]) -> None:
        """Embed the masks of photos, into the folder of the scene's other features."""
        folder = self.target.capture / FEATURES
        models = load(self.field, folder)

        def work(some: Sequence[LiveView]) -> None:
            posed = [self._posed[view.name] for view in some]
            embed(posed, folder, models.segmenter, models.encoder, max_height=models.max_height)

        self._try(work, views)

    def read_features(self) -> None:
        self._try(self._read, list(self.views), alone=True)

    def added(self) -> Outcome:
        """Add the views to the field, in one change unless one of them cannot be added."""
        if self.views:
            self._try(self._add, list(self.views))
        done = time.time()
        for view in self.views:
            self.live.mark_added(view, done)
        added = tuple(replace(view, state="added", ended=done) for view in self.views)
        return Outcome(added, tuple(self._refused), self._changes[-1] if self._changes else None)

    def _pose(self, views: Sequence[LiveView]) -> None:
        for view in views:
            posed = self.live.posed(view)
            load_image(posed)
            still = not isinstance(self.target.scene, Moving)
            self._posed[view.name] = replace(posed, time=None) if still else posed

    def _read(self, views: Sequence[LiveView]) -> None:
        level = level_index(field_level(self.field))
        for view in views:
            folder = self.live.features if view.has_features else self.target.capture / FEATURES
            features = FeatureFolder(folder, level, self.field.encoder)[view.stem]
            if not len(features.embeddings):
                raise InputError(f"no mask was found in '{view.name}'")
            self._features[view.name] = features

    def _add(self, views: Sequence[LiveView]) -> None:
        posed = [self._posed[view.name] for view in views]
        features = {view.name: self._features[view.name] for view in views}
        target = self.target
        change = grow_field(
            target.field, target.scene, posed, features, target.capture / FEATURES, threads=target.threads
        )
        self._changes.append(change)
        for view in views:
            if view.name in change.left_out:
                self._refuse(view, "it was removed from the field, or kept out of it, and stays out")

    def _try(self, work: Callable[[Sequence[LiveView]], None], views: Sequence[LiveView], alone: bool = False) -> None:
        """Do the work for all views at once; where that fails, for each alone, and refuse those that fail alone."""
        if not alone or len(views) == 1:
            try:
                return work(views)
            except _NO_FAULT_OF_A_VIEW:
                raise
            except DrSplatError as error:
                if len(views) == 1:
                    return self._refuse(views[0], str(error))
        for view in views:
            self._try(work, [view])
        return None

    def _refuse(self, view: LiveView, reason: str) -> None:
        now = time.time()
        self.live.refuse(view, reason, now)
        self.views.remove(view)
        self._refused.append(replace(view, state="refused", ended=now, reason=reason))
