"""Naming of a place: its words, the masks of supporting photos, and what is like it."""

from collections.abc import Sequence
from dataclasses import dataclass

from ...base.arrays import OtherPixels, Vector
from ...errors import DrSplatError
from ...field.evidence.evidence import Explanation
from ...query import Match, Query, Scene, Word
from ...query.suggesting import words_of
from .picking import Hit
from .results import Result, result_of

MAX_EVIDENCE_MASKS, PICTURE_SIDE_PIXELS = 3, 480


@dataclass(frozen=True, eq=False)
class This:
    """words: best first, none where no encoder is known. evidence: photos and masks behind it.

    match: what is like it and holds it, None where that is too little. alike: all that is like it.
    """

    gaussian_id: int
    point: Vector
    words: list[Word]
    evidence: list[Explanation]
    match: Match | None
    alike: Result

    @property
    def name(self) -> str:
        return self.words[0].text if self.words else ""


def this_is(scene: Scene, hit: Hit, words: Sequence[str] | None = None) -> This:
    """Describe what the first Gaussian of a hit is; all of them must have a feature."""
    first = int(hit.gaussian_ids[0])
    feature = scene.feature_of(first)
    alike = result_of(scene, "", scene.ask(Query(vector=feature)))
    holding = [match for match in alike.matches if first in match.gaussian_ids]
    return This(
        first,
        hit.point,
        named(scene, first, words),
        [] if scene.field.evidence is None else scene.field.explain(first, feature, MAX_EVIDENCE_MASKS),
        holding[0] if holding else None,
        alike,
    )


def named(scene: Scene, gaussian_id: int, words: Sequence[str] | None) -> list[Word]:
    """Return the best words; none for a field whose encoder is not at hand."""
    try:
        return scene.what_is(gaussian_id, words or words_of(scene))
    except DrSplatError:
        return []


def known_words(scene: Scene, words: Sequence[str] | None) -> tuple[str, ...]:
    """Return words to name things with: given ones, else as `words_of`; none where the encoder is not at hand."""
    try:
        return tuple(words or words_of(scene))
    except DrSplatError:
        return ()


def photo_of(scene: Scene, this: This) -> OtherPixels | None:
    """Return the photo of most support, with the place in colour; None where there is none."""
    best = best_photo(scene, this)
    if best is None or this.match is None:
        return None
    return scene.picture(best, this.match.gaussian_ids, photo=True, max_side=PICTURE_SIDE_PIXELS)


def best_photo(scene: Scene, this: This) -> str | None:
    """Return the name of the photo of most support; None where there is none to show."""
    names = {view.name for view in scene.views}
    best = next((one.view_name for one in this.evidence if one.view_name in names), None)
    return None if this.match is None else best
