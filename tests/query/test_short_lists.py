"""Vocabularies: the recipe of docs/search.md makes a long list."""

import re
from pathlib import Path

import numpy as np
import pytest

from drsplat import LanguageField
from drsplat.photos.models.words import WordEncoder
from drsplat.query.encoding import encoder_for
from known_objects import known_field, known_scene

WORDS = WordEncoder()
SEARCH = Path(__file__).parents[2] / "docs/search.md"


def field_of_words() -> LanguageField:
    seen = WORDS.encode_texts(["red mug", "blue sofa", "green car"])
    return known_field(known_scene(), seen[[0, 1, 2, 0, 1, 2, 0, 0, 1, 2]].astype(np.float32), WORDS.identity)


def test_the_recipe_of_the_docs_makes_a_list_that_is_long_enough(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (recipe,) = re.findall(r"```python\n(import json.*?)```", SEARCH.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(re.sub(r'load_encoder\(".*?"\)', 'load_encoder("drsplat-words")', recipe), {})
    words = encoder_for(field_of_words(), vocabulary="clip_texts.json")
    assert len(words.texts) > 300
    assert words.encode_texts(["red mug"]) @ WORDS.encode_texts(["red mug"])[0] > 0.999
