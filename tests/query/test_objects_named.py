"""Words that objects are called by: only those that fit clearly better than all others of the list."""

import numpy as np
import pytest

from drsplat import EncoderIdentity, LanguageField
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.photos.models.mini import MiniEncoder
from drsplat.query.naming import object_names
from known_objects import described, known_field, known_scene

DIM = 32
WORDS = [f"word {number}" for number in range(DIM)]
VECTORS = np.eye(DIM, dtype=np.float32)
ENCODER = VocabularyEncoder(EncoderIdentity("words", DIM), WORDS, VECTORS)
MASKS = [0, 1, 2, 0, 1, 2, 0, 0, 1, 2]  # which of the three boxes each mask shows


def field_of(pictures: np.ndarray) -> LanguageField:
    """Three boxes whose masks look so."""
    gaussians = known_scene()
    rows = pictures / np.linalg.norm(pictures, axis=1, keepdims=True)
    field = known_field(gaussians, rows.astype(np.float32), ENCODER.identity)
    return field.with_objects(described(field, gaussians))


def names_of(field: LanguageField, words: tuple[str, ...] = ()) -> list[str | None]:
    return object_names(ENCODER, field, field.objects.things.tolist(), words)


def test_a_word_that_fits_as_well_as_another_is_no_name():
    between = 1.0 * VECTORS[1] + 0.98 * VECTORS[2]
    things = np.stack([VECTORS[0], between, VECTORS[3]])
    assert names_of(field_of(things[MASKS])) == ["word 0", None, "word 3"]


def test_words_that_are_given_have_to_be_better_than_the_whole_list():
    field = field_of(VECTORS[[0, 5, 3]][MASKS])
    assert names_of(field, ("word 0", "word 3")) == ["word 0", None, "word 3"]


def test_the_looks_of_few_masks_give_no_name():
    """One mask of four shows something else, as wrong masks do, and fits a word better than the others fit theirs."""
    faint = VECTORS[0] + 0.5 * VECTORS[10:18].sum(0)
    things = np.stack([faint, VECTORS[2], VECTORS[3]])[MASKS]
    things[6] = VECTORS[7]
    field = field_of(things)
    node = field.objects.thing(0)
    assert len(field.objects.descriptors_of(node)) == 2
    assert int((field.objects.descriptors_of(node) @ VECTORS.T).max(0).argmax()) == 7
    assert names_of(field)[0] == "word 0"


def test_words_that_mean_the_same_do_not_compete():
    same = VECTORS[0] + 0.05 * VECTORS[9]
    vectors = np.stack([*VECTORS, same / np.linalg.norm(same)])
    encoder = VocabularyEncoder(ENCODER.identity, [*WORDS, "synonym"], vectors)
    field = field_of(VECTORS[[0, 2, 3]][MASKS])
    assert object_names(encoder, field, field.objects.things.tolist())[0] == "word 0"


@pytest.mark.parametrize(("shown", "name"), [("red mug", "red mug"), ("mug", "mug"), ("floor", "floor")])
def test_nouns_and_colours_are_sure_each_for_itself(shown, name):
    mini = MiniEncoder()
    texts = [shown, "blue sofa", "green table"]
    field = known_field(known_scene(), mini.encode_texts(texts)[MASKS].astype(np.float32), mini.identity)
    field = field.with_objects(described(field, known_scene()))
    assert object_names(mini, field, field.objects.things.tolist())[0] == name
