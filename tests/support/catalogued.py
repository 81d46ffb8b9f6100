"""Scenes of three boxes with known objects, as `drsplat register` and `drsplat objects` leave them, for catalogues."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from drsplat import EncoderIdentity, WordEncoder, read_gaussians, write_gaussians
from drsplat.field import LanguageField
from drsplat.formats.poses import write_cameras_json
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
