"""Answers that are sure, maybe or nothing."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from test_contrast import World, field_and_truth, relevancies, words_of

from drsplat import Answer, Cut, EncoderIdentity, Query, Scene
from drsplat.errors import InputError
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.photos.models.word_list import broad_list, names_under
from drsplat.query.contrast import CLEAR_MARGIN, MAYBE_SPREADS, certainty_of, contrast_of
from drsplat.query.defaults import MAYBE, NOTHING, SURE
from drsplat.query.thresholds import PEAK_ROWS
from fields import unit_rows

SHARES = {0: 0.55, 1: 0.25, 2: 0.2}


@pytest.mark.parametrize(
    ("short", "said"), [(-0.01, SURE), (0.01, MAYBE), (MAYBE_SPREADS - 0.01, MAYBE), (MAYBE_SPREADS + 0.01, NOTHING)]
)
def test_a_peak_that_nearly_stands_clear_is_a_maybe(short, said):
    margins = np.where(np.arange(1000) < PEAK_ROWS, CLEAR_MARGIN - short, -3.0)
    assert certainty_of(relevancies(margins), PEAK_ROWS, CLEAR_MARGIN) == said


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    """Scenes of three things, one of which looks less and less like word 1 and more and more like word 9."""
    world = World(40)
    made = []
    for share in np.linspace(0, 1, 21):
        meaning = (1 - share) * world.meanings[1] + share * world.meanings[9]
        mixed = World(40)
        mixed.meanings = world.meanings.copy()
        mixed.meanings[1] = meaning / np.linalg.norm(meaning)
        field, _ = field_and_truth(mixed, SHARES, rows=1200)
        names = tuple(f"word {n}" for n in range(40))
        made.append(Scene(field.with_contrast(world.texts, names), encoder=words_of(world)))
    return made


def maybe_of(scenes: list[Scene]) -> tuple[Scene, Answer]:
    return next((scene, answer) for scene in scenes if (answer := scene.ask("word 1")).certainty == MAYBE)


def test_certainty_falls_as_another_word_fits_better(scenes):
    ranks = [(SURE, MAYBE, NOTHING).index(scene.ask("word 1").certainty) for scene in scenes]
    assert ranks == sorted(ranks)
    assert set(ranks) == {0, 1, 2}


def test_a_maybe_names_the_word_that_fits_better(scenes):
    scene, maybe = maybe_of(scenes)
    assert maybe.doubt == "only maybe: 'word 9' fits as well or better"
    assert len(maybe.gaussian_ids) >= PEAK_ROWS
    assert not len(maybe.without_maybe().gaussian_ids)
    assert (scene.ask("word 0").certainty, scene.ask("word 0").doubt) == (SURE, "")


def test_what_is_present_is_found_whatever_fits_better(scenes):
    for scene in scenes:
        plain, present = scene.ask("word 1"), scene.ask(Query("word 1", present=True))
        assert present.certainty == SURE
        assert len(present.gaussian_ids)
        if plain.certainty != NOTHING:
            assert_array_equal(present.gaussian_ids, plain.gaussian_ids)


def test_classes_take_no_maybe_unless_it_is_present(scenes):
    scene, _ = maybe_of(scenes)
    assert scene.segment(["word 1"]).counts == [0]
    assert scene.segment(["word 1"], Cut(present=True)).counts[0] > 0


def test_a_rival_is_the_word_that_most_of_the_best_rows_fit():
    rng = np.random.default_rng(0)
    words = np.eye(6, 8, dtype=np.float32)
    rows = words[[1] * 50 + [2] * 50] + 0.01 * unit_rows(rng, 100, 8)
    known = contrast_of(rows.astype(np.float32), words)
    assert known.rival(words[4], np.repeat([0.9, 0.1], 50).astype(np.float32)) == 1
    assert known.rival(words[4], np.repeat([0.1, 0.9], 50).astype(np.float32)) == 2


def test_of_few_taught_words_a_maybe_fits_best_but_less_well_than_others_do():
    """The features of thing 1 turn to what no word means: nothing fits it better than its own, which fits ever less."""

    class Taught(VocabularyEncoder):
        least_share = 0.9

    certainties = []
    for share in np.linspace(0, 1, 21):
        world = World(41)  # of the last of which there is no word
        turned = (1 - share) * world.meanings[1] + share * world.meanings[40]
        world.meanings[1] = turned / np.linalg.norm(turned)
        field, _ = field_and_truth(world, SHARES, rows=1200)
        known = words_of(world)
        known.texts, known.embeddings = known.texts[:40], known.embeddings[:40]
        scene = Scene(field, encoder=Taught(known.identity, known.texts, known.embeddings))
        answer = scene.ask("word 1")
        certainties.append(answer.certainty)
        if answer.certainty == MAYBE:
            assert answer.doubt == "only maybe: it fits less well than what is found here usually does"
            assert len(answer.gaussian_ids) >= PEAK_ROWS
            assert not len(answer.without_maybe().gaussian_ids)
    ranks = [(SURE, MAYBE, NOTHING).index(one) for one in certainties]
    assert ranks == sorted(ranks)
    assert set(ranks) == {0, 1, 2}


@pytest.mark.parametrize(
    ("said", "text"),
    [("mug", "mug"), ("Mugs", "mug"), ("the mug", "mug"), ("a glass", "glass"), ("toothbrushes", "toothbrush"),
     ("berries", "berry"), ("tv", "TV"), ("TV", "TV"), ("a mug", "a mug"),
     ("A Mug", "a mug")],
)  # fmt: skip
def test_a_vocabulary_knows_plurals_articles_and_capitals(said, text):
    texts = ("mug", "glass", "toothbrush", "berry", "TV", "a mug")
    known = VocabularyEncoder(EncoderIdentity("some", 6), texts, np.eye(6, dtype=np.float32))
    assert_array_equal(known.encode_texts([said])[0], np.eye(6)[texts.index(text)])
    with pytest.raises(InputError, match="'cups' is not among the 6 texts"):
        known.encode_texts(["cups"])


KIND = ("canoe", "ferry", "kayak")


def test_a_kind_is_found_by_its_names_and_these_are_no_rivals():
    """The word itself fits nothing: what stands under it does."""
    world = World(40)
    field, truth = field_and_truth(world, SHARES)
    names = ("stone", "canoe", "ferry", *(f"word {n}" for n in range(3, 39)), "boat")
    listed = field.with_contrast(world.texts, names)
    scene = Scene(listed, encoder=VocabularyEncoder(field.encoder, names, world.texts))
    answer = scene.ask("boat")
    assert (answer.values > answer.threshold)[np.isin(truth, [1, 2])].mean() > 0.9
    assert (answer.values > answer.threshold)[truth == 0].mean() < 0.05
    assert scene.ask("word 30").certainty == NOTHING


def test_names_of_kinds():
    assert {*KIND} <= names_under("boat") == names_under("a boat") == names_under("Boats")
    assert {"apple", "pear"} <= names_under("fruit")
    assert {"teddy bear"} <= names_under("toy")
    assert names_under("zeppelin") == names_under("red mug") == frozenset()
    assert all(name in set(broad_list()) for kind in ("boat", "fruit", "tool") for name in names_under(kind))


def test_a_kind_of_many_names_has_to_stand_higher():
    margins = np.where(np.arange(1000) < PEAK_ROWS, CLEAR_MARGIN + 0.01, -3.0)
    said = [certainty_of(relevancies(margins), PEAK_ROWS, CLEAR_MARGIN, names) for names in (1, 3, 100)]
    assert said == [SURE, MAYBE, NOTHING]
