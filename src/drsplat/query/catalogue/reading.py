"""Rows of a catalogue to entries, checked on the way: the files may come from anybody."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Lock

import numpy as np

from ...base.arrays import Flags
from ...errors import DrSplatError, FormatError, InputError
from ...formats.field_folder import read_manifest
from ...scene.encoders import Encoder
from .. import Query
from ..opening import scene_files
from ..ranking import Ranked
from ..sketch import Sketch, SketchedScene
from .entries import Entry, Position, SceneEntry, checked_jpeg
from .nearest import Nearest
from .snapshot import CURE, Place, Snapshot

MAX_CACHED_SCENES = 256  # sketches in memory, about 0.5 MB each


class SceneRules:
    """Scenes of a catalogue, asked by their own rules; safe for several threads.

    Args: source: makes the encoder of queries.
    """

    def __init__(self, source: Callable[[], Encoder]) -> None:
        self._source = source
        self._scenes: dict[tuple[str, int], SketchedScene] = {}  # the one that was used last is last
        self._lock = Lock()

    def scene(self, snapshot: Snapshot, place: Place) -> SketchedScene:
        """Return the scene of an object. Raises: FormatError: a damaged sketch."""
        key = (place.part.where, place.scene)
        with self._lock:
            scene = self._scenes.pop(key, None) or self._read(snapshot, place)
            self._scenes[key] = scene
            while len(self._scenes) > MAX_CACHED_SCENES:
                del self._scenes[next(iter(self._scenes))]
        return scene

    def _read(self, snapshot: Snapshot, place: Place) -> SketchedScene:
        where = f"{place.part.where}: scene {place.entry.scene!r:.80}"
        try:
            sketch = Sketch.from_bytes(place.part.bytes_of("sketches", place.scene), snapshot.encoder.dim)
        except FormatError as error:
            raise FormatError(f"{where} has {error}: {CURE}") from error
        if len(sketch.solid) != place.entry.num_objects:
            raise FormatError(f"{where}: its sketch is of {len(sketch.solid)} objects: {CURE}")
        return SketchedScene(sketch, snapshot.encoder, self._source)


def entries_of(
    snapshot: Snapshot, nearest: Nearest, ranked: Ranked, query: Query, rules: SceneRules, top: int
) -> list[Entry]:
    """Return the best objects that a query selects here and in their scenes; equal ones by scene and number.

    Raises: FormatError: damaged rows or scenes; as `Scene.ask`.
    """
    selected = np.flatnonzero(ranked.selected)
    places = {at: snapshot.place(int(nearest.rows[at])) for at in selected.tolist()}
    order = sorted(places, key=lambda at: (-float(ranked.values[at]), places[at].entry.scene, places[at].object_id))
    answers: dict[SketchedScene, Flags] = {}
    entries: list[Entry] = []
    for at in order:
        scene = rules.scene(snapshot, places[at])
        if scene not in answers:
            answers[scene] = scene.answers(query)
        if answers[scene][places[at].object_id]:
            entries.append(_entry(places[at], float(ranked.values[at])))
        if len(entries) == top:
            break
    return entries


def _entry(place: Place, score: float) -> Entry:
    scene, row = place.entry, place.row
    center, axes, extent, position = (
        np.asarray(place.part.arrays[name][row], np.float64) for name in ("centers", "axes", "extents", "positions")
    )
    if not all(np.isfinite(numbers).all() for numbers in (center, axes, extent)):
        raise FormatError(
            f"{place.part.where}: object {place.object_id} of {scene.scene!r:.80} has no finite box: {CURE}"
        )
    record = place.part.record(row)
    return Entry(
        scene.scene, record.tile, place.object_id, score, center, axes, extent,
        None if np.isnan(position).any() else Position(*position.tolist()),
        record.num_gaussians, record.num_views, record.sure, record.label, record.name, record.photo, record.mask,
        scene.added, scene.field, place.part.bytes_of("thumbnails", row) or None,
    )  # fmt: skip


def thumbnail_of(snapshot: Snapshot, scene: str, object_id: int, tile: int) -> bytes:
    """Return an object's JPEG. Raises: InputError: no such object, or it has none. FormatError: it is no JPEG."""
    at, number = snapshot.scenes.get(scene, (0, -1))
    row = snapshot.parts[at].row(number, object_id) if number >= 0 else None
    if row is None or snapshot.parts[at].record(row).tile != tile:
        raise InputError(f"there is no object {object_id} of a scene {scene!r:.80} here")
    data = snapshot.parts[at].bytes_of("thumbnails", row)
    if not data:
        raise InputError(f"object {object_id} of {scene!r:.80} has no thumbnail: its scene was added without photos")
    try:
        return checked_jpeg(data)
    except FormatError as error:
        raise FormatError(
            f"the thumbnail of object {object_id} of {scene!r:.80} {error}: add the scene again"
        ) from error


def listed_of(snapshot: Snapshot) -> list[SceneEntry]:
    """Return all scenes, by name, and whether their fields have changed."""
    scenes = [snapshot.parts[at].scenes[number] for at, number in snapshot.scenes.values()]
    return [replace(scene, state=_state(scene)) for scene in sorted(scenes, key=lambda scene: scene.scene)]


def _state(scene: SceneEntry) -> str:
    """Return whether the field in the scene's folder is still the one that was added, by its manifest."""
    if not scene.folder:
        return "unknown"
    try:
        manifest = read_manifest(scene_files(Path(scene.folder)).field)
    except (DrSplatError, OSError):
        return "missing"
    is_same = (manifest.get("field"), manifest.get("objects")) == (scene.field, scene.num_objects)
    return "current" if is_same else "changed"
