"""A page that answers words which nobody asked when it was written, as `drsplat locate` does."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_contrast import CLIP, World, evidence_of

from browsing import SLOW, a_page, needs_chromium, settled
from drsplat import Scene, export_page
from drsplat.evaluation.demo.story import Story
from drsplat.field import build_field
from drsplat.field.codes import Mixture
from drsplat.formats.vocabulary import VocabularyEncoder
from drsplat.fronts.viewing import page as pages
from drsplat.photos.models.mini.lexicon import NAMES, SYNONYMS, WORDS, nouns_in, only_colors, swapped, words_of
from drsplat.query import contrast, measuring
from drsplat.query.search import split_negation
from drsplat.query.sentences import parsed
from drsplat.query.suggesting import words_instead
from drsplat.scene.gaussians import Gaussians, significance
from page_files import read_page
from scenes import look_at_view
from twins.page_codes import decoded

BAKED = ["red vase", "couch", "something to eat", "laptop"]
FIFTY = [
    *(name for name in NAMES if name not in BAKED), "cup", "kettle", "desk", "bookcase", "carpet", "painting", "fruit",
    "food", "toy", "green car", "blue candle", "green mug", "yellow apple", "wooden table",
]  # fmt: skip
FIND = """async (texts) => {
    const search = await drsplat.backend.search;
    return texts.map((text) => search.find(text).result);
}"""
VALUES = """async (texts) => {
    const search = await drsplat.backend.search, rows = [...search.codes.rows];
    const answers = texts.map((text) => search.answer(text));
    return [rows, answers.map((one) => ({ ...one, values: [...one.values] }))];
}"""
READ = """async (texts) => {
    const search = await drsplat.backend.search;
    return texts.map((text) => { try { return search.reads(text); } catch (error) { return String(error); } });
}"""
WORDS_OF = """async (texts) => {
    const { words } = await drsplat.backend.search;
    const read = (text) => [words.wordsOf(text), words.isOnlyColors(text), words.hasNouns(text), words.swapped(text)];
    return texts.map(read);
}"""
Pages = dict[str, tuple[Scene, Path]]

pytestmark = [pytest.mark.slow, needs_chromium]


@pytest.fixture(scope="module")
def exported(household_story: Story, tmp_path_factory: pytest.TempPathFactory) -> Pages:
    """The demo's scene with and without objects, and a page of each."""
    folder, made = tmp_path_factory.mktemp("pages"), {}
    for name, field in (("objects", household_story.field), ("plain", household_story.field.with_objects(None))):
        scene = Scene(field, household_story.gaussians, household_story.views, threads=1)
        export_page(folder / f"{name}.html", scene, BAKED)
        made[name] = scene, folder / f"{name}.html"
    return made


@contextmanager
def shown(chromium: Any, path: Path) -> Iterator[Any]:
    """A page in a browser that can be asked."""
    with a_page(chromium, 800, 600) as page:
        page.goto(path.as_uri())
        page.wait_for_function("() => window.drsplat && drsplat.backend.search")
        yield page


@pytest.mark.parametrize("kind", ["objects", "plain"])
def test_fifty_words_that_nobody_baked_in_are_answered_as_the_engine_does(exported, kind, chromium):
    """Sure, maybe or nothing, how many matches are sure, and the best one: its object, its place, its Gaussians."""
    scene, path = exported[kind]
    assert len(set(FIFTY) - set(BAKED)) == 50
    with shown(chromium, path) as page:
        answers = page.evaluate(FIND, FIFTY)
    wrong = []
    for text, answer in zip(FIFTY, answers, strict=True):
        asked = scene.ask(text)
        expected, matches = scene.locate(asked), answer["matches"]
        same = answer["certainty"] == asked.certainty
        same &= sum(one["sure"] for one in matches) == sum(one.sure for one in expected)
        same &= bool(matches) == bool(expected)
        if matches and expected:
            center = [float(x) for x in matches[0]["place"].split(", ")]
            same &= max(matches[0]["object"], -1) == (-1 if expected[0].object_id is None else expected[0].object_id)
            same &= bool(np.linalg.norm(center - expected[0].center) < 0.05 + 0.05 * expected[0].extent.max())
            same &= abs(matches[0]["num_gaussians"] - len(expected[0])) < 20 + 0.1 * len(expected[0])
        wrong += [] if same else [(text, asked.certainty, expected, answer["certainty"], matches[:1])]
    assert wrong == []


@pytest.mark.parametrize("kind", ["objects", "plain"])
def test_the_rules_are_those_of_the_engine(exported, kind, chromium, monkeypatch):
    """The engine, asked of the features that the page holds, has the same values, thresholds and doubts."""
    texts = [
        "mug",
        "red vase",
        "green vase",
        "yellow mug",
        "blue clock",
        "something white",
        "grey",
        "chair, not brown",
        "fork",
        "furniture",
        "window",
    ]
    scene, path = exported[kind]
    document, arrays = read_page(path)
    order = np.argsort(-significance(scene.gaussians), kind="stable")
    lists = {len(one["texts"]): one for one in document["search"]["lists"].values()}
    usual = arrays["usual"]
    monkeypatch.setattr(contrast, "_usual", lambda _pictures, words, _threads: (usual, lists[len(words)]["spread"]))
    monkeypatch.setattr(measuring, "least_peak", lambda _encoder, known: lists[len(known.vectors)]["least"])
    twin = decoded(scene, arrays, order)
    with shown(chromium, path) as page:
        rows, answers = page.evaluate(VALUES, texts)
    of_page = twin.field.rows_of(order[np.array(rows)])
    for text, own in zip(texts, answers, strict=True):
        answer = twin.ask(text)
        np.testing.assert_allclose(np.array(own["values"]), answer.values[of_page], atol=5e-4, err_msg=text)
        assert own["threshold"] == pytest.approx(answer.threshold, abs=5e-4), text
        assert (own["certainty"], own["doubt"], own["measure"]) == (answer.certainty, answer.doubt, answer.measure)


def test_words_and_sentences_are_read_as_the_engine_reads_them(exported, chromium):
    texts = [
        "Orange", "an orange mug", "the orange one", "something orange", "knives", "teddy bears", "loaves",
        "dark green", "a red thing", "violet", "wooden chairs", "boxes", *WORDS, *SYNONYMS, "rose",
        "The Red  mugs", "gray sofa", "blue fruit", "red wooden chair", "orange orange",
    ]  # fmt: skip
    sentences = [
        "how many mugs", "How many red mugs are there?", "show me the lamp", "where is the couch", "two chairs",
        "a book that is not red", "mug, not red", "mug but not red, not blue", "what is here", "mug in this room",
        "over ear headphones", "find all mugs in the room", "the vase", "number of books", "lamp on", "built-in oven",
    ]  # fmt: skip
    refused = ["mug on the table", "what is on the table", "the chair behind the desk", "the book between a and b"]
    with shown(chromium, exported["plain"][1]) as page:
        read = page.evaluate(WORDS_OF, texts)
        said = page.evaluate(READ, [*sentences, *refused])
        unknown = page.evaluate(
            "async () => { const search = await drsplat.backend.search;"
            " try { return search.find('red chaise'); } catch (error) { return String(error); } }"
        )
    assert read == [[words_of(text), only_colors(text), bool(nouns_in(text)), swapped(text)] for text in texts]
    expected = [split_negation(parsed(text).text) for text in sentences]
    assert said[: len(sentences)] == [[wanted, list(unwanted)] for wanted, unwanted in expected]
    assert all("this page does not know" in refusal for refusal in said[len(sentences) :])
    assert "does not know “chaise”" in unknown
    assert "chair" in unknown


def test_a_page_says_what_it_knows_and_offers_it(exported, chromium):
    """Before anybody types, and while they type; what it does not know it says with the nearest words."""
    with shown(chromium, exported["objects"][1]) as page:
        page.wait_for_selector("#knows")
        assert "English words" in page.inner_text("#knows")
        page.fill("#query", "blue ca")
        assert "blue candle" in page.inner_text("#suggestions")
        page.fill("#query", "green mug")
        page.press("#query", "Enter")
        page.wait_for_function("() => drsplat.state.results[0]?.text === 'green mug'", timeout=SLOW)
        settled(page)
        assert "1 match" in page.inner_text("#content")
        owners = page.evaluate("async () => (await drsplat.backend.paint()).owner.reduce((sum, k) => sum + (k > 0), 0)")
        assert owners == page.evaluate("drsplat.state.results[0].matches[0].num_gaussians")
        page.fill("#query", "elephant")
        page.press("#query", "Enter")
        page.wait_for_selector("#message.fault", timeout=SLOW)
        assert "does not know “elephant”" in page.inner_text("#message")


@pytest.mark.parametrize("kind", ["objects", "plain"])
def test_without_a_match_a_page_names_words_that_do_match(exported, kind, chromium):
    """As the engine does: how near the best place came, and the nearest words, which can be clicked."""
    scene, path = exported[kind]
    answer = scene.ask("teddy bear")
    expected = words_instead(scene, answer)
    assert len(expected) == 3
    with shown(chromium, path) as page:
        page.fill("#query", "teddy bear")
        page.press("#query", "Enter")
        page.wait_for_selector("#content .instead", timeout=SLOW)
        said = page.inner_text("#content")
        assert "No match for “teddy bear”. The best place has a relevancy of 0." in said
        assert page.locator("#content .instead button").all_inner_texts() == expected
        page.click(f"#content .instead button:text-is('{expected[0]}')")
        page.wait_for_function(f"() => drsplat.state.results[0]?.text === '{expected[0]}'", timeout=SLOW)
        settled(page)
        assert page.evaluate("drsplat.state.results[0].matches[0].sure")
        assert page.locator("#content .instead").count() == 0


def test_a_page_is_at_most_twice_as_large_as_without_its_search(exported, tmp_path):
    scene, path = exported["objects"]
    made = export_page(tmp_path / "page.html", scene, BAKED)
    pages.write_page(tmp_path / "without.html", replace(made, search=None))
    assert path.stat().st_size < 2 * (tmp_path / "without.html").stat().st_size


def listed_scene(words: int = 350, rows: int = 6000) -> Scene:
    """Three things that look as some of many listed words do, in the space of CLIP-like vectors."""
    world = World(words)
    truth = np.repeat([0, 1, 2], [rows // 2, rows // 3, rows // 6])
    rng = np.random.default_rng(1)
    points = np.array([(-2.0, 0, 0), (0, 0, 0), (2, 0, 0.5)])[truth] + 0.5 * rng.random((rows, 3))
    gaussians = Gaussians(
        points.astype(np.float32), np.tile(np.array([1, 0, 0, 0], np.float32), (rows, 1)),
        np.full((rows, 3), 0.03, np.float32), np.full(rows, 0.8, np.float32), np.zeros((rows, 1, 3), np.float32),
    )  # fmt: skip
    field = build_field(evidence_of(world.pictures(truth)), gaussians.fingerprint, CLIP, Mixture(1))
    names = ("stone", "canoe", "ferry", *(f"word {n}" for n in range(3, words - 1)), "boat")
    field = field.with_contrast(world.texts, names)
    views = (look_at_view((0.0, -6.0, 1.0)), look_at_view((0.5, -6.0, 1.2)))
    return Scene(field, gaussians, views, VocabularyEncoder(CLIP, names, world.texts), threads=1)


def test_a_listed_word_is_answered_as_the_engine_does(chromium, tmp_path):
    """Of a field that keeps its words, as CLIP's do: also a kind, which its names answer."""
    scene = listed_scene()
    export_page(tmp_path / "page.html", scene, ["stone"])
    texts = ["canoe", "ferry", "boat", "the Boats", *(f"word {n}" for n in range(3, 50))]
    with shown(chromium, tmp_path / "page.html") as page:
        answers = page.evaluate(FIND, texts)
        assert "350 words and phrases" in page.inner_text("#knows")
        assert page.evaluate("async () => (await drsplat.backend.search).suggest('word 1', 3)") == [
            "word 10", "word 11", "word 12",
        ]  # fmt: skip
    certain = set()
    for text, answer in zip(texts, answers, strict=True):
        asked = scene.ask(text)
        expected = scene.locate(asked)
        certain.add(asked.certainty)
        assert (answer["certainty"], answer["num_matches"]) == (asked.certainty, len(expected)), text
        doubt = answer["doubt"]
        if not expected:  # values far below the threshold differ by what codes are rounded
            doubt, _, value = doubt.partition("The best place has a relevancy of ")
            assert 0 <= float(value[:4]) <= 0.5, text
        assert doubt.removesuffix(". ") == asked.doubt, text
        assert sum(one["sure"] for one in answer["matches"]) == sum(one.sure for one in expected), text
    assert {"sure", "nothing"} <= certain


def test_near_words_are_the_same_one_by_one_and_all_at_once():
    world = World(60)
    queries = np.concatenate([world.texts[:20], World(9, seed=2).texts])
    each = contrast.near_each(world.texts, queries)
    for number, query in enumerate(queries):
        texts = np.concatenate([world.texts, query[None]]).astype(np.float64)
        same = texts[:-1] @ texts[-1] > 1 - 1e-5
        texts -= texts.mean(0)
        texts /= np.linalg.norm(texts, axis=1, keepdims=True)
        expected = same | (texts[:-1] @ texts[-1] > contrast.SAME_MEANING_COSINE)
        np.testing.assert_array_equal(each[:, number], expected)
