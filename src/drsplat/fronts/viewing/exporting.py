"""Pages made of a scene and queries."""

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike

import numpy as np

from ...authoring.editing.kept import KeptEdits, without_kept
from ...authoring.filming.looking import before, up_direction
from ...authoring.filming.paths import CameraPath
from ...authoring.filming.planning import ORBIT, path_named
from ...base.arrays import Float64, Shaped, UInt8, UInt16
from ...drawing.heat import heat_of
from ...errors import DrSplatError, InputError
from ...query import Scene
from .bare import NO_FIELD
from .cameras import first_look
from .naming import words_of
from .page import MAX_GAUSSIANS, MAX_WORDS, Page, PageAnswer, write_page
from .page_parts import annotations_of_page, object_numbers, objects_of_page
from .page_times import PageTimes, boxes_of, times_of_page
from .playing import placed_now
from .results import Result, result_of
from .session import Mode, Session

SAMPLED_ROWS, ROWS_AT_ONCE, WORDS_PER_ROW = 20_000, 4096, 3
MAX_MATCHES = 254  # of one query: a byte per Gaussian says which


def export_page(
    path: str | PathLike[str],
    scene: Scene,
    queries: Sequence[str],
    *,
    words: Sequence[str] | None = None,
    up: Float64[np.ndarray, " 3"] | None = None,
    max_gaussians: int | None = None,
    path_name: str = ORBIT,
    plays: bool = False,
    title: str = "",
    edits: KeptEdits = "kept",
    overwrite: bool = False,
) -> Page:
    """Write a scene and its answers to one HTML file, which needs nothing but a browser; returns what is in it.

    words: what a click on the page can say; None: the encoder's own. up: a unit direction, None: as the photos were
    held. max_gaussians: the most significant ones are shown, 200,000 at most. path_name: of the film that it plays, as
    `authoring.filming.planning.path_named` has it. plays: plays it when it is opened. title: the scene's name if
    empty. edits: "kept" shows the scene with the edits kept beside it, `num_edits` of the page; "none" as its file has
    it.

    Raises: InputError: no queries, or a scene that cannot be asked any; the file exists and not `overwrite`; words
    that the encoder does not know; more that moves than a page has room for. MismatchError: another encoder.
    """
    session = Session(
        scene,
        min(max_gaussians or MAX_GAUSSIANS, MAX_GAUSSIANS),
        words,
        edits_kept=not without_kept(edits, changes=False, saves=False),
    )
    up = up_direction(scene) if up is None else up
    page = _filmed_page(session, queries, up, title, path_name)
    page = replace(page, plays=plays)
    write_page(path, page, overwrite=overwrite)
    return page


def export_session(
    path: str | PathLike[str], session: Session, queries: Sequence[str], *, up: Float64[np.ndarray, " 3"]
) -> Page:
    """Write a page of a session's scene as edited there, with the answers to queries; the session stays as it is.

    Raises: as `export_page`.
    """
    page = _filmed_page(session.unasked(MAX_GAUSSIANS), queries, up, "", ORBIT)
    write_page(path, page)
    return page


def _filmed_page(
    session: Session, queries: Sequence[str], up: Float64[np.ndarray, " 3"], title: str, path_name: str
) -> Page:
    """Return a page of a session that was not asked anything, with a film."""
    if bool(queries) != session.is_askable:
        raise InputError(
            NO_FIELD if queries else 'a page holds answers: give it queries, as in drsplat view --ask "red mug; lamp"'
        )
    film = path_named(path_name, session.scene.gaussians, session.scene.views, up=up)
    return page_of(session, queries, None, up, title, film)


def page_of(
    session: Session,
    texts: Sequence[str],
    look: tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]] | None,
    up: Float64[np.ndarray, " 3"],
    title: str = "",
    path: CameraPath | None = None,
) -> Page:
    """Make a page of the scene with the answers to some texts.

    look: eye and target of the first look, in the world; None: before the best match of the first text that has one,
    else as the viewer begins.

    Raises: InputError: words that the encoder does not know; too much that moves. MismatchError: another encoder.
    """
    times = times_of_page(session)
    scene, shown = session.scene, session.drawn
    answers = [_answer(session, text, up, times) for text in texts]
    session.mode = Mode.FEATURES
    features = session.drawn_colors[shown.ids]
    words, best = _words(scene, session.words)
    numbers = object_numbers(session)
    look = look or _best_look(answers) or first_look(scene.views, session.shown.frame, up)
    return Page(
        title or scene.name, shown, session.edits.part(shown.ids)[0], answers, *look, up, features, words,
        None if best is None else _shown(session, best),
        objects=objects_of_page(session, up, times), annotations=annotations_of_page(session, up),
        object_numbers=None if numbers is None else _shown(session, numbers), path=path, times=times,
        num_edits=session.edits.listed.done,
    )  # fmt: skip


def _best_look(answers: Sequence[PageAnswer]) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]] | None:
    """Return eye and target before the first match of the first answer that has one."""
    return next(((answer.eyes[0], answer.matches[0].center) for answer in answers if answer.matches), None)


def _shown(session: Session, values: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, " m"]:
    """Return values of the scene's rows for those that are shown; 0 for what edits added."""
    added = np.zeros(len(session.drawn_colors) - len(values), values.dtype)
    return np.asarray(np.concatenate([values, added])[session.drawn.ids])


def _answer(session: Session, text: str, up: Float64[np.ndarray, " 3"], times: PageTimes | None) -> PageAnswer:
    scene = session.scene
    result = result_of(scene, text, scene.ask(text))
    matches = [placed_now(session, match) for match in result.matches[:MAX_MATCHES]]
    warm = heat_of(result.answer.values, result.threshold)
    return PageAnswer(
        text,
        _shown(session, scene.field.dense(warm, fill=0.0)),
        _shown(session, _owners(result, scene)),
        matches,
        [before(match, scene.gaussians, scene.views, up) for match in matches],
        boxes_of(session, times, matches),
        result.answer.doubt,
    )


def _owners(result: Result, scene: Scene) -> UInt8[np.ndarray, " n"]:
    owners = np.zeros(len(scene.gaussians), np.uint8)
    for number, one in enumerate(result.matches[:MAX_MATCHES]):
        owners[one.gaussian_ids] = number + 1
    return owners


def _words(scene: Scene, given: Sequence[str] | None) -> tuple[Sequence[str], UInt16[np.ndarray, " n"] | None]:
    """Return the words of a click, and each Gaussian's best; none for an encoder that does not know them."""
    try:
        words = _fitting(scene, tuple(dict.fromkeys(given or words_of(scene)))[:MAX_WORDS])
        return words, (scene.segment(words).labels + 1).astype(np.uint16)
    except DrSplatError:
        return (), None


def _fitting(scene: Scene, words: tuple[str, ...]) -> tuple[str, ...]:
    """Return the words that are among the best of any row of a sample; the others would name nothing here."""
    rows = len(scene.field)
    if not rows or len(words) <= WORDS_PER_ROW:
        return words
    chosen = np.sort(np.random.default_rng(0).permutation(rows)[:SAMPLED_ROWS])
    vectors = np.asarray(scene.encoder.encode_texts(words), np.float32)
    best = np.zeros(len(words), bool)
    for begin in range(0, len(chosen), ROWS_AT_ONCE):
        scores = scene.field.feature(chosen[begin : begin + ROWS_AT_ONCE]) @ vectors.T
        best[np.argpartition(-scores, WORDS_PER_ROW - 1, axis=1)[:, :WORDS_PER_ROW]] = True
    return tuple(word for word, fits in zip(words, best, strict=True) if fits)
