"""A capture that is still being written: views are taken when their poses and features have been whole for a while."""

import os
import time
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ...errors import DrSplatError, DrSplatWarning
from ...formats.langsplat import FeatureFolder
from ...scene.views import View
from .. import load_field
from ..registration import with_features
from .changing import Change

EVERY_S = 1.0

Look = Callable[[], tuple[Sequence[View], FeatureFolder]]


class Batch(NamedTuple):
    views: list[View]
    features: FeatureFolder


class Watch:
    """Watch over a capture that is being written.

    look: reads the capture; what it cannot read yet is being written. idle: seconds without news after which the watch
    ends; None: never. known: names of views that are not waited for.
    """

    def __init__(self, look: Look, known: Collection[str] = (), idle: float | None = None) -> None:
        self.known = set(known)
        self._look, self._idle = look, idle
        self._stamps: dict[str, object] = {}

    def batches(self) -> Iterator[Batch]:
        """Yield new views, those of one look together."""
        last = time.monotonic()
        while self._idle is None or time.monotonic() - last < self._idle:
            batch = self.arrived()
            if batch is not None:
                yield batch
                last = time.monotonic()
            time.sleep(EVERY_S)

    def arrived(self) -> Batch | None:
        """Return the new views that are complete and unchanged since the last look; None where there are none."""
        try:
            with warnings.catch_warnings():  # of photos that are still missing
                warnings.simplefilter("ignore", DrSplatWarning)
                views, features = self._look()
            new = [(view, key) for view, key in with_features(views, features) if view.name not in self.known]
        except (DrSplatError, OSError):
            return None
        before, self._stamps = self._stamps, {view.name: _stamp(view, features.files(key)) for view, key in new}
        ready = [
            view for view, key in new if before.get(view.name) == self._stamps[view.name] and features.can_read(key)
        ]
        return Batch(ready, features) if ready else None


def together(changes: Sequence[Change], path: str | os.PathLike[str]) -> Change:
    """Join consecutive changes to one; without any, return the field at `path` unchanged."""
    if not changes:
        field = load_field(path)
        known = field.evidence.masks.view_names if field.evidence else ()
        return Change(field, unchanged=known)
    seconds: dict[str, float] = {}
    for change in changes:
        for stage, spent in change.seconds.items():
            seconds[stage] = seconds.get(stage, 0) + spent
    added = tuple(sorted(name for change in changes for name in change.added))
    last = changes[-1]
    touched, coded = (sum(getattr(change, name) for change in changes) for name in ("num_touched", "num_coded"))
    return Change(last.field, added, unchanged=last.unchanged, num_touched=touched, num_coded=coded, seconds=seconds)


def _stamp(view: View, files: Sequence[Path]) -> object:
    """Return a stamp of the pose and the files; a file that is being written has another at the next look."""
    try:
        stats = [(stat.st_size, stat.st_mtime_ns) for stat in map(os.stat, files)]
    except OSError:
        return object()  # equal to none
    return view.cam_from_world.tobytes(), view.K.tobytes(), view.width, view.height, stats
