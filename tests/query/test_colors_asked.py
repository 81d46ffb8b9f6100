"""The built-in encoder is asked for colours: they compete with each other, and with no noun."""

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array

from drsplat import LanguageField, Scene
from drsplat.field import build_field
from drsplat.field.codes import Mixture
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.mini.lexicon import COLORS, ORANGE, only_colors, words_of
from drsplat.query.query import Query
from drsplat.query.ranking import Described, Surroundings
from fields import SCENE

MINI = MiniEncoder()
EACH = 400


def photos_like() -> LanguageField:
    """Three things that fit some noun better than any colour, as real photos do; red, white and brown fit best of the
    colours. The brown one fits brown only half as well as the others fit theirs."""
    nouns, colors = MINI.encode_texts(MINI.nouns), MINI.rivals("red")
    wrong = nouns[[MINI.nouns.index(name) for name in ("bottle", "sofa", "box")]]
    right = colors[[COLORS.index(color) for color in ("red", "white", "brown")]]
    pictures = 1.2 * wrong + np.array([[0.9], [0.9], [0.6]]) * right
    pictures = np.repeat(pictures / np.linalg.norm(pictures, axis=1, keepdims=True), EACH, 0).astype(np.float32)
    count = len(pictures)
    masks = MaskIds(("a.jpg",), np.zeros(count, np.int32), np.arange(count, dtype=np.int32))
    evidence = Evidence(csr_array(eye_array(count, dtype=np.float32, format="csr")), masks, pictures)
    return build_field(evidence, SCENE, MINI.identity, Mixture(1))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(photos_like(), encoder=MINI)


@pytest.mark.parametrize("text", ["something {}", "{}", "a {} thing", "the {} one", "anything {}"])
@pytest.mark.parametrize(("color", "thing"), [("red", 0), ("white", 1), ("brown", 2)])
def test_a_colour_is_found_though_nouns_fit_better(text, color, thing, scene):
    found = scene.ask(text.format(color)).gaussian_ids
    np.testing.assert_array_equal(found, np.arange(thing * EACH, (thing + 1) * EACH))


@pytest.mark.parametrize("color", ["blue", "green", "yellow", "purple"])
def test_a_colour_that_is_not_there_is_not_found(color, scene):
    assert not len(scene.ask(f"something {color}").gaussian_ids)


@pytest.mark.parametrize(("text", "expected"), [
    ("something red", True), ("white", True), ("a grey thing", True), ("the orange one", True), ("red mug", False),
    ("orange", False), ("a thing", False), ("wooden", False), ("something red and wooden", False),
])  # fmt: skip
def test_which_texts_ask_for_a_colour_only(text, expected):
    assert only_colors(text) == expected
    assert (MINI.rivals(text) is not None) == expected


def test_the_orange_one_is_a_colour():
    assert words_of("the orange one") == words_of("something orange") == [ORANGE]
    assert words_of("an orange") == ["orange"]


def test_objects_of_a_catalogue_are_asked_alike(scene):
    pictures = scene.field.evidence.embeddings
    objects = Described(pictures.reshape(3, EACH, -1)[:, :2].reshape(6, -1), np.array([0, 2, 4, 6]))
    around = Surroundings(scene.field, lambda: MINI, pictures[::50])
    query = Query("something red")
    np.testing.assert_array_equal(around.rank(query, around.vector(query), objects).selected, [True, False, False])
