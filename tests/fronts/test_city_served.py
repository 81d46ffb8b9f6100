"""A scene in tiles over HTTP and MCP: each route and tool answers as of the same scene in one file, or says why not."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from callers import reply_of
from cities import write_city
from drsplat.formats.tiles import Tiles
from drsplat.fronts.serving.replies import Reply
from drsplat.fronts.serving.scene_folder import SceneFolder
from drsplat.fronts.serving.worker import ANSWERS
from toy_capture import THINGS

WORDS = list(THINGS)
SURFACE = [-0.7, -0.3, 0.0]
CLICK = {"view": "photo_0.png", "x": 30, "y": 42}
ASKED: list[tuple[str, dict[str, Any]]] = [
    ("details", {"name": "city"}), ("photo", {"view": "photo_1.png", "max_side": 80}), ("objects", {"all": True}),
    ("object-picture", {"number": 1}), ("object-ply", {"number": 0}), ("select", {"text": "red mug", "ids": True}),
    ("locate", {"text": "red mug"}), ("locate", {"point": SURFACE, "box": "free"}),
    ("locate", {"click": CLICK, "objects": "never"}), ("segment", {"classes": WORDS, "labels": True}),
    ("what-is", {"point": SURFACE, "names": WORDS}), ("what-is", {"click": CLICK, "names": WORDS}),
    ("picture", {"text": "red mug"}), ("picture", {"view": "photo_2.png"}),
]  # fmt: skip
TOOLS: list[tuple[str, dict[str, Any]]] = [
    ("about_scene", {}), ("locate", {"text": "red mug"}), ("count", {"text": "plate"}),
    ("where_is", {"text": "blue plate"}), ("how_far_apart", {"first": "red mug", "second": "blue plate"}),
    ("what_is_at", {"point": SURFACE, "names": WORDS}),
    ("what_is_at_pixel", {"view": "photo_0.png", "x": 30.0, "y": 42.0, "names": WORDS}),
    ("list_objects", {"unsure": True}), ("relations", {"relation": "next_to", "to": "0"}),
    ("describe_region", {"center": SURFACE, "radius": 0.5, "names": WORDS}), ("show", {"text": "red mug"}),
    ("show", {}),
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both scenes as `drsplat serve` takes them: the cameras lie beside the field."""
    made = write_city(tmp_path_factory.mktemp("city"))
    for name in ("tiled", "whole"):
        for part in ("cameras.json", "images"):
            shutil.move(made / name / "capture" / part, made / name / part)
    return made


@pytest.fixture(autouse=True)
def nothing_reads_all() -> Iterator[None]:
    with patch.object(Tiles, "gaussians", side_effect=AssertionError("the whole scene was read")):
        yield


def both(folder: Path, act: str, given: dict[str, Any]) -> list[Reply]:
    scenes = SceneFolder(folder)
    return [reply_of(scenes, act, given, name) for name in ("tiled", "whole")]


@pytest.mark.parametrize(("act", "given"), ASKED)
def test_routes_answer_as_of_one_file(folder, act, given):
    tiled, whole = both(folder, act, given)
    assert whole.status == 200, whole.body
    assert tiled == whole


def test_every_route_is_asked():
    assert {act for act, _ in ASKED} | {"when", "export", "tool"} == set(ANSWERS)


@pytest.mark.parametrize(("tool", "arguments"), TOOLS)
def test_tools_answer_as_of_one_file(folder, tool, arguments):
    tiled, whole = both(folder, "tool", {"tool": tool, "name": "city", "arguments": arguments})
    assert whole.status == 200, whole.body
    assert tiled == whole


def test_what_needs_the_whole_is_refused_with_the_way_out(folder):
    tiled, whole = both(folder, "export", {"format": "glb"})
    assert (tiled.status, whole.status) == (422, 200)
    said = json.loads(tiled.body)["error"]
    assert "300 Gaussians is in tiles" in said
    assert "drsplat export" in said
    still = reply_of(folder, "when", {"one": "mug", "relation": "on", "other": "plate"}, "tiled")
    assert (still.status, "stands still" in json.loads(still.body)["error"]) == (422, True)


def test_a_damaged_tile_is_a_fault_of_the_scene_and_names_no_folder(folder, tmp_path):
    place = Path(shutil.copytree(folder / "tiled", tmp_path / "scenes" / "tiled")).parent
    scenes = SceneFolder(place)
    assert reply_of(scenes, "locate", {"text": "red mug"}).status == 200
    for tile in (place / "tiled/city.tiles").glob("*.shapes.safetensors"):
        tile.write_bytes(tile.read_bytes()[:-9])
    reply = reply_of(scenes, "locate", {"text": "red mug"})
    error = json.loads(reply.body)["error"]
    assert (reply.status, json.loads(reply.body)["kind"]) == (503, "SceneFaultError")
    assert error.startswith("scene 'tiled' cannot be read: tiled/city.tiles/tile0000")
    assert str(place) not in error
    assert reply_of(scenes, "select", {"text": "red mug"}).status == 200  # it needs no places
