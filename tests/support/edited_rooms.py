"""A room to edit: a red ball and a blue one, with a field that knows both as objects, and the photos' poses."""

from pathlib import Path

import numpy as np

from drsplat import WordEncoder, read_features, read_gaussians, read_views, register
from drsplat.field.objects.choosing import Tree
from drsplat.field.objects.describing import describe
from toy_capture import PER_THING, write_toy_capture


def write_room(folder: Path) -> Path:
    """scene.ply, room.field and capture/ in a folder."""
    write_toy_capture(folder)
    (folder / "points.ply").unlink()  # it has the same places: another scene beside the field
    gaussians, views = read_gaussians(folder / "scene.ply"), read_views(folder / "capture")
    features = read_features(folder / "capture/language_features", encoder=WordEncoder().identity)
    field = register(gaussians, views, features).to_field()
    node_of = (field.gaussian_ids // PER_THING).astype(np.int32)
    tree = Tree(node_of, np.full(2, -1, np.int32), np.ones(2, np.uint8), np.ones(2, np.float32))
    field.with_objects(describe(field, gaussians, tree)).save(folder / "room.field")
    return folder
