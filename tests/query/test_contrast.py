"""How much better a query fits than a list of words."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array, eye_array

from drsplat import EncoderIdentity, LanguageField, Scene, load_field
from drsplat.errors import InputError
from drsplat.field import build_field
from drsplat.field.codes import Mixture
from drsplat.field.evidence.evidence import Evidence, MaskIds
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.word_list import MAX_TEXTS, NOUNS, broad_list, list_vectors
from drsplat.query.contrast import (
    CLEAR_MARGIN_PER_EFOLD,
    CLEAR_MARGIN_ROWS,
    SAME_MEANING_COSINE,
    USUAL_COSINE_SHARE,
    WORDS_PER_RIVAL,
    certainty_of,
    contrast,
    contrast_of,
    least_clear,
    own_level,
    relevancy_threshold,
)  # fmt: skip
from drsplat.query.defaults import MAYBE, NOTHING, SURE
from drsplat.query.thresholds import PEAK_ROWS
from fields import SCENE, ToyEncoder, unit_rows

DIM, GAP = 64, 0.25
CLIP = EncoderIdentity("made-up", DIM)


class World:
    """Pictures and words in two cones, as CLIP's: what fits is at 0.3, what does not at 0.2, give or take
    the word's own level."""

    def __init__(self, words: int, seed: int = 0) -> None:
        rng = default_rng(seed)
        self.rng, basis = rng, np.linalg.qr(rng.normal(size=(DIM, DIM)))[0].astype(np.float32)
        self.pictures_axis, self.texts_axis = basis[0], basis[1]
        self.meanings = unit_rows(rng, words, DIM - 2) @ basis[2:]
        levels = rng.normal(0, 0.02, words).astype(np.float32)[:, None]
        texts = 0.8 * self.texts_axis + (GAP + levels) * self.pictures_axis + 0.5 * self.meanings
        self.texts = (texts / np.linalg.norm(texts, axis=1, keepdims=True)).astype(np.float32)

    def pictures(self, words: np.ndarray) -> np.ndarray:
        noise = 0.3 * unit_rows(self.rng, len(words), DIM)
        found = 0.9 * self.pictures_axis + 0.35 * self.meanings[words] + noise
        return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)


def field_and_truth(world: World, shares: dict[int, float], rows: int = 2000) -> tuple:
    """A field in which word w is what `shares[w]` of the Gaussians show."""
    truth = np.repeat(list(shares), (np.array(list(shares.values())) * rows).astype(int))
    return build_field(evidence_of(world.pictures(truth)), SCENE, CLIP, Mixture(1)), truth


def evidence_of(pictures: np.ndarray) -> Evidence:
    """A mask for every Gaussian."""
    count = len(pictures)
    weights = csr_array(eye_array(count, dtype=np.float32, format="csr"))
    masks = MaskIds(("a.jpg",), np.zeros(count, np.int32), np.arange(count, dtype=np.int32))
    return Evidence(weights, masks, pictures)


def words_of(world: World) -> VocabularyEncoder:
    names = [f"word {number}" for number in range(len(world.texts))]
    return VocabularyEncoder(CLIP, names, world.texts)


SHARES = {0: 0.6, 1: 0.25, 2: 0.1, 3: 0.05}


@pytest.fixture(scope="module")
def world() -> World:
    return World(60)


@pytest.fixture(scope="module")
def scene(world) -> tuple[LanguageField, np.ndarray]:
    return field_and_truth(world, SHARES)


@pytest.mark.parametrize("word", SHARES)
def test_what_is_there_is_found_large_or_small(word, world, scene):
    field, truth = scene
    found = Scene(field, encoder=words_of(world)).ask(f"word {word}").gaussian_ids
    meant = np.flatnonzero(truth == word)
    assert len(np.intersect1d(found, meant)) / len(np.union1d(found, meant)) > 0.9


def test_what_is_not_there_is_not_found(world, scene):
    field, _ = scene
    absent = [word for word in range(60) if word not in SHARES]
    found = [len(Scene(field, encoder=words_of(world)).ask(f"word {w}").gaussian_ids) > 0 for w in absent]
    assert np.mean(found) <= 0.1


def test_the_same_by_hand(world, scene):
    field, _ = scene
    known = contrast(field, world.texts[1:])
    cosines = field.scores(world.texts)
    pictures = field.evidence.embeddings
    usual = USUAL_COSINE_SHARE * (pictures @ world.texts.T).mean(0)
    left = pictures @ world.texts[1:].T
    left = left - left.mean(0) - left.mean(1, keepdims=True) + left.mean()
    margins = (cosines - usual[:, None])[0] - (cosines - usual[:, None])[1:].max(0)
    expected = 1 / (1 + np.exp(-margins / left.std()))
    assert_allclose(known.relevancy(world.texts[0], cosines[0]), expected, atol=1e-3)


def test_a_synonym_in_the_list_does_not_compete(world, scene):
    field, truth = scene
    other = world.texts[1] + 0.2 * unit_rows(default_rng(3), 1, DIM)[0]
    other = (other / np.linalg.norm(other)).astype(np.float32)
    texts = np.concatenate([world.texts, other[None]])
    centred = texts - texts.mean(0)
    centred /= np.linalg.norm(centred, axis=1, keepdims=True)
    assert centred[1] @ centred[-1] > SAME_MEANING_COSINE > np.sort(centred[1] @ centred[:-1].T)[-2]
    values = contrast(field, texts).relevancy(other, field.scores(other))
    assert (values[truth == 1] > 0.5).mean() > 0.9


def test_a_word_has_to_be_among_the_best_of_every_three_hundred(scene):
    """Three words of 900 are better everywhere: the third decides."""
    field, _ = scene
    rng = default_rng(1)
    texts = unit_rows(rng, 3 * WORDS_PER_RIVAL, DIM)
    known, query_vector = contrast(field, texts), unit_rows(rng, 1, DIM)[0]
    scores = field.scores(texts) - (texts @ known.usual)[:, None]
    own = field.scores(query_vector) - query_vector @ known.usual
    expected = own > np.sort(scores, axis=0)[-3]
    values = known.relevancy(query_vector, field.scores(query_vector))
    clear = np.abs(values - 0.5) > 1e-4
    assert_array_equal((values > 0.5)[clear], expected[clear])


def test_few_rows_that_fit_are_no_thing():
    values = np.full(1000, 0.2, np.float32)
    values[: PEAK_ROWS - 1] = 0.9
    assert relevancy_threshold(values) == pytest.approx(0.9)  # nothing is above
    values[PEAK_ROWS - 1] = 0.9
    assert relevancy_threshold(values) == 0.5
    values[:PEAK_ROWS] = 0.55  # better than the list, but by a hair
    assert relevancy_threshold(values) == pytest.approx(0.55)


def relevancies(margins: np.ndarray) -> np.ndarray:
    return (1 / (1 + np.exp(-margins))).astype(np.float32)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_the_cut_lies_between_what_fits_a_little_and_what_fits(share):
    """A thing at a margin of 4, its border at 0.3, the rest at -2: without the border, however large the thing is."""
    rows = 10_000
    margins = np.full(rows, -2.0)
    margins[: round(share * rows)] = 4.0
    margins[-200:] = 0.3
    values = relevancies(margins)
    np.testing.assert_array_equal(values > own_level(values), margins == 4)
    assert relevancy_threshold(values) == 0.5


def test_in_larger_scenes_a_peak_has_to_be_higher():
    margin = np.log(
        1 / (1 / np.array([least_clear(rows) for rows in (1, CLEAR_MARGIN_ROWS, 10 * CLEAR_MARGIN_ROWS)]) - 1)
    )
    assert_allclose(margin, [0.45, 0.45, 0.45 + CLEAR_MARGIN_PER_EFOLD * np.log(10)])


def test_a_peak_above_many_words_has_to_be_higher_than_one_above_few():
    """A margin of 0.48 is found with a list of 299 words, and not with one of 300."""
    values = relevancies(np.where(np.arange(1000) < PEAK_ROWS, 0.48, -2.0))
    texts = np.eye(WORDS_PER_RIVAL, dtype=np.float32)
    few, many = (contrast_of(texts[:2], texts[:count]).clear_margin for count in (WORDS_PER_RIVAL - 1, WORDS_PER_RIVAL))
    assert [certainty_of(values, PEAK_ROWS, margin) for margin in (few, many)] == [SURE, MAYBE]


def test_fewer_rows_have_to_stand_above_a_long_list_in_a_small_scene():
    """One row in 3,000, of 10 to PEAK_ROWS; above a short list PEAK_ROWS in any scene."""
    texts = np.eye(WORDS_PER_RIVAL, dtype=np.float32)

    def peak(words, rows):
        known = contrast_of(texts[:2], texts[:words])
        scores, best = (np.broadcast_to(array[:1], (rows, array.shape[1])) for array in (known.scores, known.words))
        return replace(known, scores=scores, words=best).peak

    assert [peak(WORDS_PER_RIVAL, rows) for rows in (2, 30_000, 60_000, 120_000, 10**7)] == [
        10,
        10,
        20,
        PEAK_ROWS,
        PEAK_ROWS,
    ]
    assert [peak(WORDS_PER_RIVAL - 1, rows) for rows in (2, 60_000, 10**7)] == [PEAK_ROWS] * 3


def test_a_row_that_stands_for_several_counts_as_these():
    world = World(400)
    features, pictures = world.pictures(np.arange(30)), world.pictures(np.arange(50))
    counts = default_rng(1).integers(1, 200, 30)
    short = replace(contrast_of(features, world.texts, pictures=pictures), counts=counts)
    long = contrast_of(np.repeat(features, counts, axis=0), world.texts, pictures=pictures)
    assert (short.num_rows, short.peak, short.spread) == (long.num_rows, long.peak, long.spread)
    for peak in (1, 40, 1000):
        assert_allclose(short.height(peak), long.height(peak), rtol=1e-6)
    for query in world.texts[:3]:
        scores = np.repeat(features @ query, counts)
        values, expected = short.relevancy(query, scores), long.relevancy(query, scores)
        assert values is not None
        assert_allclose(values, expected, rtol=1e-4)


def test_each_query_and_each_list_has_its_own_near_words():
    """The last answer is kept for the next scene: another query, or another list, is another question."""
    world, other = World(40), World(40, seed=1)
    features = world.pictures(np.arange(40))
    for texts in (world.texts, other.texts, world.texts):
        known, alone = contrast_of(features, texts), contrast_of(features, texts.copy())
        for query in texts[:2]:
            scores = features @ query
            values, expected = known.relevancy(query, scores), alone.relevancy(query, scores)
            assert values is not None
            assert expected is not None
            assert_array_equal(values, expected)


@pytest.mark.parametrize("count", [1, 2, 5, 50])
def test_any_vocabulary_answers(count, world, scene):
    field, truth = scene
    few = VocabularyEncoder(CLIP, [f"word {n}" for n in range(count)], world.texts[:count])
    answer = Scene(field, encoder=few).ask("word 0")
    assert answer.rule == ("auto" if count == 1 else "list")
    found = answer.gaussian_ids
    assert np.intersect1d(found, np.flatnonzero(truth == 0)).size > 0.2 * (truth == 0).sum()


def test_the_list_that_is_kept_with_the_field_takes_the_place_of_a_vocabulary(world, scene, tmp_path):
    field, _ = scene
    alone = VocabularyEncoder(CLIP, ["word 9"], world.texts[9:10])
    assert len(Scene(field, encoder=alone).ask("word 9").gaussian_ids) > 0  # nothing to contrast it with
    field.with_contrast(world.texts, words_of(world).texts).save(tmp_path / "a.field")
    kept = load_field(tmp_path / "a.field")
    assert kept.contrast.texts == words_of(world).texts
    assert len(Scene(kept, encoder=alone).ask("word 9").gaussian_ids) == 0


def test_large_vocabularies_are_thinned():
    texts = [*(f"word {number}" for number in range(3000)), *NOUNS[:20]]
    large = VocabularyEncoder(CLIP, texts, unit_rows(default_rng(0), len(texts), DIM))
    vectors = list_vectors(large)
    assert len(vectors) == MAX_TEXTS
    assert_array_equal(vectors[:20], large.encode_texts(NOUNS[:20]))


def test_an_encoder_of_some_words_is_contrasted_with_those_of_its_own_list():
    class Own(ToyEncoder):
        nouns = ("a mug of mine", "unheard of", "my plate")

        def encode_texts(self, texts):
            if "unheard of" in texts:
                raise InputError("unknown")
            return super().encode_texts(texts)

    assert_array_equal(list_vectors(Own()), ToyEncoder().encode_texts(["a mug of mine", "my plate"]))


def test_a_list_of_plain_different_nouns_ships():
    assert len(NOUNS) == len(set(NOUNS)) > 300
    assert {"mattress", "bed", "wall", "floor", "sky"} <= set(NOUNS)
    assert all(noun == noun.strip().lower() and noun for noun in NOUNS)


def test_the_broad_list_has_the_names_of_lvis_too():
    names = broad_list()
    assert len(names) == len(set(names)) == 1402
    assert names[: len(NOUNS)] == NOUNS
    assert {"aerosol can", "zucchini"} <= set(names)
    assert not any(name.startswith("#") or name != name.strip() or "_" in name for name in names)


def test_an_encoder_without_nouns_is_contrasted_with_the_broad_list():
    assert_array_equal(list_vectors(ToyEncoder()), ToyEncoder().encode_texts(broad_list()))


def test_the_kept_scores_are_let_go_with_the_field(world):
    import gc
    import weakref

    field, _ = field_and_truth(world, {0: 1.0}, 100)
    known = weakref.ref(contrast(field, world.texts))
    assert contrast(field, world.texts) is known()
    del field
    gc.collect()
    assert known() is None


MINI = MiniEncoder()


def faint_room(level: float, mug: float) -> LanguageField:
    """Floor and table are at a cosine of `level` of their words, a mug at `mug` times that of its own; the
    rest of every picture is nothing that a word speaks of."""
    words = MINI.encode_texts(["floor", "table", "mug"])
    nothing = np.linalg.svd(MINI.encode_texts(MINI.nouns), full_matrices=True)[2][-1]
    shown = np.repeat([0, 1, 2], [400, 400, 2 * PEAK_ROWS])
    share = (np.array([1.0, 1.0, mug]) * level)[shown, None]
    pictures = share * words[shown] + np.sqrt(1 - share**2) * nothing
    return build_field(evidence_of(pictures.astype(np.float32)), SCENE, MINI.identity, Mixture(1))


@pytest.mark.parametrize("level", [0.12, 0.8])
@pytest.mark.parametrize(("mug", "certainty"), [(0.6, SURE), (0.35, MAYBE), (0.25, NOTHING)])
def test_what_the_built_in_encoder_has_to_reach_follows_the_scene(level, mug, certainty):
    """A mug fits its rows best in all of these; where it hardly fits, for this scene, there is none."""
    field = faint_room(level, mug)
    answer = Scene(field, encoder=MINI).ask("mug")
    assert (answer.values[-2 * PEAK_ROWS :] > 0.5).all()
    assert len(answer.gaussian_ids) == (0 if certainty == NOTHING else 2 * PEAK_ROWS)
    assert len(answer.without_maybe().gaussian_ids) == (2 * PEAK_ROWS if certainty == SURE else 0)


@pytest.mark.parametrize(
    ("text", "rival"),
    [("yellow chair", ""), ("chair", ""), ("yellow mug", "yellow chair"), ("green chair", "yellow chair")],
)
def test_what_has_another_colour_or_is_another_thing_is_never_found_for_sure(text, rival):
    """ "Yellow mug" fits a yellow chair better than any plain noun does, where nothing is a mug."""
    shown = MINI.encode_texts(["floor", "table", "yellow chair"])
    shown[2] += 0.6 * (shown[2] - MINI.encode_texts(["chair"])[0])  # more of its colour, as pictures have
    shown /= np.linalg.norm(shown, axis=1, keepdims=True)
    field = build_field(evidence_of(np.repeat(shown, [400, 400, 80], axis=0)), SCENE, MINI.identity, Mixture(1))
    answer = Scene(field, encoder=MINI).ask(text)
    assert answer.certainty == (MAYBE if rival else SURE)
    assert answer.doubt == (f"only maybe: '{rival}' fits as well or better" if rival else "")
    assert len(answer.gaussian_ids) == 80
    assert len(answer.without_maybe().gaussian_ids) == (0 if rival else 80)


def test_the_height_of_a_list_is_what_enough_rows_reach():
    field = faint_room(0.5, 1.0)
    vectors = MINI.encode_texts(MINI.nouns)
    expected = np.sort(field.scores(vectors).max(0))[-PEAK_ROWS]
    assert_allclose(contrast(field, vectors).height(), expected, atol=1e-5)
