"""Queries asked together, and their matches."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...base.arrays import Ids, Int64, Numbers, RowIds, Shaped, WholeNumbers
from ...base.terminal import counted
from ...drawing.heat import heat_of
from ...kernels.boxes import box_of
from ...query import Answer, Match, Scene
from ...query.defaults import MAYBE, OBJECT
from ...query.suggesting import missed_text, words_instead
from ...scene.boxes import solid

QUERY_SEPARATOR = ";"


@dataclass(frozen=True, eq=False)
class Result:
    """One query, where its values are cut now, and the matches above that.

    answer.threshold is the one that was chosen for it, and stays marked; threshold is the slider's. instead: words that
    have a match where this has none.
    """

    label: str
    answer: Answer
    threshold: float
    matches: list[Match]
    instead: Sequence[str] = ()

    @cached_property
    def gaussian_ids(self) -> RowIds:
        """Sorted ids of the Gaussians of all matches."""
        return joined([match.gaussian_ids for match in self.matches])

    @cached_property
    def heat(self) -> Numbers:
        """How well each row of the field answers, as in `drawing.heat.heat_of`."""
        values = self.answer.values
        return heat_of(values, self.threshold) if len(values) else values

    @property
    def limits(self) -> tuple[float, float]:
        """Between which a threshold makes a difference: the median and the highest value."""
        values = self.answer.values
        if not len(values):
            return 0.0, 1.0
        low, high = float(np.median(values)), float(values.max())
        low, high = min(low, self.answer.threshold), max(high, self.answer.threshold)
        return low, high if high > low else low + 1e-3

    def notes(self) -> str:
        """Return reasons not to rely on the matches; without one how near it came."""
        answer = replace(self.answer, threshold=self.threshold)
        sides = f"left and right are those of the photo {answer.seen_from}" if answer.seen_from else ""
        missed = "" if self.matches else missed_text(answer)
        return ". ".join(filter(None, (answer.doubt, sides, missed)))

    @property
    def summary(self) -> str:
        """Sentence with the number of matches, and what to know of them, if there is anything."""
        notes = self.notes()
        if not self.matches:
            return f"No match for '{self.label}'. {notes}".rstrip()
        matches = counted(len(self.matches), "match", "matches")
        maybe = "maybe " if self.answer.certainty == MAYBE else ""
        more = f" ({notes})" if notes else ""
        return f"{self.label}: {maybe}{matches}, {counted(len(self.gaussian_ids), 'Gaussian')}{more}"


def result_of(scene: Scene, label: str, answer: Answer, most: int | None = None) -> Result:
    """Return an answer with its best matches, `most` or all; without any, with words that have one."""
    matches = scene.locate(answer, top=most)
    instead = words_instead(scene, answer) if label and not matches else ()
    return Result(label, answer, answer.threshold, matches, instead)


def result_of_ids(scene: Scene, label: str, ids: RowIds) -> Result:
    """Return exactly some Gaussians, one or more, as the only match of a query; they need no feature."""
    rows = scene.field.rows_of(ids)
    answer = Answer.of_rows(scene.field, rows[rows >= 0], OBJECT)
    gaussians = scene.rows.shapes_of(solid(scene.rows, ids))
    box = box_of(gaussians, np.arange(len(gaussians)), scene.up)
    return Result(label, answer, answer.threshold, [Match(box.center, box.axes, box.extent, 1.0, ids)])


def cut_at(scene: Scene, result: Result, threshold: float) -> Result:
    """Return the result of the same query with another threshold."""
    matches = scene.locate(result.answer.cut_at(threshold))
    return replace(result, threshold=threshold, matches=matches)


def split_queries(text: str) -> list[str]:
    """Split "mug; lamp" into two queries; the same one twice is one."""
    return list(dict.fromkeys(part.strip() for part in text.split(QUERY_SEPARATOR) if part.strip()))


def joined(parts: Sequence[Int64[np.ndarray, " _"]]) -> WholeNumbers:
    """Return all ids in any of the parts, ascending."""
    return np.unique(np.concatenate(parts)) if parts else np.empty(0, np.int64)


def heat(results: Sequence[Result], count: int, rows: WholeNumbers | None = None) -> Numbers:
    """Return per Gaussian of a scene of `count`, or of some rows of it, how well it answers; the best of all queries.

    What has no feature is cold.
    """
    warmest = np.zeros(count if rows is None else len(rows), np.float32)
    for result in results:
        field = result.answer.field
        if rows is None:
            at, warm = field.gaussian_ids, result.heat
        else:
            own = field.rows_of(rows)
            at = np.flatnonzero(own >= 0)
            warm = result.heat[own[at]]
        warmest[at] = np.maximum(warmest[at], warm)
    return warmest


def owners(results: Sequence[Result], count: int, rows: WholeNumbers | None = None) -> Ids:
    """Return per Gaussian of a scene of `count`, or of some rows of it, the query that it matches; -1 for none.

    Of several queries it is the first.
    """
    parts = [result.gaussian_ids for result in results]
    if rows is None:
        return _numbered(parts, count)
    return _numbered([np.flatnonzero(np.isin(rows, ids, assume_unique=True)) for ids in parts], len(rows))


def match_ids(results: Sequence[Result], count: int) -> Ids:
    """Return per Gaussian the number of its match, counted through all queries; -1 for none."""
    return _numbered([match.gaussian_ids for result in results for match in result.matches], count)


def _numbered(parts: Sequence[Int64[np.ndarray, " _"]], count: int) -> Ids:
    numbers = np.full(count, -1, np.int32)
    for number, ids in reversed(list(enumerate(parts))):
        numbers[ids] = number
    return numbers


def relevancy(results: Sequence[Result], count: int) -> Numbers:
    """Return per Gaussian the highest value of any query, in its own measure."""
    return np.max([result.answer.dense for result in results] or [np.zeros(count, np.float32)], axis=0)


def taken(values: Shaped[np.ndarray, " n"], ids: Int64[np.ndarray, " m"], fill: int = 0) -> Shaped[np.ndarray, " m"]:
    """Return values of the scene's rows for some rows, among them such as edits added, which have `fill`."""
    own = ids < len(values)
    found = np.full(len(ids), fill, values.dtype)
    found[own] = values[ids[own]]
    return found
