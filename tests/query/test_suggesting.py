"""What is said of a query without a match: how near it came, and which words do match."""

from dataclasses import replace

import numpy as np
import pytest

from drsplat import Query
from drsplat.query.suggesting import missed_text, suggestions, words_instead
from viewing_scenes import THINGS, boxes_scene


def test_words_that_match_come_in_the_order_of_their_likeness_to_the_query():
    scene = boxes_scene()
    answer = scene.ask("tall mug")
    words = ("elephant", "blue mug", "tall lamp", "red mug", "green sofa")
    instead = words_instead(scene, answer, words)
    vectors = scene.encoder.encode_texts(instead)
    likeness = (vectors @ answer.vector).tolist()
    assert set(instead) == set(THINGS)
    assert likeness == sorted(likeness, reverse=True)
    assert all(scene.locate(word)[0].sure for word in instead)
    assert words_instead(scene, scene.ask("lamp"), words)[0] == "tall lamp"
    assert words_instead(scene, answer, ("elephant", "green sofa")) == []


def test_no_words_are_known_without_a_vector_or_an_encoder():
    scene = boxes_scene()
    answer = scene.ask("elephant")
    assert words_instead(scene, replace(answer, vector=None)) == []
    assert suggestions(scene, ()) == suggestions(scene)  # the encoder's own


@pytest.mark.parametrize(
    ("best", "threshold", "said"),
    [
        (0.41, 0.5, "The best place has a cosine of 0.41, below the threshold of 0.50."),
        (0.5, 0.5, "The best place has a cosine of 0.50."),  # fits, but other words as well
        (-2.0, 0.5, ""),  # all of it was left out
    ],
)
def test_how_near_a_query_came_is_said(best, threshold, said):
    scene = boxes_scene()
    values = np.full(len(scene.field), -2.0, np.float32)
    values[7] = best
    answer = replace(scene.ask(Query(vector=scene.field.feature(np.array([0]))[0])), values=values, threshold=threshold)
    assert missed_text(answer) == said
    assert missed_text(answer, ["mug", "lamp"]) == f"{said} Words that match here: mug, lamp.".strip()
