"""Scenes whose photos arrive one by one: a folder with the first photos registered, and the others to be sent."""

import base64
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from drsplat import MiniEncoder, View, load_segmenter, read_features, read_gaussians, read_views
from drsplat.field import LanguageField
from drsplat.field.objects.finding import find_objects
from drsplat.field.registration import register
from drsplat.formats.poses import write_cameras_json
from drsplat.photos.embedding.embed import embed
from toy_capture import write_toy_capture

FEATURES = "language_features"


@pytest.fixture(scope="module")
def full_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A toy scene with all four photos registered at once."""
    made = write_toy_capture(tmp_path_factory.mktemp("live"))
    return write_room(made / "scene.ply", made / "full", read_views(made / "capture"), objects=True)


@pytest.fixture(scope="module")
def half_room(full_room: Path) -> Path:
    """The scene with the first two of them."""
    return first_views(full_room, full_room.parent / "half", 2, objects=True)


def write_room(source: Path, folder: Path, views: Sequence[View], *, objects: bool = False) -> Path:
    """A scene with a field of these views, masked and embedded by the built-in models. source: its Gaussians."""
    (folder / "images").mkdir(parents=True)
    for view in views:
        assert view.image_path is not None
        shutil.copy(view.image_path, folder / "images" / view.name)
    shutil.copy(source, folder / source.name)
    write_cameras_json(folder / "cameras.json", list(views))
    return with_field(folder, objects)


def first_views(room: Path, folder: Path, count: int, *, objects: bool = False) -> Path:
    """The scene of `room` with its first views alone; their poses are the same to the bit."""
    shutil.copytree(room, folder, ignore=shutil.ignore_patterns(FEATURES, "*.field"))
    cameras = json.loads((room / "cameras.json").read_text())
    (folder / "cameras.json").write_text(json.dumps(cameras[:count]))
    return with_field(folder, objects)


def first_of_demo(demo: Path, folder: Path, names: Sequence[str]) -> Path:
    """The demo's room with these photos alone, of the capture and of the field."""
    shutil.copytree(demo, folder, ignore=shutil.ignore_patterns(FEATURES, "*.field", "answers", "images"))
    poses = folder / "sparse/0/images.txt"
    lines = [line for line in poses.read_text().splitlines() if line.rpartition(" ")[2] in names]
    poses.write_text("".join(f"{line}\n\n" for line in lines))
    (folder / "images").mkdir()
    for name in names:
        shutil.copy(demo / "images" / name, folder / "images")
    return with_field(folder, objects=True)


def with_field(folder: Path, objects: bool) -> Path:
    views = read_views(folder)
    embed(views, folder / FEATURES, load_segmenter("graph"), MiniEncoder())
    registered(folder, views, objects=objects).save(folder / "room.field")
    return folder


def registered(folder: Path, views: Sequence[View], *, objects: bool = False) -> LanguageField:
    """The field of a folder's scene, registered at once."""
    scene = read_gaussians(next(path for path in folder.iterdir() if path.suffix in (".ply", ".spz")))
    features = read_features(folder / FEATURES, encoder=MiniEncoder().identity)
    field = register(scene, list(views), features).to_field()
    return field.with_objects(find_objects(field, scene)) if objects else field


def posted(view: View, **changes: Any) -> dict[str, Any]:
    """The JSON that sends a view, with its pose and lens to the bit."""
    assert view.image_path is not None
    K = view.K
    lens: dict[str, Any] = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    if view.distortion is not None:
        lens |= dict(zip(("k1", "k2", "p1", "p2"), view.distortion, strict=True))
    picture = base64.b64encode(view.image_path.read_bytes()).decode()
    pose = {"cam_from_world": view.cam_from_world.tolist()}
    body: dict[str, Any] = json.loads(json.dumps({"name": view.name, "picture": picture, "pose": pose, "lens": lens}))
    return body | changes
