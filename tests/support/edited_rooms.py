"""A room to edit: a red ball and a blue one, with a field that knows both as objects, and the photos' poses."""

from pathlib import Path

from drsplat import WordEncoder, read_features, read_gaussians, read_views, register
from fields import with_flat_objects
from toy_capture import PER_THING, write_toy_capture


def write_room(folder: Path) -> Path:
    """scene.ply, room.field and capture/ in a folder."""
    write_toy_capture(folder)
    (folder / "points.ply").unlink()  # it has the same places: another scene beside the field
    gaussians, views = read_gaussians(folder / "scene.ply"), read_views(folder / "capture")
    features = read_features(folder / "capture/language_features", encoder=WordEncoder().identity)
    field = register(gaussians, views, features).to_field()
    with_flat_objects(field, gaussians, field.gaussian_ids // PER_THING).save(folder / "room.field")
    return folder
