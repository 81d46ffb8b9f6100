"""Check of a catalogue's matches by the rules of their own scenes, which must answer with them, too."""

from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from threading import Lock
from typing import Any

import numpy as np

from ...base.arrays import Int64
from ...errors import FormatError
from ...scene.encoders import Encoder
from .. import Query
from ..sketch import Sketch, SketchedScene
from .conditions import scenes_sql
from .lance import CURE
from .snapshot import Snapshot

MAX_CACHED_SCENES = 64  # sketches in memory
COLUMNS = ("scene", "object_id", "label", "sketch")
MISSING = -2  # in place of a number that a damaged row lacks


class SceneRules:
    """Scenes of one version of a catalogue, asked by their own rules; safe for several threads.

    Args: source: makes the encoder of queries.
    """

    def __init__(self, snapshot: Snapshot, source: Callable[[], Encoder]) -> None:
        self.version, self._snapshot, self._source = snapshot.version, snapshot, source
        self._scenes: OrderedDict[str, SketchedScene] = OrderedDict()
        self._lock = Lock()

    def first(self, query: Query, objects: Sequence[tuple[Any, Any]], top: int) -> list[int]:
        """Return the positions of the first `top` objects (by scene and number) that their scenes answer with, too.

        Raises: FormatError: damaged rows; as `Scene.ask`.
        """
        if any(None in key for key in objects):
            raise FormatError(f"{self._snapshot.path}: an object without a number or a scene: {CURE}")
        answers: dict[str, Int64[np.ndarray, " a"]] = {}
        agreed: list[int] = []
        for begin in range(0, len(objects), top):
            batch = range(begin, min(begin + top, len(objects)))
            scenes = self._opened({objects[at][0] for at in batch} - answers.keys())
            answers |= {name: scene.answers(query) for name, scene in scenes.items()}
            agreed += [at for at in batch if objects[at][1] in answers[objects[at][0]]]
            if len(agreed) >= top:
                break
        return agreed[:top]

    def _opened(self, names: Collection[str]) -> dict[str, SketchedScene]:
        """Return some scenes; those not in memory are read by one search."""
        with self._lock:
            missing = sorted(name for name in names if name not in self._scenes)
            opened = {name: self._scenes[name] for name in names if name in self._scenes}
            if missing:
                opened |= _read(self._snapshot, missing, self._source)
            for name, scene in opened.items():
                self._scenes[name] = scene
                self._scenes.move_to_end(name)
            while len(self._scenes) > MAX_CACHED_SCENES:
                self._scenes.popitem(last=False)
        return opened


def _read(snapshot: Snapshot, names: Sequence[str], source: Callable[[], Encoder]) -> dict[str, SketchedScene]:
    """Read scenes from the table. Raises: FormatError: one has no sketch, or other objects than its sketch."""
    rows = snapshot.rows(scenes_sql(names), COLUMNS)
    scene_of_row = np.asarray(rows["scene"].to_pylist(), np.object_)
    numbers = np.asarray(rows["object_id"].fill_null(MISSING))
    scenes = {}
    for name in names:
        own = np.flatnonzero(scene_of_row == name)
        own = own[np.argsort(numbers[own], kind="stable")]  # -1 first: the scene's own row
        data = rows["sketch"][int(own[0])].as_py() if len(own) else None
        if data is None or not np.array_equal(numbers[own], np.arange(-1, len(own) - 1)):
            raise FormatError(f"{snapshot.path}: the rows of scene {name!r:.80} are not whole: {CURE}")
        try:
            sketch = Sketch.from_bytes(data, snapshot.encoder.dim, len(own) - 1)
        except FormatError as error:
            raise FormatError(f"{snapshot.path}: scene {name!r:.80} has {error}: {CURE}") from error
        labels = rows["label"].take(own[1:]).to_pylist()
        scenes[name] = SketchedScene(sketch, labels, snapshot.encoder, source)
    return scenes
