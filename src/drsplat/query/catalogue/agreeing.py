"""Check of a catalogue's matches by the rules of their own scenes, which must answer with them, too."""

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from threading import Lock

import numpy as np

from ...base.arrays import Bool
from ...errors import FormatError
from ...scene.encoders import Encoder
from .. import Query
from ..sketch import Sketch
from ..sketched import SketchedScene
from .lance import CURE
from .snapshot import Snapshot

MAX_CACHED_SCENES = 256  # sketches in memory, about 0.5 MB each
COLUMNS = ("scene", "sketch")
MIN_ASKED = 4  # objects at once: reading one sketch takes nearly as long as reading four


class SceneRules:
    """Scenes of one version of a catalogue, asked by their own rules; safe for several threads.

    Args: source: makes the encoder of queries.
    """

    def __init__(self, snapshot: Snapshot, source: Callable[[], Encoder]) -> None:
        self.version, self._snapshot, self._source = snapshot.version, snapshot, source
        self._scenes: OrderedDict[str, SketchedScene] = OrderedDict()
        self._lock = Lock()

    def first(self, query: Query, objects: Sequence[tuple[str, int]], top: int) -> list[int]:
        """Return the positions of the first `top` objects (by scene and number) that their scenes answer with, too.

        Raises: FormatError: damaged rows; as `Scene.ask`.
        """
        answers: dict[str, Bool[np.ndarray, " o"]] = {}
        agreed: list[int] = []
        asked = 0
        while asked < len(objects) and len(agreed) < top:
            batch = range(asked, min(asked + max(top - len(agreed), MIN_ASKED), len(objects)))
            asked = batch.stop
            scenes = self._opened({objects[at][0] for at in batch} - answers.keys())
            answers |= {name: scene.answers(query) for name, scene in scenes.items()}
            agreed += [at for at in batch if self._is_among(answers, *objects[at])]
        return agreed[:top]

    def _is_among(self, answers: Mapping[str, Bool[np.ndarray, " o"]], name: str, number: int) -> bool:
        if not 0 <= number < len(answers[name]):
            raise FormatError(f"{self._snapshot.path}: the rows of scene {name!r:.80} are not whole: {CURE}")
        return bool(answers[name][number])

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
    """Read scenes from the table. Raises: FormatError: one has no sketch."""
    own_rows = snapshot.own_rows
    rows = snapshot.take(np.array([own_rows[name] for name in names if name in own_rows], np.int64), COLUMNS)
    sketches = dict(zip(rows["scene"].to_pylist(), rows["sketch"], strict=True))
    scenes = {}
    for name in names:
        data = sketches[name].as_py() if name in sketches else None
        if data is None:
            raise FormatError(f"{snapshot.path}: scene {name!r:.80} has no sketch: {CURE}")
        try:
            sketch = Sketch.from_bytes(data, snapshot.encoder.dim)
        except FormatError as error:
            raise FormatError(f"{snapshot.path}: scene {name!r:.80} has {error}: {CURE}") from error
        scenes[name] = SketchedScene(sketch, snapshot.encoder, source)
    return scenes
