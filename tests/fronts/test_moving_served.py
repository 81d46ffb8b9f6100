"""Scenes that move, over HTTP and for language models: where and when, as the library has it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from callers import reply_of
from drsplat import open_scene
from drsplat.cli import main
from moving_scenes import write_film


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder to serve: one film, its field and its photos."""
    made = tmp_path_factory.mktemp("scenes") / "film"
    made.mkdir()
    write_film(made)
    capture = made / "capture"
    transforms = json.loads((capture / "transforms.json").read_text())
    for frame in transforms["frames"]:
        frame["time"] = int(Path(frame["file_path"]).stem)
    (capture / "transforms.json").write_text(json.dumps(transforms))
    for path in list(capture.iterdir()):
        path.rename(made / path.name)
    argv = ["register", made / "frames", made, "--features", made / "language_features", "--encoder-name",
            "drsplat-words", "--output", made / "film.field"]  # fmt: skip
    assert main(list(map(str, argv))) == 0
    return made.parent


def asked(folder: Path, act: str, what: dict[str, Any], status: int = 200) -> dict[str, Any]:
    reply = reply_of(folder, act, what)
    assert reply.status == status, reply.body
    body: dict[str, Any] = json.loads(reply.body)
    return body


def tool(folder: Path, name: str, **arguments: Any) -> dict[str, Any]:
    return asked(folder, "tool", {"tool": name, "name": "film", "arguments": arguments})


def test_a_scene_says_that_it_moves(folder):
    assert asked(folder, "details", {"name": "film"})["times"] == [0, 5]
    assert tool(folder, "about_scene")["times"] == [0, 5]


def test_tracks_are_those_of_the_library(folder):
    (match,) = asked(folder, "locate", {"text": "red car", "tracks": True})["matches"]
    scene = open_scene(folder / "film")
    (track,) = scene.tracks(scene.locate("red car"))
    told = match["track"]
    assert told["times"] == track.times.tolist()
    for name in ("centers", "extents", "axes"):
        assert np.allclose(told[name], getattr(track, name), atol=1e-3)
    assert (told["spans"], told["views"]) == ([[0, 5]], list(track.views))
    assert asked(folder, "locate", {"text": "red car"})["matches"][0]["track"] is None
    (listed,) = tool(folder, "locate", text="red car", tracks=True)["matches"]
    assert listed["track"]["times"] == told["times"]


def test_a_model_reads_a_few_times_of_many(folder, monkeypatch):
    monkeypatch.setattr("drsplat.fronts.serving.conversation.MAX_TRACK_TIMES", 3)
    (listed,) = tool(folder, "locate", text="red car", tracks=True)["matches"]
    assert listed["track"]["times"] == [0, 2, 5]
    assert len(listed["track"]["centers"]) == len(listed["track"]["views"]) == 3


def test_when_is_that_of_the_library(folder):
    scene = open_scene(folder / "film")
    what = {"one": "red car", "relation": "left_of", "other": "white vase", "view": "cam0/00"}
    told = asked(folder, "when", what)
    assert told["spans"] == [list(span) for span in scene.when("red car", "left_of", "white vase", "cam0/00")] != []
    assert told["times"] == [0, 5]
    assert told == tool(folder, "when", **what)
    never = asked(folder, "when", {"one": "red car", "relation": "on", "other": "white vase"})
    assert never["spans"] == []
    assert "at no time" in never["advice"]


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ({"relation": "left_of"}, "give view=NAME"),
        ({"relation": "on", "other": "green apple"}, "green apple"),
        ({"relation": "left_of", "view": "nowhere"}, "nowhere"),
    ],
)
def test_what_cannot_be_told_is_said(folder, what, said):
    body = asked(folder, "when", {"one": "red car", "other": "white vase"} | what, 422)
    assert said in body["error"]
