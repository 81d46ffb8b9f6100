"""Rows of the table to entries, checked on the way: the files may come from anybody."""

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from ...base.arrays import Flags, Indices
from ...base.contents import Document
from ...errors import DrSplatError, FormatError, InputError
from ...field.objects.agreed import agreed
from ...formats.field_folder import read_manifest
from ...scene.encoders import Encoder
from .. import Query
from ..opening import scene_files
from ..ranking import Ranked
from ..sketch import Sketch, SketchedScene
from .entries import Entry, Position, SceneEntry, checked_jpeg, of_scene
from .snapshot import CURE, ROW_ID, Snapshot, libraries

TEXTS = ("scene", "field", "added", "label", "name", "photo", "mask", "thumbnail")
NUMBERS = ("x", "y", "z", "sure", "num_gaussians", "num_views", "object_id", "tile")
SHOWN = (*TEXTS, *NUMBERS, *Position._fields, "axes", "extent")
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
        answers: dict[str, Flags] = {}
        agreed: list[int] = []
        asked = 0
        while asked < len(objects) and len(agreed) < top:
            batch = range(asked, min(asked + max(top - len(agreed), MIN_ASKED), len(objects)))
            asked = batch.stop
            scenes = self._opened({objects[at][0] for at in batch} - answers.keys())
            answers |= {name: scene.answers(query) for name, scene in scenes.items()}
            agreed += [at for at in batch if self._is_among(answers, *objects[at])]
        return agreed[:top]

    def _is_among(self, answers: Mapping[str, Flags], name: str, number: int) -> bool:
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


def entries_of(
    snapshot: Snapshot, nearest: Any, ranked: Ranked, query: Query, rules: SceneRules, top: int
) -> list[Entry]:
    """Return the best objects that a query selects here and in their scenes; equal ones by scene and number.

    Raises: FormatError: rows that are no objects, or a damaged scene.
    """
    heads = list(zip(*(nearest[name].to_pylist() for name in ("scene", "object_id")), strict=True))
    if any(None in head for head in heads):
        raise FormatError(f"{snapshot.path}: an object without a number or a scene: {CURE}")
    selected = sorted(np.flatnonzero(ranked.selected).tolist(), key=lambda at: (-float(ranked.values[at]), *heads[at]))
    keys = [heads[at] for at in selected]
    row_ids = np.asarray(nearest[ROW_ID]).astype(np.int64)[selected]
    with ThreadPoolExecutor(1) as pool:  # while the rules decide: the first are nearly always chosen
        ahead = pool.submit(_shown, snapshot, row_ids[:top])
        places = rules.first(query, keys, top)
        rows = ahead.result()
    rows |= _shown(snapshot, row_ids[[place for place in places if place >= top]])
    scores = ranked.values[selected]
    return [_entry(snapshot.path, rows[int(row_ids[place])], float(scores[place])) for place in places]


def _shown(snapshot: Snapshot, row_ids: Indices) -> dict[int, Document]:
    """Return what an entry tells, by the ids of rows."""
    return {row[ROW_ID]: row for row in snapshot.take(row_ids, SHOWN).to_pylist()} if len(row_ids) else {}


def thumbnail_of(snapshot: Snapshot, scene: str, object_id: int, tile: int) -> bytes:
    """Return an object's JPEG. Raises: InputError: no such object, or it has none. FormatError: it is no JPEG."""
    where = f"{of_scene(scene)} AND object_id = {int(object_id)} AND tile = {int(tile)} AND object_id >= 0"
    rows = snapshot.rows(where, ["thumbnail"])["thumbnail"].to_pylist()
    if not rows:
        raise InputError(f"there is no object {object_id} of a scene {scene!r:.80} here")
    if rows[0] is None:
        raise InputError(f"object {object_id} of {scene!r:.80} has no thumbnail: its scene was added without photos")
    try:
        return checked_jpeg(rows[0])
    except FormatError as error:
        raise FormatError(
            f"the thumbnail of object {object_id} of {scene!r:.80} {error}: add the scene again"
        ) from error


def listed_of(snapshot: Snapshot) -> list[SceneEntry]:
    """Return all scenes, by name. Raises: FormatError: damaged."""
    objects = snapshot.rows("object_id >= 0", ["scene", "sure", "num_views", "label"])
    _, pa = libraries()
    sure, num_views = (np.asarray(objects[name].fill_null(0)) for name in ("sure", "num_views"))
    has_name = np.asarray(objects["label"].fill_null("")) != ""
    is_listed = pa.array(agreed(sure.astype(np.float32), num_views.astype(np.int64)) | has_name)
    counts, listed_counts = _counts(objects["scene"]), _counts(objects["scene"].filter(is_listed))
    rows = snapshot.rows("object_id = -1", ["scene", "added", "field", "folder"]).to_pylist()
    if any(row[key] is None for row in rows for key in ("scene", "added", "field")):
        raise FormatError(f"{snapshot.path}: {CURE}")
    listed = [_listed(row, counts.get(row["scene"], 0), listed_counts.get(row["scene"], 0)) for row in rows]
    return sorted(listed, key=lambda entry: entry.scene)


def _counts(scenes: Any) -> dict[str, int]:
    """Return how often each name stands in a column."""
    counts = scenes.value_counts()
    return dict(zip(counts.field("values").to_pylist(), counts.field("counts").to_pylist(), strict=True))


def _listed(row: Document, num_objects: int, num_agreed: int) -> SceneEntry:
    folder = row["folder"] or ""
    state = state_of(folder, row["field"], num_objects) if folder else "unknown"
    return SceneEntry(row["scene"], num_objects, num_agreed, row["added"], row["field"], folder, state)


def state_of(folder: str, field: str, num_objects: int) -> str:
    """Return whether the field in the folder is still the one that was added, by its manifest."""
    try:
        manifest = read_manifest(scene_files(Path(folder)).field)
    except (DrSplatError, OSError):
        return "missing"
    return "current" if (manifest.get("field"), manifest.get("objects")) == (field, num_objects) else "changed"


def _entry(path: Path, row: Document, score: float) -> Entry:
    numbers = [row[name] for name in NUMBERS]
    lists = [row["axes"], row["extent"]]
    texts = [row["scene"], row["field"], row["added"]]
    if any(value is None for value in (*numbers, *lists, *texts)):
        raise FormatError(f"{path}: an object without a box, a number or a scene: {CURE}")
    box = np.array([*lists[0], *lists[1], row["x"], row["y"], row["z"], row["sure"]], np.float64)
    if not np.isfinite(box).all():
        raise FormatError(f"{path}: object {row['object_id']} of {row['scene']!r:.80} has no finite box: {CURE}")
    place = [row[name] for name in Position._fields]
    return Entry(
        row["scene"], row["tile"], row["object_id"], score, box[12:15], box[:9].reshape(3, 3), box[9:12],
        None if None in place else Position(*place),
        row["num_gaussians"], row["num_views"], row["sure"], row["label"], row["name"], row["photo"], row["mask"],
        row["added"], row["field"], row["thumbnail"],
    )  # fmt: skip


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
