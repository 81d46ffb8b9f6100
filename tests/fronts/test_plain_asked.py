"""`objects="never"`: the answers of a field without objects, to the bit, whoever asks."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from command_line import answer_of, error_of
from drsplat import Answer, Cut, Match, Query, Scene, load_field, read_gaussians
from drsplat.authoring.editing.resolving import query_rows
from drsplat.field.labels import LabelFile
from drsplat.query.sheets import attribute_row
from fields import with_flat_objects
from known_objects import CENTERS, TEST, described, known_field, known_scene
from moving_scenes import passing_scene
from scenes import look_at_view
from toy_capture import PER_THING, write_balls


class Axes:
    """Texts are numbers of axes, between which they lie; a picture lies on the axis of its first pixel."""

    identity = TEST
    threshold = 0.5  # of fields that keep no list of words

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        sums = np.stack([np.eye(8, dtype=np.float32)[list(map(int, text.split()))].sum(0) for text in texts])
        return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True), np.float32)

    def encode_images(self, images: Sequence[np.ndarray]) -> np.ndarray:
        return np.stack([np.eye(8, dtype=np.float32)[int(image.max()) % 8] for image in images])


PHOTO = replace(look_at_view((0.5, -4.0, 1.5), CENTERS[0]), name="photo")
CLICK = (PHOTO.name, PHOTO.width / 2, PHOTO.height / 2)  # the middle of the first box


def noisy_scene(*, listed: bool = False) -> Scene:
    """Three boxes whose masks, and so whose Gaussians, have features of their own; with `listed` a list of words."""
    gaussians, rng = known_scene(), np.random.default_rng(3)
    embeddings = np.eye(8)[[0, 1, 2, 0, 1, 2, 3, 0, 1, 2]] + 0.3 * rng.normal(size=(10, 8))
    embeddings /= np.linalg.norm(embeddings, axis=1, keepdims=True)
    field = known_field(gaussians, embeddings.astype(np.float32))
    if listed:
        field = field.with_contrast(np.eye(8, dtype=np.float32), tuple("01234567"))
    field = field.with_objects(described(field, gaussians))
    return Scene(field, gaussians, [PHOTO], Axes())


def without_objects(scene: Scene) -> Scene:
    field = scene.field.with_objects(None)
    return Scene(field, scene.motion or scene.gaussians, scene.views, lambda: scene.encoder)


SCENES = [noisy_scene(), noisy_scene(listed=True)]
QUERIES: dict[str, dict[str, Any]] = {
    "text": {"text": "0"},
    "text and threshold": {"text": "0", "threshold": 0.4},
    "share": {"text": "1", "top_share": 0.1},
    "relevancy": {"text": "1", "relevancy": True, "negatives": ("2", "3")},
    "negation": {"text": "0, not 3"},
    "exclusion": {"text": "0", "exclude": ("1", "3")},
    "vector": {"vector": np.linspace(1, -0.4, 8, dtype=np.float32)},
    "image": {"image": np.full((9, 7, 3), 2, np.uint8)},
    "point": {"point": CENTERS[1]},
    "click": {"click": CLICK},
    "click and threshold": {"click": CLICK, "threshold": 0.5},
}  # fmt: skip


def same_matches(found: list[Match], expected: list[Match]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert one.object_id is None
        for part in fields(Match):
            assert_array_equal(getattr(one, part.name), getattr(other, part.name))


def same_answers(given: Answer, expected: Answer) -> None:
    assert (given.measure, given.threshold, given.rule) == (expected.measure, expected.threshold, expected.rule)
    for name in ("values", "scores", "vector", "gaussian_ids"):
        assert_array_equal(getattr(given, name), getattr(expected, name))


@pytest.mark.parametrize("scene", SCENES, ids=["bare", "listed"])
@pytest.mark.parametrize("kind", QUERIES)
def test_answers_and_places_are_those_of_the_plain_field(kind, scene):
    query, plain = Query(**QUERIES[kind]), without_objects(scene)
    never = replace(query, objects="never")
    same_answers(scene.ask(never), plain.ask(query))
    same_answers(plain.ask(never), plain.ask(query))
    same_matches(scene.locate(never), plain.locate(query))
    assert (scene.ask(query).values != plain.ask(query).values).any()


@pytest.mark.parametrize("scene", SCENES, ids=["bare", "listed"])
def test_classes_are_those_of_the_plain_field(scene):
    names, plain = ("0", "1", "3"), without_objects(scene)
    for cut in (Cut(), Cut(threshold=0.3), Cut(relevancy=True, negatives=("2",))):
        found, expected = scene.segment(names, replace(cut, objects="never")), plain.segment(names, cut)
        assert_array_equal(found.labels, expected.labels)
        for one, other in zip(found.answers, expected.answers, strict=True):
            same_answers(one, other)
    whole = scene.segment(names).answers[0]
    assert (whole.values != plain.segment(names).answers[0].values).any()


def test_both_ways_share_what_queries_are_compared_with():
    scene = noisy_scene(listed=True)
    scene.ask("0")
    known = scene.background.kept_contrast
    answer = scene.ask(Query("0", objects="never"))
    assert scene.background.kept_contrast is known
    assert answer.field is scene.ask(Query("1", objects="never")).field
    assert answer.field.objects is None
    assert scene.ask("0").field.objects is not None


def test_a_label_is_a_word_like_others(tmp_path):
    scene = noisy_scene()
    named = Scene(scene.field, scene.gaussians, encoder=Axes(), labels=LabelFile.beside(tmp_path / "known.field"))
    named.label(named.field.objects.thing(2), "7")
    assert named.ask("7").rule == "label"
    same_answers(named.ask(Query("7", objects="never")), without_objects(scene).ask("7"))


def test_a_span_of_time_too():
    scene = passing_scene(objects=True)
    query = Query("red car", during=(0.0, 0.2))
    same_matches(scene.locate(replace(query, objects="never")), without_objects(scene).locate(query))


def mislabelled(folder: Path) -> Scene:
    """A scene that moves, whose vase is labelled "red car"."""
    scene = passing_scene(objects=True)
    (vase,) = scene.locate("white vase")
    labels = LabelFile.beside(folder / "known.field")
    named = Scene(scene.field, scene.moving, scene.views, labels=labels)
    named.label(scene.field.objects.thing(vase.object_id), "red car")
    return named


def test_relations_too(tmp_path):
    scene = mislabelled(tmp_path)
    expected = without_objects(scene).when("red car", "next_to", "white vase")
    one, other = (Query(words, objects="never") for words in ("red car", "white vase"))
    assert scene.when(one, "next_to", other) == expected != scene.when("red car", "next_to", "white vase")


def test_services_ask_for_relations_too(tmp_path):
    pytest.importorskip("pydantic")
    from drsplat.fronts.serving.conversation import Conversation
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.query_fields import When
    from drsplat.fronts.serving.worker import when

    scene, asked = mislabelled(tmp_path), {"one": "red car", "relation": "next_to", "other": "white vase"}
    expected = list(map(list, without_objects(scene).when(*asked.values())))
    talk = Conversation(scene, "film")
    assert when(scene, When(**asked, objects="never"), Limits()).spans == expected
    assert talk.when(**asked, objects="never").spans == expected
    assert talk.when(**asked).spans == when(scene, When(**asked), Limits()).spans != expected


def test_edits_and_pictures_of_attributes_too():
    scene, never = noisy_scene(), Query("0", threshold=0.6, objects="never")
    plain = without_objects(scene)
    assert_array_equal(query_rows(scene, never).spans, query_rows(plain, never).spans)
    match = scene.locate(Query(point=CENTERS[0]))[0]
    row = attribute_row(scene, match, [Query("0", objects="never"), Query("3", objects="never")])
    assert_array_equal(row, attribute_row(plain, match, ["0", "3"]))
    assert (row != attribute_row(scene, match, ["0", "3"])).any()


# --- the command line ---


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two balls, both of one object: at a threshold of 0.4 it is "red mug" as a whole."""
    folder = write_balls(tmp_path_factory.mktemp("plain"))
    field = load_field(folder / "room.field")
    one = with_flat_objects(field, read_gaussians(folder / "scene.ply"), np.zeros(len(field)))
    one.save(folder / "room.field", overwrite=True)
    return folder


NEVER = ("--objects", "never")


def argv_of(room: Path, verb: str, *more: object) -> list[object]:
    if verb in ("edit", "render"):
        words = (verb, room / "scene.ply", "--field", room / "room.field", "--query", "red mug")
    else:
        asked = ("--classes", "red mug") if verb == "segment" else ("red mug",)
        words = (verb, room / "room.field", *asked, "--scene", room / "scene.ply")
    return [*words, "--threshold", "0.4", *more]


def test_edits_and_renderings(room, tmp_path, capsys):
    for never, count in (((), 2 * PER_THING), (NEVER, PER_THING)):
        argv = argv_of(room, "edit", *never, "--isolate", "--save", tmp_path / "out.ply", "--overwrite")
        answer_of(capsys, *argv)
        assert len(read_gaussians(tmp_path / "out.ply")) == count
        drawn = ("--views", room / "capture", "--view", "photo_0.png", "-o", tmp_path / "drawn", "--overwrite")
        assert answer_of(capsys, *argv_of(room, "render", *never, *drawn))["num_selected"] == count


@pytest.mark.parametrize("verb", ["select", "locate", "segment", "edit", "render", "when"])
def test_any_other_word_is_misuse(verb, room, capsys):
    asked = ("when", room, "a", "on", "b") if verb == "when" else argv_of(room, verb)
    said = error_of(capsys, *asked, "--objects", "nevr", code=2)
    assert "--objects" in said
    assert "did you mean never?" in said
