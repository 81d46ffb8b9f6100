"""A scene in few vectors answers as the scene itself does."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from safetensors.numpy import load, save

from catalogued import boxes_of
from drsplat import Query, Scene, WordEncoder
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.query.sketch import Packed, Sketch, SketchedScene, _Copies, sketch_of
from known_objects import known_scene
from refusing import malformed

WORDS = ("red mug", "wooden table", "green plant")


@pytest.fixture(scope="module")
def scene() -> Scene:
    gaussians = known_scene()
    return Scene(boxes_of(WORDS, gaussians), gaussians)


@pytest.fixture(scope="module")
def sketch(scene) -> Sketch:
    return sketch_of(scene)


def sketched(scene: Scene, sketch: Sketch) -> SketchedScene:
    return SketchedScene(sketch, scene.field.encoder, WordEncoder)


@pytest.mark.parametrize(
    "query",
    [
        *(Query(text) for text in ("red mug", "mug", "table", "lamp", "plant", "mug, not red", "red")),
        Query("mug", threshold=0.9),
        Query("mug", threshold=-1.0),
        Query("mug", relevancy=True),
        Query("plant", exclude=("green",)),
        Query(vector=WordEncoder().encode_texts(["wooden table"])[0]),
    ],
)
def test_it_answers_as_the_scene_does(scene, sketch, query):
    own = {match.object_id for match in scene.locate(query)}
    assert set(np.flatnonzero(sketched(scene, sketch).answers(query))) == own


@pytest.mark.parametrize("text", ["sofa", "lamp"])
def test_a_text_that_another_of_a_list_fits_nearly_as_well_is_not_answered(scene, sketch, text):
    """The rival is named of rows of the scene, of which a sketch has few vectors."""
    texts = ["red mug", "red bowl", "sofa", "lamp", "door"]
    encoder = VocabularyEncoder(WordEncoder.identity, texts, WordEncoder().encode_texts(texts))
    assert not SketchedScene(sketch, scene.field.encoder, lambda: encoder).answers(Query(text)).any()


def test_names_that_people_gave_are_meant_exactly(scene, sketch):
    labelled = sketched(scene, replace(sketch, labels={1: "Red Mug"}))
    assert labelled.answers(Query("red mug ")).tolist() == [False, True, False]
    assert labelled.answers(Query("red mug", threshold=0.5)).tolist() == [True, False, False]


def test_what_has_few_gaussians_that_can_be_seen_is_no_match(scene, sketch):
    for solid, found in ((40, True), (39, False)):
        few = replace(sketch, solid=np.int32([solid, 500, 500]))
        assert sketched(scene, few).answers(Query("red mug")).tolist() == [found, False, False]


def test_it_stands_for_all_rows(scene, sketch):
    objects = scene.field.objects
    numbers = objects.thing_of()
    assert sketch.counts.sum() == len(scene.field)
    assert_array_equal(np.bincount(sketch.numbers, sketch.counts), np.bincount(numbers))
    off = sketch.counts @ sketch.features.vectors - scene.field.feature(slice(None)).sum(0)
    assert (np.abs(off) <= 0.51 * len(scene.field) * sketch.features.steps).all()


def test_bytes_and_back(sketch):
    back = Sketch.from_bytes(sketch.to_bytes(), 512)
    for name in ("features", "pictures", "words"):
        assert_array_equal(getattr(back, name).vectors, getattr(sketch, name).vectors)
    for name in ("counts", "numbers", "solid"):
        assert_array_equal(getattr(back, name), getattr(sketch, name))
    assert back.labels == sketch.labels


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("counts", None),
        ("counts", np.array([2**30] * 3, np.int32)),
        ("counts", np.int32([0, 1, 1])),
        ("counts", np.ones(3, np.int64)),
        ("counts", np.ones(2, np.int32)),
        ("numbers", np.int32([0, 1, 3])),
        ("numbers", np.int32([0, 1, -2])),
        ("solid", np.ones(2, np.int32)),
        ("solid", np.ones((3, 1), np.int32)),
        ("labels", None),
        ("labels", np.frombuffer(b"[1]", np.uint8)),
        ("labels", np.frombuffer(b'{"0": 1}', np.uint8)),
        ("labels", np.frombuffer(b'{"a": "mug"}', np.uint8)),
        ("labels", np.frombuffer(b'{"3": "mug"}', np.uint8)),
        ("labels", np.frombuffer(b'{"-1": "mug"}', np.uint8)),
        ("labels", np.frombuffer(b"[" * 100_000, np.uint8)),
        ("labels", np.frombuffer(b"\xff", np.uint8)),
        ("features", np.ones((3, 512), np.float32)),
        ("features", np.ones((3, 383), np.uint8)),
        ("features", np.ones((3, 512), np.int8)),
        ("features_steps", np.full(512, np.nan, np.float32)),
        ("features_steps", np.full(512, 3e38, np.float32)),
        ("pictures", Packed.of(np.zeros((4, 512), np.float32)).data),
        ("pictures", np.zeros((0, 384), np.uint8)),
    ],
)
def test_damaged_sketches_are_refused(name, value):
    vectors, none = Packed.of(WordEncoder().encode_texts(list(WORDS))), Packed.of(np.empty((0, 512), np.float32))
    numbers, ones = np.arange(3, dtype=np.int32), np.ones(3, np.int32)
    whole = Sketch(vectors, numbers + 1, numbers, vectors, none, ones, {2: "Tasse für Öl"})
    arrays = load(whole.to_bytes())
    assert Sketch.from_bytes(save(arrays), 512).labels == whole.labels
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    with malformed("sketch of a scene"):
        Sketch.from_bytes(save(arrays), 512)


@pytest.mark.parametrize("data", [b"", b"{}", b"\xff" * 8 + b"{}", b"no sketch at all"])
def test_other_bytes_are_refused(data):
    with malformed("no sketch"):
        Sketch.from_bytes(data, 512)


def test_copies_are_searched_as_any_code():
    rng = np.random.default_rng(0)
    vectors, queries = rng.standard_normal((4, 8)).astype(np.float32), rng.standard_normal((3, 8)).astype(np.float32)
    code = _Copies(Packed.of(vectors / 4), np.int32([2, 0, 0, 3, 1]))
    every = code.decode(np.arange(5)) @ queries.T
    assert_allclose(code.scores(queries), every.T, rtol=1e-5)
    best = code.best(queries)
    assert_array_equal(best.index, every.argmax(1))
    assert_allclose(np.stack([best.scores, best.runner_up], 1), np.sort(every, axis=1)[:, :0:-1], rtol=1e-5)
    assert_array_equal(code.top(queries[0], 2).rows, np.argsort(-every[:, 0], kind="stable")[:2])
    assert_array_equal(code.select(queries[0], 0.0).rows, np.flatnonzero(every[:, 0] > 0))
    assert len(code.rows(np.array([1, 1]))) == 2
