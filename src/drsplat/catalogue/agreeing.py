"""Check of a catalogue's matches by the rules of their own scenes, which must answer with them too."""

from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from threading import Lock
from typing import Any

import numpy as np

from ..arrays import Int64
from ..encoders import Encoder
from ..errors import FormatError
from ..query import Query
from ..query.sketch import Sketch, SketchedScene
from .conditions import scenes_sql
from .table import CURE, Snapshot, vectors_of

MOST_SCENES = 64  # sketches that are kept in memory
COLUMNS = ("scene", "object_id", "descriptors", "label", "sketch")


class SceneRules:
    """The scenes of one version of a catalogue, asked by their own rules. Several threads may ask at once.

    Args: source: makes the encoder of queries.
    """

    def __init__(self, known: Snapshot, source: Callable[[], Encoder]) -> None:
        self.version, self._known, self._source = known.version, known, source
        self._scenes: OrderedDict[str, SketchedScene] = OrderedDict()
        self._lock = Lock()

    def first(self, query: Query, found: Sequence[tuple[Any, Any]], top: int) -> list[int]:
        """Return the positions of the first `top` objects (by scene and number) that their scenes answer with too.

        Raises: FormatError: damaged rows; as `Scene.ask`.
        """
        if any(None in one for one in found):
            raise FormatError(f"{self._known.path}: an object without a number or a scene: {CURE}")
        answers: dict[str, Int64[np.ndarray, " a"]] = {}
        agreed: list[int] = []
        for begin in range(0, len(found), top):
            some = range(begin, min(begin + top, len(found)))
            scenes = self._opened({found[at][0] for at in some} - answers.keys())
            answers |= {name: scene.answers(query) for name, scene in scenes.items()}
            agreed += [at for at in some if found[at][1] in answers[found[at][0]]]
            if len(agreed) >= top:
                break
        return agreed[:top]

    def _opened(self, names: Collection[str]) -> dict[str, SketchedScene]:
        """Return some scenes, those that are not kept in memory by one search for all of them."""
        with self._lock:
            missing = sorted(name for name in names if name not in self._scenes)
            opened = {name: self._scenes[name] for name in names if name in self._scenes}
            if missing:
                opened |= _read(self._known, missing, self._source)
            for name, scene in opened.items():
                self._scenes[name] = scene
                self._scenes.move_to_end(name)
            while len(self._scenes) > MOST_SCENES:
                self._scenes.popitem(last=False)
        return opened


def _read(known: Snapshot, names: Sequence[str], source: Callable[[], Encoder]) -> dict[str, SketchedScene]:
    """Read scenes from the table. Raises: FormatError: one has no sketch, or other objects than that."""
    rows = known.rows(scenes_sql(names), COLUMNS)
    columns = {name: rows[name].to_pylist() for name in ("scene", "object_id", "label", "sketch")}
    descriptors = vectors_of(rows["descriptors"], known.path)
    scenes = {}
    for name in names:
        at = {columns["object_id"][row]: row for row in range(len(descriptors)) if columns["scene"][row] == name}
        own, count = at.pop(-1, None), len(at)
        data = None if own is None else columns["sketch"][own]
        if data is None or set(at) != set(range(count)):
            raise FormatError(f"{known.path}: the rows of scene {name!r:.80} are not whole: {CURE}")
        try:
            sketch = Sketch.from_bytes(data, known.encoder.dim, count)
        except FormatError as error:
            raise FormatError(f"{known.path}: scene {name!r:.80} has {error}: {CURE}") from error
        places = [at[number] for number in range(count)]
        labels = [columns["label"][place] for place in places]
        scenes[name] = SketchedScene(sketch, [descriptors[place] for place in places], labels, known.encoder, source)
    return scenes
