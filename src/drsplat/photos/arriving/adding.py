"""Views that wait are masked and embedded, and added to the field of their scene, all in one change.

A view that cannot be added is refused with the reason, and the others are added. What is no view's fault, such as a
full disk or another program that writes the field, is raised, and all views go on waiting.
"""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
    batch = _Batch(target, names)
    batch.each(batch.pose)
    own = [view for view in batch.views if not view.has_features]
    if own:
        batch.attempt(partial(batch.embed, load(batch.field, target.capture / FEATURES)), own)
    batch.each(batch.read)
    if batch.views:
        batch.attempt(batch.add, batch.views.copy())
    done = time.time()
    for view in batch.views:
        batch.live.mark_added(view, done)
    added = tuple(replace(view, state="added", ended=done) for view in batch.views)
    return Outcome(added, tuple(batch.refused), batch.change)


def refuse_view(capture: Path, name: str, reason: str) -> None:
    """Refuse a view that waits; nothing happens where it does not."""
    live = LiveViews(capture)
    view = live.find(name)
    if view is not None and view.state == "waiting":
        live.refuse(view, reason, time.time())


class _Batch:
    """Views on their way into the field; those that are refused leave it."""

    def __init__(self, target: GrowingScene, names: Collection[str] | None) -> None:
        self.target, self.live = target, LiveViews(target.capture)
        self.field = load_field(target.field)
        self.views = [view for view in self.live.every("waiting") if names is None or view.name in names]
        self.refused: list[LiveView] = []
        self.change: Change | None = None
        self._posed: dict[str, View] = {}
        self._features: dict[str, ViewFeatures] = {}

    def pose(self, views: Sequence[LiveView]) -> None:
        """Decode photos and pose their views."""
        for view in views:
            posed = self.live.posed(view)
            load_image(posed)
            still = not isinstance(self.target.scene, Moving)
            self._posed[view.name] = replace(posed, time=None) if still else posed

    def embed(self, models: PhotoModels, views: Sequence[LiveView]) -> None:
        """Embed the masks of photos, into the folder of the scene's other features."""
        posed = [self._posed[view.name] for view in views]
        folder = self.target.capture / FEATURES
        embed(posed, folder, models.segmenter, models.encoder, max_height=models.max_height)

    def read(self, views: Sequence[LiveView]) -> None:
        """Read the features of views."""
        level = level_index(field_level(self.field))
        for view in views:
            folder = self.live.features if view.has_features else self.target.capture / FEATURES
            features = FeatureFolder(folder, level, self.field.encoder)[view.stem]
            if not len(features.embeddings):
                raise InputError(f"no mask was found in '{view.name}'")
            self._features[view.name] = features

    def add(self, views: Sequence[LiveView]) -> None:
        """Add views to the field, in one change."""
        posed = [self._posed[view.name] for view in views]
        features = {view.name: self._features[view.name] for view in views}
        target, folder = self.target, self.target.capture / FEATURES
        self.change = grow_field(target.field, target.scene, posed, features, folder, threads=target.threads)
        for view in views:
            if view.name in self.change.left_out:
                self._refuse(view, "it was removed from the field, or kept out of it, and stays out")

    def each(self, work: Callable[[Sequence[LiveView]], None]) -> None:
        """Do the work for each view alone, and refuse those that fail."""
        for view in self.views.copy():
            self.attempt(work, [view])

    def attempt(self, work: Callable[[Sequence[LiveView]], None], views: Sequence[LiveView]) -> None:
        """Do the work for all views at once; where that fails, for each alone, and refuse those that fail alone."""
        try:
            work(views)
        except _NO_FAULT_OF_A_VIEW:
            raise
        except DrSplatError as error:
            if len(views) == 1:
                return self._refuse(views[0], str(error))
            for view in views:
                self.attempt(work, [view])

    def _refuse(self, view: LiveView, reason: str) -> None:
        now = time.time()
        self.live.refuse(view, reason, now)
        self.views.remove(view)
        self.refused.append(replace(view, state="refused", ended=now, reason=reason))
