"""Nouns of the built-in encoder: believed in scenes that look like the rooms it learnt from, and only there."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from command_line import answer_of, text_of
from drsplat import LanguageField, Scene, write_gaussians
from drsplat.photos.models.mini import MiniEncoder
from drsplat.photos.models.mini.lexicon import SYNONYMS, WORDS, nouns_in, words_of
from drsplat.query.naming import knows_nouns
from drsplat.scene.gaussians import Gaussians
from known_objects import described, known_field, known_scene

MINI = MiniEncoder()
TEXTS = ["red mug", "blue sofa", "something green"]
CLEAR, FAINT = 0.8, 0.25  # cosines of the masks with their texts


def made(level: float) -> tuple[LanguageField, Gaussians]:
    """Three boxes that look like a red mug, a blue sofa and something green, as much as `level`."""
    gaussians = known_scene()
    nothing = np.linalg.svd(MINI.encode_texts([*MINI.nouns, *TEXTS]), full_matrices=True)[2][-1]
    shown = level * MINI.encode_texts(TEXTS) + np.sqrt(1 - level**2) * nothing
    field = known_field(gaussians, shown[[0, 1, 2, 0, 1, 2, 0, 0, 1, 2]].astype(np.float32), MINI.identity)
    return field.with_objects(described(field, gaussians)), gaussians


def test_words_that_say_what_a_thing_is():
    assert nouns_in("a wooden shelf") == ["wooden", "shelf"]
    assert nouns_in("red orange") == ["orange"]
    assert nouns_in("something orange") == nouns_in("dark green things") == []


def test_synonyms_are_read_as_what_was_taught():
    assert words_of("red settees and an armchair") == ["red", "sofa", "chair"]
    assert_array_equal(MINI.encode_texts(["a settee"]), MINI.encode_texts(["sofa"]))
    assert not {*SYNONYMS} & {*WORDS}
    assert {*SYNONYMS.values()} <= {*WORDS}


@pytest.mark.parametrize(("level", "believed"), [(CLEAR, True), (FAINT, False)])
def test_nouns_are_doubted_where_no_word_fits(level, believed):
    field, gaussians = made(level)
    scene = Scene(field, gaussians, encoder=MINI)
    assert knows_nouns(MINI, field) is believed
    assert ("made-up rooms" in scene.doubt) is not believed
    assert bool(scene.ask("clock").doubt) is bool(scene.segment(["clock", "something red"]).doubt) is not believed
    assert scene.ask("something red").doubt == scene.ask("grey thing").doubt == ""
    names = [*scene.object_names(), *(word.text for word in scene.what_is(0))]
    assert all(name is None or name.startswith("something ") for name in names) is not believed
    if believed:
        assert scene.object_names()[:2] == ["red mug", "blue sofa"]


def test_what_an_encoder_without_such_a_number_says_is_believed():
    field, gaussians = made(FAINT)

    class Other:
        identity = MINI.identity
        encode_texts = MINI.encode_texts

    assert Scene(field, gaussians, encoder=Other).doubt == ""


def test_all_verbs_say_so(tmp_path, capsys):
    field, gaussians = made(FAINT)
    field.save(tmp_path / "a.field")
    write_gaussians(tmp_path / "a.ply", gaussians)
    given = (tmp_path / "a.field", "--scene", tmp_path / "a.ply")
    for verb in (("locate", given[0], "clock"), ("select", given[0], "clock"), ("objects", given[0])):
        assert "warning: the built-in encoder learnt nouns from made-up rooms" in text_of(capsys, *verb, *given[1:])
    assert "made-up rooms" in text_of(capsys, "segment", given[0], "--classes", "clock,sofa", *given[1:])
    assert "made-up rooms" not in text_of(capsys, "locate", given[0], "something red", *given[1:])
    assert answer_of(capsys, "objects", *given)["doubt"]
    assert "SAM and CLIP" in answer_of(capsys, "locate", given[0], "clock")["doubt"]


def test_servers_and_viewer_say_so():
    pytest.importorskip("pydantic")
    from drsplat.fronts.serving.conversation import Conversation, tool_answer
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.models import measured
    from drsplat.fronts.viewing.results import result_of

    scene = Scene(*made(FAINT), encoder=MINI)
    answer = scene.ask("clock")
    assert "made-up rooms" in measured(answer).doubt
    assert "made-up rooms" in result_of(scene, "clock", answer).summary
    assert "made-up rooms" not in Conversation(scene, "a").count("clock").advice
    counted = tool_answer(scene, {"name": "a", "tool": "count", "arguments": {"text": "clock"}}, Limits())
    assert "made-up rooms" in counted.advice
