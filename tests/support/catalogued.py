"""Scenes of three boxes with known objects, as `drsplat register` and `drsplat objects` leave them, for catalogues."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from drsplat import EncoderIdentity, WordEncoder, read_gaussians, write_gaussians
from drsplat.field import LanguageField
from drsplat.formats.json_files import write_json
from drsplat.formats.poses import write_cameras_json
from drsplat.formats.replacing import claimed_output
from drsplat.formats.tensors import sealed
from drsplat.query import Match
from drsplat.query.catalogue.changes import replace_scene
from drsplat.query.catalogue.entries import SceneEntry
from drsplat.query.catalogue.rows import Kept, scene_arrays
from drsplat.query.catalogue.snapshot import DOCUMENT, Record
from drsplat.query.sketch import Packed, Sketch
from drsplat.scene.gaussians import Gaussians
from known_objects import EACH, VIEWS, described, known_field, known_scene
from scenes import look_at_view

EYES = ((0.5, -4.0, 1.5), (1.5, -4.5, 2.0), (2.5, -4.0, 1.0))
MASKS = (0, 1, 2, 0, 1, 2, 0, 0, 1, 2)  # which box each mask of `known_field` is of


def boxes_of(words: Sequence[str], gaussians: Gaussians, encoder: EncoderIdentity | None = None) -> LanguageField:
    """A field with three objects that `words` name, by the encoder of words or as if by another one."""
    vectors = WordEncoder().encode_texts(list(words))[list(MASKS)]
    field = known_field(gaussians, vectors, encoder or WordEncoder.identity)
    return field.with_objects(described(field, gaussians))


def write_scene(folder: Path, words: Sequence[str], *, photos: bool = True, moved: float = 0.0) -> Path:
    """A folder as `drsplat serve` takes it; moved: how far the boxes lie along x."""
    folder.mkdir(parents=True)
    gaussians = known_scene()
    means = gaussians.means + np.array([moved, 0, 0], np.float32)
    gaussians = replace(gaussians, means=means, scales=np.full((3 * EACH, 3), 0.02, np.float32))
    write_gaussians(folder / "scene.ply", gaussians)
    boxes_of(words, read_gaussians(folder / "scene.ply")).save(folder / "a.field")
    if photos:
        (folder / "images").mkdir()
        center = (1.5 + moved, 0, 0)
        eyes = [(x + moved, y, z) for x, y, z in EYES]
        views = [replace(look_at_view(eye, center), name=name) for eye, name in zip(eyes, VIEWS, strict=True)]
        write_cameras_json(folder / "cameras.json", views)
        for view in views:
            Image.new("RGB", (view.width, view.height), (90, 140, 200)).save(folder / "images" / view.name)
    return folder


def add_plain(path: Path, name: str, vectors: np.ndarray, encoder: EncoderIdentity, each: int = 2) -> None:
    """Add a scene of objects without pictures, of `each` descriptors; their Gaussians are as these are."""
    count = len(vectors) // each
    matches = [Match(np.ones(3), np.eye(3), np.ones(3), 1.0, np.zeros(5, np.int64), object_id=k) for k in range(count)]
    picture, many = np.eye(1, vectors.shape[1], dtype=np.float32), np.full(len(vectors), 40, np.int32)
    features, pictures, words = (Packed.of(some) for some in (np.nan_to_num(vectors), picture, vectors[:0]))
    numbers = np.repeat(np.arange(count, dtype=np.int32), each)
    sketch = Sketch(features, many, numbers, pictures, words, np.full(count, 40, np.int32), {})
    entry = SceneEntry(name, count, count, datetime(2026, 1, 1, tzinfo=UTC), "f", "", "unknown")
    record = Record(0, 5, 5, 1.0, None, None, None, None)
    kept = [Kept(one, own, record, b"") for one, own in zip(matches, np.split(vectors, max(count, 1)), strict=True)]
    arrays = scene_arrays(kept, encoder.dim, sketch.to_bytes())
    with claimed_output(path, 60.0):
        replace_scene(path, entry, arrays, encoder)


def edit_document(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change a catalogue's document and seal it anew."""
    document = json.loads((path / DOCUMENT).read_text())
    change(document)
    write_json(path / DOCUMENT, sealed(document), overwrite=True)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = rng.standard_normal(shape).astype(np.float32)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), np.float32)
