"""The built-in encoder: its words, its network, what it says to strangers."""

from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from world.mini.augment import cut_out
from world.mini.texts import bank, said_of, truth

from drsplat import Scene
from drsplat.field import build_field
from drsplat.photos.models.loading import load_encoder
from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.mini.encoder import DIM, _pixels, embed_images
from drsplat.photos.models.mini.lexicon import (
    COLORS,
    GROUPS,
    MATERIALS,
    NAMES,
    ORANGE,
    PAINTS,
    STRUCTURES,
    WORDS,
    fits,
    swapped,
    words_of,
)
from drsplat.photos.models.word_list import NOUNS, broad_list
from drsplat.scene.encoders import Encoder, ImageEncoder
from drsplat.scene.masks.crops import crop
from fields import SCENE, random_evidence
from refusing import refused


@pytest.fixture(scope="module")
def mini() -> MiniEncoder:
    return MiniEncoder()


def test_it_is_an_encoder_of_words_and_images(mini):
    assert isinstance(mini, Encoder)
    assert isinstance(mini, ImageEncoder)
    assert mini.identity.dim == DIM
    assert mini.identity == MiniEncoder().identity
    assert -1 < mini.threshold < 1


def test_images_do_not_depend_on_their_batch(mini):
    rng = default_rng(1)
    images = [rng.integers(0, 256, (side, side, 3), np.uint8) for side in rng.integers(5, 200, 70)]
    together = mini.encode_images(images)
    assert_allclose(np.linalg.norm(together, axis=1), 1, atol=1e-5)
    assert_allclose(together[[0, 69]], mini.encode_images([images[0], images[69]]), atol=1e-5)
    assert mini.encode_images([]).shape == (0, DIM)


def test_images_that_are_not_square_get_black_borders(mini):
    wide = np.full((20, 60, 3), 200, np.uint8)
    square = np.zeros((60, 60, 3), np.uint8)
    square[20:40] = 200
    assert_allclose(mini.encode_images([wide]), mini.encode_images([square]), atol=1e-6)


def test_a_text_is_its_words_in_any_order_and_number(mini):
    texts = ["a red mug", "Red mugs", "mug, red", "a photo of the red mug", "mug of the color red", "red-coloured mug"]
    first, *others = mini.encode_texts(texts)
    assert_allclose(np.linalg.norm(first), 1, atol=1e-6)
    for other in others:
        assert_allclose(other, first, atol=1e-6)
    assert np.abs(mini.encode_texts(["blue mug"])[0] - first).max() > 0.01


@pytest.mark.parametrize(
    ("word", "singular"),
    [("knives", "knife"), ("shelves", "shelf"), ("boxes", "box"), ("candles", "candle"),
     ("things", "thing"), ("toys", "toy"), ("glass", "glass"), ("bus", "bus"), ("dishes", "dish")],
)  # fmt: skip
def test_plurals(word, singular):
    assert words_of(word) == [singular]


@pytest.mark.parametrize("text", ["elephant", "red elephant", "the", "", "mug 3 xyzzy"])
def test_what_it_was_not_taught_is_an_error(mini, text):
    with refused(r"not taught|no word"):
        mini.encode_texts([text])


def test_a_near_miss_is_helped(mini):
    with refused(r"'tabel'.*Did you mean 'table'"):
        mini.encode_texts(["tabel"])


@pytest.mark.parametrize(("word", "near"), [("dolls", "toy"), ("scissors", "knife"), ("wardrobe", "furniture")])
def test_the_nearest_in_meaning_is_named(mini, word, near):
    with refused(f"not taught '{word}'. The nearest to '{word}' that it knows: {near}[.,]"):
        mini.encode_texts([f"red {word}"])


def test_what_has_nothing_near_is_not_guessed(mini):
    with refused(r"not taught 'umbrella'\. It knows"):
        mini.encode_texts(["umbrella"])


def test_swapped_texts_have_the_colour_or_the_thing_and_not_both():
    texts = swapped("the red mugs")
    assert {"blue mug", "orange mug", "red vase", "red toy car"} <= {*texts}
    assert not {"red mug", "mug", "red"} & {*texts}
    assert len(texts) == len(COLORS) - 1 + len(NAMES) - 1
    assert not {"green apple", "green banana"} & {*swapped("green fruit")}  # which are some
    assert "black wooden chair" in swapped("red wooden chair")
    assert not any(map(swapped, ["mug", "something red", "red", "red and blue mug", "zebra"]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rote Tasse", "German, and the built-in encoder reads English: ask for 'red mug'"),
        ("une tasse rouge", "French.* ask for 'red mug'"),
        ("la taza roja", "Spanish.* ask for 'red mug'"),
        ("Sofás", "was not taught"),  # no form of it is listed: nothing is guessed
        ("blue chaise", "French.* ask for 'blue chair'"),
        ("红色的杯子", "Chinese.* ask for 'red mug'"),
        ("赤いコップ", "Japanese.* ask for 'red mug'"),
        ("кружка", "Russian.* ask for 'mug'"),
        ("rote foo", "was not taught 'rote', 'foo'"),
        ("кружка foo", "was not taught"),
    ],
)
def test_other_languages_are_named(mini, text, said):
    with refused(said):
        mini.encode_texts([text])


def test_other_languages_are_translated_to_what_was_taught(mini):
    file = files("drsplat.photos.models.mini") / "languages.txt"
    for line in file.read_text(encoding="utf-8").splitlines():
        if ": " in line and line[0] != "#":
            english, foreign = line.split(": ")
            assert english in {*NAMES, *COLORS, *MATERIALS, *STRUCTURES, "toy", "the"}, line
            assert english == "the" or not {*foreign.split()} & {*WORDS, *broad_list(), *NOUNS}, line


def test_the_lexicon_holds_together():
    assert {name for names in GROUPS.values() for name in names} <= {*NAMES, *STRUCTURES}
    assert {word for name in NAMES for word in name.split()} <= set(WORDS)
    assert fits("orange", "orange", "orange", "peel")
    assert fits(ORANGE, "mug", "orange", "ceramic")
    assert not fits("orange", "mug", "orange", "ceramic")
    assert not fits(ORANGE, "orange", "green", "peel")
    assert fits("carpet", "rug", "", "")
    assert fits("red", "rug", "", "") is fits("wood", "floor", "", "") is None
    assert fits("drink", "mug", "red", "ceramic")
    assert not fits("mug", "bowl", "red", "ceramic")
    assert fits("wooden", "chair", "brown", "wood")
    assert fits("thing", "chair", "brown", "wood")


@given(st.sampled_from(NAMES), st.sampled_from(COLORS), st.sampled_from(MATERIALS))
def test_every_thing_is_what_its_words_say(name, color, material):
    paint = PAINTS[COLORS.index(color)]
    assert all(fits(word, name, color, material) for word in [*name.split(), paint, material])


@pytest.mark.parametrize(
    ("text", "words"),
    [("an orange", ["orange"]), ("oranges", ["orange"]), ("orange carrots", [ORANGE, "carrot"]),
     ("orange orange", [ORANGE, "orange"]), ("something orange", [ORANGE]), ("orange thing", [ORANGE, "thing"]),
     ("red orange", ["red", "orange"]), ("anything that is orange", [ORANGE]),
     ("the colour orange", [ORANGE])],
)  # fmt: skip
def test_an_orange_is_a_fruit_or_a_colour(text, words):
    assert words_of(text) == words


def test_every_word_has_its_row(mini):
    assert mini.weights["words"].shape == (len(WORDS), DIM)


def test_a_field_of_it_is_asked_without_further_options(mini):
    evidence = random_evidence(default_rng(0), dim=DIM)
    field = build_field(evidence, SCENE, mini.identity)
    answer = Scene(field).ask("red mugs")
    assert (answer.measure, answer.rule) == ("relevancy", "list")
    assert_allclose(answer.scores, field.scores(mini.encode_texts(["red mug"])[0]), atol=1e-6)
    assert isinstance(load_encoder("drsplat-mini"), MiniEncoder)


# --- how it is learned -------------------------------------------------------------------------------


def test_what_is_said_of_a_thing_is_true():
    rng = default_rng(2)
    for name in NAMES:
        label = (name, COLORS[rng.integers(len(COLORS))], MATERIALS[rng.integers(len(MATERIALS))])
        assert (truth([label], [said_of(label, rng) for _ in range(40)]) == 1).all()
    for name in STRUCTURES:
        assert (truth([(name, "", "")], [said_of((name, "", ""), rng) for _ in range(40)]) == 1).all()


def test_nobody_knows_the_colour_of_a_wall():
    found = truth([("wall", "", "")], [("red", "wall"), ("red",), ("red", "mug"), ("wall",), ("wood",)])
    assert_array_equal(found, [[np.nan, np.nan, 0, 1, np.nan]])


def test_the_loss_is_over_what_is_known():
    torch = pytest.importorskip("torch", reason="learning needs torch")
    from world.mini.learning import doubt

    logits = torch.tensor([[0.0, 3.0], [-2.0, 5.0]])
    wanted = torch.tensor([[1.0, float("nan")], [0.0, float("nan")]])
    assert_allclose(float(doubt(logits, wanted)), np.log(2) + np.log(1 + np.exp(-2)), rtol=1e-6)


def test_most_random_texts_are_not_true_of_a_thing():
    rng = default_rng(3)
    texts = bank(2_000, rng)
    assert {word for text in texts for word in text} <= set(WORDS)
    assert 0.01 < truth([("mug", "red", "ceramic")], texts).mean() < 0.2


def test_learned_crops_are_cut_as_masks_are_embedded():
    rng = default_rng(4)
    image = rng.integers(0, 256, (96, 96, 3), np.uint8)
    mask = np.zeros((96, 96), bool)
    mask[10:50, 30:93] = rng.random((40, 63)) < 0.7
    mask[10, 30:93] = mask[49, 30:93] = mask[10:50, 30] = mask[10:50, 92] = True
    square = crop(image, mask[10:50, 30:93], (30, 10, 93, 50))
    shown = _pixels([square])[0]
    learned = cut_out(image, mask).astype(np.float32) / 127.5 - 1
    assert_array_equal(shown, learned)


def test_the_exported_network_is_the_learned_one():
    torch = pytest.importorskip("torch", reason="learning needs torch")
    from world.mini.learning import Tower, exported

    torch.manual_seed(0)
    tower = Tower()
    pixels = torch.rand(4, 3, 64, 64) * 2 - 1
    with torch.no_grad():
        for _ in range(3):
            tower.images(pixels)  # statistics of the batch normalisation
        expected = tower.eval().images(pixels).numpy()
    weights = {name: array.astype(np.float32) for name, array in exported(tower).items()}
    found = embed_images(pixels.permute(0, 2, 3, 1).numpy(), weights)
    assert_allclose((found * expected).sum(1), 1, atol=1e-3)
    assert np.abs(expected[0] - expected[1]).max() > 1e-3
