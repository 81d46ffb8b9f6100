"""Vocabularies: the recipe of docs/search.md makes a long list, and a short one is doubted."""

import re
from pathlib import Path

import numpy as np
import pytest

from drsplat import LanguageField, Scene, open_scene
from drsplat.cli import main
from drsplat.errors import DrSplatWarning
from drsplat.formats.vocabulary import VocabularyEncoder, write_vocabulary
from drsplat.photos.models.word_list import NOUNS
from drsplat.photos.models.words import WordEncoder
from drsplat.query.encoding import ENOUGH_TEXTS, encoder_for
from known_objects import known_field, known_scene

WORDS = WordEncoder()
SEARCH = Path(__file__).parents[2] / "docs/search.md"


def field_of_words() -> LanguageField:
    seen = WORDS.encode_texts(["red mug", "blue sofa", "green car"])
    return known_field(known_scene(), seen[[0, 1, 2, 0, 1, 2, 0, 0, 1, 2]].astype(np.float32), WORDS.identity)


def test_the_recipe_of_the_docs_makes_a_list_that_is_long_enough(tmp_path, monkeypatch):
    (recipe,) = re.findall(r"```python\n(import json.*?)```", SEARCH.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(re.sub(r'load_encoder\(".*?"\)', 'load_encoder("drsplat-words")', recipe), {})
    words = encoder_for(field_of_words(), vocabulary="clip_texts.json")
    assert len(words.texts) > 300
    assert words.encode_texts(["red mug"]) @ WORDS.encode_texts(["red mug"])[0] > 0.999


def texts_file(folder: Path, count: int) -> Path:
    """A vocabulary of so many texts: a red mug, and other things."""
    texts = ("red mug", *(name for name in NOUNS if name != "mug"))[:count]
    path = folder / "texts.safetensors"
    write_vocabulary(path, VocabularyEncoder(WORDS.identity, texts, WORDS.encode_texts(texts)))
    return path


def saved(folder: Path, kept: bool = False) -> Path:
    field = field_of_words()
    texts = NOUNS[:3]
    field = field.with_contrast(WORDS.encode_texts(texts), texts) if kept else field
    field.save(folder / "room.field")
    return folder / "room.field"


@pytest.mark.parametrize(("count", "kept", "doubted"), [
    (ENOUGH_TEXTS - 1, False, True), (ENOUGH_TEXTS, False, False), (2, True, False),
])  # fmt: skip
def test_a_short_list_is_doubted_once_by_every_verb(count, kept, doubted, tmp_path, capsys):
    """A field that keeps a list of its own needs no long one."""
    told = f"warning: {texts_file(tmp_path, count)}: only {count} texts tell what a word does not mean"
    field = str(saved(tmp_path, kept))
    for verb in (["select", field, "red mug"], ["segment", field, "--classes", "red mug,bottle"]):
        main([*verb, "--vocabulary", str(tmp_path / "texts.safetensors")])
        assert capsys.readouterr().err.count(told) == doubted, verb


def test_in_python_it_is_a_warning_and_the_answer_stays(tmp_path):
    scene = open_scene(saved(tmp_path), vocabulary=str(texts_file(tmp_path, 8)))
    with pytest.warns(DrSplatWarning, match="add names of any things, 100 texts or more"):
        answer = scene.ask("red mug")
    assert answer.doubt == ""
    assert answer.list_doubt.startswith("only 8 texts tell what a word does not mean")
    assert scene.segment(["red mug", NOUNS[0]]).list_doubt == answer.list_doubt
    scene.ask("apple")  # no second warning, which would be an error here


@pytest.mark.parametrize(("count", "doubted"), [(8, True), (ENOUGH_TEXTS, False)])
def test_clients_of_http_and_tools_are_told_beside_the_answer(count, doubted):
    pytest.importorskip("pydantic")
    from drsplat.fronts.serving import worker
    from drsplat.fronts.serving.conversation import tool_answer
    from drsplat.fronts.serving.guards import Limits
    from drsplat.fronts.serving.query_fields import Locate, Segment

    texts = ("red mug", *(name for name in NOUNS if name != "mug"))[:count]
    scene = Scene(
        field_of_words(), known_scene(), encoder=VocabularyEncoder(WORDS.identity, texts, WORDS.encode_texts(texts))
    )
    located = worker.located(scene, Locate(text="red mug"), Limits())
    segmented = worker.segmented(scene, Segment(classes=["red mug"]), Limits())
    counted = tool_answer(scene, {"name": "a", "tool": "count", "arguments": {"text": "red mug"}}, Limits())
    told = f"only {count} texts tell what a word does not mean"
    for said in (located.measured.list_doubt, segmented.list_doubt, counted.advice):
        assert (told in said) is doubted
    assert located.measured.certainty == "sure"
