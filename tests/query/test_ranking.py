"""Objects without Gaussians: measured and cut as those of a scene are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drsplat import Encoder, EncoderIdentity, MiniEncoder, Query, WordEncoder
from drsplat.errors import MismatchError
from drsplat.query.ranking import Described, Surroundings
from refusing import refused

NOUNS = ("mug", "table", "lamp", "plant", "chair", "book")
PICTURE = np.full(512, 512**-0.5, np.float32)  # what all pictures have and no words do


@dataclass
class Embedded:
    """What some encoder has embedded."""

    encoder: EncoderIdentity

    def check_encoder(self, identity: EncoderIdentity) -> None:
        if not self.encoder.matches(identity):
            raise MismatchError("another encoder")


class ClipLike:
    """Words of `WordEncoder`, with a list and no threshold, as of CLIP: its pictures have low cosines with words."""

    identity = EncoderIdentity("like CLIP", 512)
    nouns = NOUNS

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        return WordEncoder().encode_texts(texts)


def pictured(*texts: str) -> np.ndarray:
    """Pictures of what texts say, as CLIP-like encoders have them."""
    rows = 0.3 * WordEncoder().encode_texts(texts) + PICTURE
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), np.float32)


def objects(*parts: np.ndarray) -> Described:
    rows = np.concatenate([np.empty((0, 512), np.float32), *parts])
    return Described(rows, np.append(0, np.cumsum([len(part) for part in parts], dtype=np.int64)))


def ranked(encoder: Encoder, query: Query, described: Described, usual: np.ndarray) -> tuple[list[float], list[bool]]:
    surroundings = Surroundings(Embedded(encoder.identity), lambda: encoder, usual)
    found = surroundings.rank(query, surroundings.vector(query), described)
    return found.values.tolist(), found.selected.tolist()


def test_an_object_is_as_good_as_its_best_descriptor():
    words = WordEncoder().encode_texts(["red mug", "table", "lamp", "mug"])
    described = objects(words[[1, 0]], words[[2]], words[[3, 1, 2]])
    assert_allclose(described.best(np.arange(6, dtype=np.float32)), [1, 2, 5])
    assert_allclose(described.cosines(words[0]), [1, words[2] @ words[0], words[3] @ words[0]], atol=1e-6)
    assert objects().best(np.empty(0, np.float32)).shape == (0,)


def test_an_encoder_with_a_threshold():
    """ "mug" fits a red one and a blue one alike; "red mug" only one of them, for it is cut at 0.8 of the best."""
    words = WordEncoder().encode_texts(["red mug", "blue mug", "lamp"])
    described = objects(*words[:, None])
    assert ranked(WordEncoder(), Query("mug"), described, words)[1] == [True, True, False]
    assert ranked(WordEncoder(), Query("red mug"), described, words)[1] == [True, False, False]
    assert ranked(WordEncoder(), Query("elephant"), described, words)[1] == [False] * 3
    assert ranked(WordEncoder(), Query("mug", exclude=("blue",)), described, words)[1] == [True, False, False]


def test_a_kind_finds_its_names_and_these_are_no_rivals():
    class Boats(ClipLike):
        nouns = (*NOUNS, "canoe", "ferry")

    things = pictured(*Boats.nouns)
    described = objects(*things[:, None])
    assert ranked(Boats(), Query("boat"), described, things)[1] == [noun in ("canoe", "ferry") for noun in Boats.nouns]
    assert ranked(Boats(), Query("ferry"), described, things)[1] == [noun == "ferry" for noun in Boats.nouns]
    none = objects(*things[: len(NOUNS), None])
    assert not any(ranked(Boats(), Query("boat"), none, things)[1])


def test_a_sentence_is_never_read_as_its_nouns():
    words = WordEncoder().encode_texts(["red mug", "blue mug", "table"])
    described = objects(*words[:, None])
    with refused(r"'the mug on the table': a catalogue .* ask it for 'mug'"):
        ranked(WordEncoder(), Query("the mug on the table"), described, words)
    with refused("'behind' is not understood"):
        ranked(WordEncoder(), Query("mug behind the table"), described, words)
    assert ranked(WordEncoder(), Query("how many mugs are there?"), described, words)[1] == [True, True, False]
    assert ranked(WordEncoder(), Query("mug that is not blue"), described, words)[1] == [True, False, False]


def test_words_are_held_against_a_list():
    """A cosine of 0.2 is much for a text and a picture: whether it fits is told by how far other words reach."""
    things = pictured(*NOUNS)
    described = objects(*things[:, None])
    values, selected = ranked(ClipLike(), Query("lamp"), described, things)
    assert selected == [noun == "lamp" for noun in NOUNS]
    assert max(values) > 0.6
    cosines = described.cosines(WordEncoder().encode_texts(["lamp"])[0])
    assert cosines.max() < 0.4  # no fixed threshold of cosines would do
    assert not any(ranked(ClipLike(), Query("elephant"), described, things)[1])
    assert ranked(ClipLike(), Query("lamp", threshold=0.0), described, things)[1] == [True] * len(NOUNS)


def test_the_built_in_encoder_finds_what_it_names_and_nothing_else():
    encoder = MiniEncoder()
    vectors = encoder.encode_texts(["red mug", "blue sofa", "wooden table", "green plant"])
    described = objects(*vectors[:, None])
    assert ranked(encoder, Query("red mug"), described, vectors)[1] == [True, False, False, False]
    weak = 0.2 * vectors + PICTURE
    weak = np.asarray(weak / np.linalg.norm(weak, axis=1, keepdims=True), np.float32)
    assert not any(ranked(encoder, Query("red vase"), objects(*weak[1:3, None]), vectors)[1])


def test_a_colour_has_to_stand_as_clearly_above_the_others_as_in_a_scene():
    """What is red and a little pink is red; where it is 0.45 to 0.6 spreads above pink, neither is said."""
    encoder, selected = MiniEncoder(), {}
    red, pink, blue = encoder.encode_texts([f"something {color}" for color in ("red", "pink", "blue")])
    for share in np.linspace(0, 1, 41):
        pictures = np.stack([red + share * pink, blue]).astype(np.float32)
        pictures /= np.linalg.norm(pictures, axis=1, keepdims=True)
        values, meant = ranked(encoder, Query("something red"), objects(*pictures[:, None]), pictures)
        selected[float(np.log(values[0] / (1 - values[0])))] = meant
    assert [True, False] in [meant for margin, meant in selected.items() if margin > 0.6]
    assert not any(any(meant) for margin, meant in selected.items() if 0.45 < margin < 0.6)
    assert any(0.45 < margin < 0.6 for margin in selected)


def test_relevancy():
    words = WordEncoder().encode_texts(["red mug", "lamp", "stuff"])
    described = objects(*words[:, None])
    values, _ = ranked(WordEncoder(), Query("red mug", relevancy=True), described, words)
    rivals = WordEncoder().encode_texts(["object", "things", "stuff", "texture"])
    margins = words @ words[0] - (words @ rivals.T).max(axis=1)
    assert_allclose(values, 1 / (1 + np.exp(-10 * margins)), rtol=1e-4)
    own = ranked(WordEncoder(), Query("mug", negatives=("red mug", "lamp")), described, words)
    assert own[1] == [False, False, own[1][2]]


def test_a_vector_is_cut_between_what_is_usual_and_the_best():
    rng = np.random.default_rng(0)
    usual = rng.standard_normal((200, 512)).astype(np.float32)
    usual /= np.linalg.norm(usual, axis=1, keepdims=True)
    near = usual[0] + 0.5 * usual[1]
    near /= np.linalg.norm(near)
    described = objects(usual[:1], near[None], usual[2:3])
    values, selected = ranked(WordEncoder(), Query(vector=3 * usual[0]), described, usual)
    assert_allclose(values[:2], [1, near @ usual[0]], atol=1e-6)
    assert selected == [True, bool(near @ usual[0] > 0.8), False]


def test_nothing_to_choose_from():
    none = np.empty((0, 512), np.float32)
    for encoder in (WordEncoder(), ClipLike(), MiniEncoder()):
        for query in (Query("mug"), Query("mug, not red"), Query(vector=PICTURE), Query("mug", relevancy=True)):
            assert ranked(encoder, query, objects(), none) == ([], [])


def test_what_cannot_be_asked():
    surroundings = Surroundings(Embedded(EncoderIdentity("other", 512)), WordEncoder, np.empty((0, 512), np.float32))
    with pytest.raises(MismatchError, match="another encoder"):
        surroundings.vector(Query("mug"))
    for vector in (np.zeros(512), np.full(512, np.nan)):
        with refused("finite and not zero"):
            surroundings.vector(Query(vector=vector.astype(np.float32)))
    with refused("a query that never asks them has no answer"):
        surroundings.vector(Query("mug", objects="never"))
