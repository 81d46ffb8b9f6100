"""What `benchmarks/study_eyes.py` asks and judges by: the written words, and WordNet above a classifier's classes."""

import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.suite.everyday import ABSENT, WORDS
from benchmarks.suite.outlines import outlines_path, read_outlines
from benchmarks.suite.real_colors import TRUTH
from benchmarks.suite.wordnet import WordNet

from drsplat.photos.models.mini.lexicon import COLORS

# animal > dog > poodle, hound; animal > cat; a mouse is an animal or a device, and nothing below it is a class
NOUNS = """  1 a licence
00000001 03 n 01 animal 0 000 | what lives
00000002 03 n 02 dog 0 domestic_dog 0 001 @ 00000001 n 0000 | it barks
00000003 03 n 01 poodle 0 001 @ 00000002 n 0000 | it is curled
00000004 03 n 01 hound 0 001 @ 00000002 n 0000 | it hunts
00000005 03 n 01 cat 0 001 @ 00000001 n 0000 | it purrs
00000006 03 n 01 mouse 0 001 @ 00000001 n 0000 | it squeaks
00000007 06 n 01 mouse 0 000 | it clicks
"""
SENSES = {"animal": "1", "dog": "2", "domestic_dog": "2", "poodle": "3", "hound": "4", "cat": "5", "mouse": "67"}


@pytest.fixture
def wordnet(tmp_path: Path) -> WordNet:
    """Three classes: poodle, hound and cat."""
    (tmp_path / "data.noun").write_text(NOUNS)
    lines = [
        f"{word} n {len(of)} 1 @ {len(of)} 0 {' '.join(f'{one:0>8}' for one in of)}" for word, of in SENSES.items()
    ]
    (tmp_path / "index.noun").write_text("\n".join(["  1 a licence", *lines]))
    return WordNet(tmp_path, [f"0000000{one}" for one in "345"])


def test_a_word_stands_for_the_classes_below_all_its_senses(wordnet: WordNet) -> None:
    assert wordnet.classes("dogs").tolist() == [True, True, False]
    assert wordnet.classes("domestic dog").tolist() == [True, True, False]
    assert wordnet.classes("animal").all()
    assert not wordnet.classes("mouse").any()
    assert not wordnet.classes("unheard of").any()
    assert wordnet.nodes("mouse.2") == ["00000007"]


def test_a_name_climbs_until_it_is_likely_enough(wordnet: WordNet) -> None:
    probabilities = np.array([[0.9, 0.05, 0.05], [0.5, 0.4, 0.1], [0.4, 0.2, 0.4]])
    named = [node and wordnet.lemmas[node][0] for node in wordnet.climbed(wordnet.masses(probabilities), 0.8, 0.1)]
    assert named == ["poodle", "dog", None]  # "animal" holds all classes: it says nothing


def test_words_are_of_outlined_things_and_eighteen_are_absent() -> None:
    outlined = {
        name: {thing for things in read_outlines(path).values() for thing in things}
        for name in WORDS
        if (path := outlines_path(name)).is_file()
    }
    assert len(outlined) == 3
    for name, known in WORDS.items():
        things = outlined.get(name, set(TRUTH[name]))
        assert {thing for called in known["present"].values() for thing in called.split()} - {"+"} <= things
        assert set(known["names"]) == things
        assert len(set(known["absent"])) == ABSENT
        assert not set(known["absent"]) & set(known["present"])
        colors = {f"something {color}" for color in COLORS}
        assert set(known.get("eight", ())) <= {*known["present"], *known["absent"], *colors}
        assert all(re.fullmatch(r"[a-z_]+\.\d", one) for called in known["names"].values() for one in called.split())
