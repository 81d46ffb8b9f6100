"""From a scene and queries to a page."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, UInt8, UInt16

from ..errors import DrSplatError
from ..query import Scene
from . import painting
from .cameras import before
from .naming import words_of
from .page import MOST_WORDS, Page, PageAnswer
from .results import Result, result_of
from .session import Mode, Session

MOST_MATCHES = 254  # of one query: a byte per Gaussian says which


def page_of(
    session: Session,
    texts: Sequence[str],
    look: tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]],
    up: Float64[np.ndarray, " 3"],
    title: str = "",
) -> Page:
    """The scene with the answers to some texts. look: eye and target of the first look, in the world.

    Raises: InputError: words that the encoder does not know. MismatchError: another encoder.
    """
    scene, shown = session.scene, session.shown
    answers = [_answer(session, text, up) for text in texts]
    session.mode = Mode.FEATURES
    features = session.colors[shown.ids]
    words, best = _words(scene, session.words)
    return Page(
        title or scene.name, shown, answers, *look, up, features, words,
        None if best is None else best[shown.ids],
    )  # fmt: skip


def _answer(session: Session, text: str, up: Float64[np.ndarray, " 3"]) -> PageAnswer:
    scene, ids = session.scene, session.shown.ids
    result = result_of(scene, text, scene.ask(text))
    matches = result.matches[:MOST_MATCHES]
    warm = painting.heat_of(result.answer.values, result.threshold)
    return PageAnswer(
        text,
        scene.field.dense(warm, fill=0.0)[ids],
        _owners(result, scene)[ids],
        matches,
        [before(match, scene.gaussians, scene.views, up) for match in matches],
    )


def _owners(result: Result, scene: Scene) -> UInt8[np.ndarray, " n"]:
    owners = np.zeros(len(scene.gaussians), np.uint8)
    for number, one in enumerate(result.matches[:MOST_MATCHES]):
        owners[one.gaussian_ids] = number + 1
    return owners


def _words(scene: Scene, given: Sequence[str] | None) -> tuple[Sequence[str], UInt16[np.ndarray, " n"] | None]:
    """The words of a click, and each Gaussian's best; none for an encoder that does not know them."""
    try:
        words = tuple(dict.fromkeys(given or words_of(scene)))[:MOST_WORDS]
        return words, (scene.segment(words).labels + 1).astype(np.uint16)
    except DrSplatError:
        return (), None
