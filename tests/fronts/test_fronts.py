"""One engine: the same queries through Python, the command line, HTTP, MCP and the viewer have the same answers.

Whoever cannot ask something (a language model has no vectors, the viewer no exclusions) is not asked it. HTTP and MCP
round
what they tell to about a ten-thousandth of the scene.
"""

import base64
import io
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from callers import reply_of
from command_line import answer_of
from drsplat import Answer, Cut, Match, MiniEncoder, Query, Scene, open_scene
from drsplat.cli import make_parser, spelled
from drsplat.errors import DrSplatError
from drsplat.evaluation.demo import story as household
from drsplat.fronts.serving.conversation import Conversation
from drsplat.fronts.serving.scene_folder import SceneFolder
from drsplat.fronts.viewing.results import result_of
from drsplat.fronts.viewing.session import Session

PICTURE = np.zeros((40, 40, 3), np.uint8)
PICTURE[5:35, 5:35] = (200, 30, 30)


def vector(text: str) -> np.ndarray:
    return np.asarray(MiniEncoder().encode_texts([text])[0], np.float32)


@dataclass(frozen=True)
class Asked:
    """One query in the words of Python, of the command line and of HTTP. FOLDER: where files are."""

    name: str
    query: dict[str, Any]
    argv: tuple[str, ...]
    body: dict[str, Any] = field(default_factory=dict)

    @property
    def in_words(self) -> bool:
        return set(self.query) == {"text"}


def text(name: str, words: str, **more: Any) -> Asked:
    """More options are numbers and truths, which have one name everywhere."""
    flags = [
        part
        for key, value in more.items()
        for part in ([f"--{key.replace('_', '-')}"] + ([] if value is True else [str(value)]))
    ]
    return Asked(name, {"text": words, **more}, (words, *flags), {"text": words, **more})


def with_vector(name: str, **more: Any) -> Asked:
    words = text(name, "red vase", **more)
    body = {**words.body, "vector": vector("red vase").tolist()}
    body.pop("text")
    return Asked(name, {"vector": vector("red vase"), **more}, ("--vector", "FOLDER/q.npy", *words.argv[1:]), body)


def encoded(picture: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    return file.getvalue()


AT = (0.3, 0.14, 0.82)
PIXEL = {"view": "frame_00001", "x": 280, "y": 250}
CLICK = ("frame_00001", 280.0, 250.0)
GOOD = [
    text("one thing", "red vase"),
    text("several things", "toys"),
    text("another word", "couch"),
    text("large", "table"),
    text("not there", "laptop"),
    text("not there either", "teddy bear"),
    text("negation", "toys, not green"),
    Asked(
        "exclusion",
        {"text": "toys", "exclude": ("green",)},
        ("toys", "--exclude", "green"),
        {"text": "toys", "exclude": ["green"]},
    ),
    text("relevancy", "red vase", relevancy=True),
    Asked(
        "negatives",
        {"text": "red vase", "negatives": ("table", "wall")},
        ("red vase", "--negatives", "table,wall"),
        {"text": "red vase", "negatives": ["table", "wall"]},
    ),
    text("a share", "red vase", top_share=0.02),
    text("a fixed threshold", "red vase", threshold=0.7),
    text("the automatic threshold", "red vase", threshold="auto"),
    with_vector("a vector"),
    with_vector("a vector and a fixed threshold", threshold=0.25),
    with_vector("a vector's share", top_share=0.01),
    Asked(
        "a picture",
        {"image": PICTURE},
        ("--image", "FOLDER/q.png"),
        {"image": base64.b64encode(encoded(PICTURE)).decode()},
    ),
    Asked("a point", {"point": AT}, ("--point", ",".join(map(str, AT))), {"point": list(AT)}),
    Asked("a click", {"click": CLICK}, ("--click", "frame_00001:280,250"), {"click": PIXEL}),
    text("words without objects", "red vase", objects="never"),
    Asked(
        "a click without objects",
        {"click": CLICK, "objects": "never"},
        ("--click", "frame_00001:280,250", "--objects", "never"),
        {"click": PIXEL, "objects": "never"},
    ),
]
BAD = [
    text("no such word", "zeppelin"),
    text("half a negation", "mug, not"),
    text("two cuts", "mug", threshold="auto", relevancy=True),
    Asked(
        "two things",
        {"text": "mug", "point": AT},
        ("mug", "--point", "0.3,0.14,0.82"),
        {"text": "mug", "point": list(AT)},
    ),
    Asked(
        "an exclusion without words",
        {"point": AT, "exclude": ("red",)},
        ("--point", "0.3,0.14,0.82", "--exclude", "red"),
        {"point": list(AT), "exclude": ["red"]},
    ),
    Asked(
        "a short vector", {"vector": np.ones(7, np.float32)}, ("--vector", "FOLDER/short.npy"), {"vector": [1.0] * 7}
    ),
    Asked("nothing there", {"point": (90.0, 0.0, 0.0)}, ("--point", "90,0,0"), {"point": [90.0, 0.0, 0.0]}),
    Asked(
        "no such photo",
        {"click": ("nowhere", 1.0, 1.0)},
        ("--click", "nowhere:1,1"),
        {"click": {"view": "nowhere", "x": 1, "y": 1}},
    ),
]


def named(asked: list[Asked]) -> Any:
    return pytest.mark.parametrize("asked", asked, ids=[one.name for one in asked])


@pytest.fixture(scope="module")
def room(household_story: household.Story, household_folder: Path) -> Scene:
    return open_scene(household_folder)


@pytest.fixture(scope="module")
def scene_folder(household_folder: Path) -> SceneFolder:
    return SceneFolder(household_folder)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("asked")
    np.save(folder / "q.npy", vector("red vase"))
    np.save(folder / "short.npy", np.ones(7, np.float32))
    (folder / "q.png").write_bytes(encoded(PICTURE))
    return folder


def over_http(scene_folder: SceneFolder, act: str, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    """As a worker answers it."""
    reply = reply_of(scene_folder, act, json.loads(json.dumps(body)))
    return reply.status, json.loads(reply.body)


def on_the_command_line(files: Path, asked: Asked) -> list[str]:
    return [part.replace("FOLDER", str(files)) for part in asked.argv]


def same_matches(told: list[dict[str, Any]], expected: list[Match], exactly: bool) -> None:
    assert len(told) == len(expected)
    off = 0.0 if exactly else 2e-4
    for one, match in zip(told, expected, strict=True):
        assert one["num_gaussians"] == len(match)
        assert one["score"] == pytest.approx(match.score, abs=off)
        for key in ("center", "extent", "axes"):
            assert_allclose(one[key], getattr(match, key), rtol=0, atol=off)
        support = [(mask["view"], mask["mask"]) for mask in one["support"]]
        assert support == [(mask.view_name, mask.mask_id) for mask in match.support]


@pytest.mark.slow
@named(GOOD)
def test_the_command_line(asked, room, files, tmp_path, capsys):
    expected = room.ask(Query(**asked.query))
    argv, folder = on_the_command_line(files, asked), files_of(room)
    told = answer_of(capsys, "select", folder, *argv, "--save", tmp_path / "ids.npy")
    same_numbers(told, expected, 1e-12)
    assert_array_equal(np.load(tmp_path / "ids.npy"), expected.gaussian_ids)
    located = answer_of(capsys, "locate", folder, *argv, "--top", 100)
    same_matches(located["matches"], room.locate(expected), exactly=True)


@pytest.mark.slow
@named(GOOD)
def test_http(asked, room, scene_folder):
    expected = room.ask(Query(**asked.query))
    status, told = over_http(scene_folder, "select", {**asked.body, "ids": True})
    assert status == 200
    same_numbers(told["measured"], expected, 1e-5)
    assert_array_equal(told["gaussian_ids"], expected.gaussian_ids)
    _, located = over_http(scene_folder, "locate", {**asked.body, "top": 100})
    same_matches(located["matches"], room.locate(expected), exactly=False)


@named([asked for asked in GOOD if asked.in_words])
def test_language_models(asked, room, scene_folder):
    told = Conversation(room, "room").locate(asked.query["text"], top=20).model_dump()
    expected = room.ask(asked.query["text"])
    same_numbers(told["measured"], expected, 1e-5)
    assert told["num_matches"] == len(room.locate(expected))
    same_matches(told["matches"], room.locate(expected)[:20], exactly=False)


@pytest.mark.slow
def test_language_models_without_objects(room):
    talk, query = Conversation(room, "room"), Query("toys", objects="never")
    expected = room.locate(query)
    told = talk.locate("toys", top=20, objects="never").model_dump()
    same_numbers(told["measured"], room.ask(query), 1e-5)
    same_matches(told["matches"], expected[:20], exactly=False)
    assert talk.show("toys", objects="never").view.num_matches == told["num_matches"] == len(expected)
    assert talk.count("toys", objects="never").count == told["count"] == sum(match.sure for match in expected)
    place = talk.where_is("toys", objects="never").best
    same_matches([place.model_dump()], expected[:1], exactly=False)
    apart = talk.how_far_apart("red vase", "candle", objects="never")
    (vase, *_), (candle, *_) = (room.locate(Query(one, objects="never")) for one in ("red vase", "candle"))
    assert_allclose(apart.offset, candle.center - vase.center, atol=2e-4)


@pytest.mark.slow
@named(GOOD)
def test_the_viewer(asked, room):
    """Words and pictures are asked in its panel; of other answers it shows the same matches."""
    session, expected = Session(room), room.ask(Query(**asked.query))
    if asked.in_words:
        session.ask(asked.query["text"])
    elif "image" in asked.query:
        session.ask_picture(PICTURE, "q.png")
    else:
        session.results = (result_of(room, asked.name, expected),)
    (result,) = session.results
    assert_array_equal(result.answer.values, expected.values)
    assert result.threshold == expected.threshold
    for shown, match in zip(result.matches, room.locate(expected), strict=True):
        assert_array_equal(shown.gaussian_ids, match.gaussian_ids)
        assert_array_equal(shown.center, match.center)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [{}, {"threshold": 0.6}, {"relevancy": True}, {"objects": "never"}])
def test_classes(cut, room, scene_folder, capsys):
    names = ["red vase", "laptop", "orange sofa"]
    expected = room.segment(names, Cut(**cut))
    flags = ["--relevancy"] if "relevancy" in cut else [f"--{name}={value}" for name, value in cut.items()]
    told = answer_of(capsys, "segment", files_of(room), "--classes", ",".join(names), *flags)
    _, sent = over_http(scene_folder, "segment", {"classes": names, "labels": True, **cut})
    for one in (told, sent):
        assert [part["num_gaussians"] for part in one["classes"]] == expected.counts
    assert_array_equal(sent["labels"], expected.labels)
    if not cut:
        assert_array_equal(Session(room).classify(names).labels, expected.labels)


@named(BAD)
def test_bad_input_is_told_in_the_same_words(asked, room, files, scene_folder, capsys):
    """The command line has its flags for the names of arguments, and nothing else of its own."""
    with pytest.raises(DrSplatError) as caught:
        room.ask(Query(**asked.query))
    status, told = over_http(scene_folder, "select", asked.body)
    assert (status, told["error"]) == (422, str(caught.value))
    argv = ["select", files_of(room), *on_the_command_line(files, asked)]
    flags = make_parser().parse_args(list(map(str, argv))).flags
    answer = answer_of(capsys, *argv, code=1)
    assert answer["error"] == spelled(str(caught.value), flags)
    assert answer["kind"] == type(caught.value).__name__
    if asked.in_words:
        with pytest.raises(DrSplatError) as of_mcp:
            Conversation(room, "room").locate(asked.query["text"])
        with pytest.raises(DrSplatError) as of_viewer:
            Session(room).ask(asked.query["text"])
        assert str(of_mcp.value) == str(of_viewer.value) == str(caught.value)


def files_of(room: Scene) -> Path:
    folder = room.views[0].image_path
    assert folder is not None
    return Path(folder).parent.parent


def same_numbers(told: dict[str, Any], expected: Answer, off: float) -> None:
    assert told["measure"] == expected.measure
    assert told["threshold_rule"] == expected.rule
    assert told["threshold"] == pytest.approx(expected.threshold, rel=off)
    assert told["num_selected"] == len(expected.gaussian_ids)
    assert told["num_registered"] == len(expected.field)
