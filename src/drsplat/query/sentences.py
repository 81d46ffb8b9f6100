"""Sentences of a query: "the mug on the table", "how many mugs", "a book that is not red"; docs/tasks.md lists them.

What names two things is answered by how they lie (`relations`), never by the sum of its nouns.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError
from ..photos.models.mini.lexicon import COLORS, TONES
from ..scene.encoders import Encoder
from .answer import Answer, Match
from .defaults import OBJECT
from .query import Query
from .search import split_negation
from .tasks import meant_of

if TYPE_CHECKING:
    from .scene import Scene

_SPELLED = {
    "on top of": "on", "on": "on", "inside of": "in", "inside": "in", "in": "in", "next to": "next_to",
    "beside": "next_to", "close to": "next_to", "near": "next_to", "underneath": "under", "under": "under",
    "beneath": "under", "below": "under", "above": "above", "over": "above", "between": "between",
    "to the left of": "left_of", "left of": "left_of", "to the right of": "right_of", "right of": "right_of",
}  # fmt: skip
_UNKNOWN = (
    "behind", "in front of", "in the middle of", "around", "across from", "opposite", "against", "closest to",
    "nearest to", "far from", "larger than", "bigger than", "smaller than", "largest", "biggest", "smallest", "tallest",
    "leftmost", "rightmost",
)  # fmt: skip
_ANYTHING = {"", "all", "anything", "everything", "something", "object", "objects", "thing", "things", "what"}
HERE = {"scene", "room", "picture", "photo", "photos", "here", "use", "total", "there", "it"}
ASKING = re.compile(
    r"^(?:how many|(?:the )?number of|count(?: all)?|find(?: me)?|show(?: me)?|where(?:'s| is| are)|"
    r"what(?:'s| is| are)?)\s+"
)
THERE = re.compile(r"\s+(?:are|is) there\b")
ARTICLE = re.compile(r"^(?:(?:the|this|an?|any|some|all|my)\s+)+", re.IGNORECASE)
NUMBER = re.compile(r"^(?:two|three|four|five|six|seven|eight|nine|ten|[2-9]|1\d)\s+(?=\S)")
NOT = re.compile(r"\s+(?:that|which)\s+(?:is|are)\s+not\s+")
POSED = re.compile(
    r"(?:^|\s+)(?:(?:that|which)\s+)?(?:(?:is|are|lies?|stands?|sits?)\s*)?"
    r"(?:(?:standing|sitting|lying|hanging|placed|put)\s*)?$"
)


class Sentence(NamedTuple):
    """Target of a text. relation: of `relations`, to the others; "": the text is all. text: "" for anything."""

    text: str
    relation: str = ""
    others: tuple[str, ...] = ()


def _any_of(words: Sequence[str]) -> str:
    """Return a pattern of any of some words, which are no part of another: the "in" of "built-in", nor of a bracket."""
    return rf"(?<![\w(-])({'|'.join(sorted(map(re.escape, words), key=len, reverse=True))})(?![\w-])"


RELATED, STRANGE = re.compile(_any_of(list(_SPELLED))), re.compile(_any_of(_UNKNOWN))


def parsed(text: str) -> Sentence:
    """Return what a text asks for; a text that is no sentence stands for itself.

    Raises: InputError: a relation that is not known.
    """
    said = " ".join(text.split()).rstrip("?.! ")
    lower = said.lower()
    asking = ASKING.match(lower)
    if asking:
        said = THERE.sub("", said[asking.end() :], count=1)
    said = NOT.sub(", not ", said)
    strange = STRANGE.search(said.lower())
    if strange and said[strange.end() :].strip():
        raise InputError(
            f"'{strange[0]}' is not understood: expected 'X on Y', or X in, next to, under, above, left of or right of "
            "Y, or between Y and Z"
        )
    found = RELATED.search(said.lower())
    if found is None:
        return Sentence(_thing(said) if asking or NUMBER.match(lower) else said)
    place = said[found.end() :].strip(" ,")
    if not (said[: found.start()].strip() or asking or ARTICLE.match(place)):
        return Sentence(said)  # "over ear headphones", where "on the table" asks for what is there
    after, *unwanted = re.split(r"(?=, not )", ARTICLE.sub("", place))
    before = POSED.sub("", said[: found.start()]) + "".join(unwanted)
    if not after or after.lower() in {*COLORS, *TONES} or after.lower().split()[0] in HERE:
        is_place = bool(after) and after.lower() in HERE
        return Sentence(_thing(before) if is_place or asking else said)
    relation = _SPELLED[found[0]]
    others = tuple(_thing(one) for one in re.split(r"\s+and\s+", after)) if relation == "between" else (_thing(after),)
    if relation == "between" and len(others) != 2:
        raise InputError(f"'{text}': expected two things, as in 'the book between the lamp and the vase'")
    what = _thing(before)
    return Sentence("" if what.lower() in _ANYTHING else what, relation, others)


def known_parts(text: str, encoder: Encoder | None) -> list[str]:
    """Return the texts that a query embeds, one for each thing that its sentence names.

    encoder: who will embed them; None for one that takes any words.

    Raises: InputError: words that it does not know, or a sentence that is not understood; as `Scene.ask`.
    """
    sentence = parsed(text)
    parts = [split_negation(part) for part in (sentence.text, *sentence.others) if part]
    wanted = [part for part, _ in parts]
    if encoder is not None:
        encoder.encode_texts([*wanted, *(f"{word} {part}" for part, unwanted in parts for word in unwanted)])
    return wanted


def _thing(words: str) -> str:
    return NUMBER.sub("", ARTICLE.sub("", words.strip(" ,")))


def related_answer(scene: "Scene", query: Query, sentence: Sentence) -> Answer:
    """Return what a sentence means of the answer to its first thing: the matches that lie so to another one's.

    Raises: as `Scene.ask`; InputError: the photos do not tell which way is up.
    """
    from .relations import SIDES, is_beside

    answer, matches = _candidates(scene, query, sentence.text)
    ends: list[list[Match]] = []
    doubts = [answer.doubt]
    for text in sentence.others:
        other = scene.ask(replace(query, text=text))
        found = scene.locate(other)
        ends.append(meant_of(found, scene.rows) or found)
        doubts.append(
            other.doubt
            if found
            else f"no match for '{text}', so nothing can be {sentence.relation.replace('_', ' ')} it"
        )
    up = scene.up
    if up is None and sentence.relation not in SIDES:
        raise InputError("the photos of this scene do not tell which way is up: ask without 'on', 'in' and the like")
    seen_from = ""
    if sentence.relation in SIDES and ends[0]:
        view = scene.best_view(ends[0][0].gaussian_ids)
        seen_from = view.name
        kept = [one for one in matches if is_beside(view, sentence.relation, one, ends[0][0])]  # type: ignore[arg-type]
    elif all(ends):
        assert up is not None
        kept = [one for one in matches if _holds(scene, sentence.relation, one, ends, up)]
    else:
        kept = []
    ids = np.concatenate([one.gaussian_ids for one in kept] or [np.empty(0, np.int64)])
    meant = np.isin(answer.field.gaussian_ids, ids)
    values = np.where(meant, answer.values, np.float32(answer.lowest))
    threshold = answer.threshold if len(ids) else float(values.max(initial=answer.threshold))
    doubt = ". ".join(dict.fromkeys(filter(None, doubts)))
    return replace(answer, values=values, threshold=threshold, doubt=doubt, seen_from=seen_from)


def _candidates(scene: "Scene", query: Query, text: str) -> tuple[Answer, list[Match]]:
    """Return the answer to a text with its matches; to none all objects that photos agree on."""
    if text:
        answer = scene.ask(replace(query, text=text))
        return answer, scene.locate(answer)
    listed = [one for one, agreed in zip(scene.objects, scene.agreed, strict=True) if agreed]
    rows = scene.field.rows_of(np.concatenate([one.gaussian_ids for one in listed] or [np.empty(0, np.int64)]))
    return Answer.of_rows(scene.field, rows, OBJECT), listed


def _holds(scene: "Scene", relation: str, one: Match, ends: Sequence[Sequence[Match]], up: np.ndarray) -> bool:
    from .relations import related

    if relation == "between":
        pairs = ((first, second) for first in ends[0] for second in ends[1])
        return any(related(scene.rows, "between", [one], first, second, up) for first, second in pairs)
    return any(related(scene.rows, relation, [one], end, None, up) for end in ends[0])  # type: ignore[arg-type]
