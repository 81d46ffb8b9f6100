"""Rules that make a selection of one word out of the same features: ours, parts of ours, and what others do.

| rule | selects |
|---|---|
| objects, plain | what drsplat does by default, and the same without objects; `present`: nothing is refused |
| best of the list | Gaussians that the word fits better than all other words of the list, by cosine |
| LERF | relevancy above 0.5, against four words that mean nothing in particular |
| LangSplat | relevancy above 0.7 of its own range, as that system's evaluation cuts pictures |
| cosine | cosines above one number for all words, of which `study_rules.py` chooses the best on other places |
| component | the heaviest connected part of what lies above 0.6 of the way to the peak |
| one object | the object that the word fits best, as OpenGaussian answers; words may mean several things here |
| best word of objects | the objects whose mean the word fits better than all other words of the list |
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Int64
from scipy.sparse import csr_array

from drsplat import Query, Scene
from drsplat.field.language_field import relevancy_from_scores
from drsplat.photos.models.word_list import list_vectors
from drsplat.query.answer import Answer
from drsplat.query.contrast import Contrast, _margin, contrast, least_clear
from drsplat.query.defaults import NOTHING
from drsplat.query.linking import components
from drsplat.query.thresholds import automatic_threshold, peak_score
from drsplat.query.wholes import with_objects

from .trials import Trial

Values = Float32[np.ndarray, " r"]
Rows = Bool[np.ndarray, " r"]
LERF_LEVEL, LANGSPLAT_LEVEL = 0.5, 0.7
COSINES = tuple(round(0.12 + 0.02 * k, 2) for k in range(16))  # fixed thresholds that are tried
PRESENT = ", present"
ROWS_AT_ONCE = 4096


@dataclass(frozen=True, eq=False)
class Rules:
    """All rules on one trial. negatives: vectors of LERF's four words, None where they are not known."""

    case: Trial
    negatives: Float32[np.ndarray, "n D"] | None = None

    @cached_property
    def scene(self) -> Scene:
        return Scene(replace(self.case.field, objects=None), self.case.gaussians, encoder=self.case.encoder)

    @cached_property
    def known(self) -> Contrast:
        return contrast(self.scene.field, list_vectors(self.case.encoder))

    def asked(self, text: str) -> "Asked":
        forced = self.scene.ask(Query(text, present=True))
        return Asked(self, text, self.scene.ask(text), forced)

    @cached_property
    def best_two(self) -> tuple[np.ndarray, np.ndarray]:
        """Per row the two highest cosines of words of the list, and which words they are of."""
        vectors, rows = list_vectors(self.case.encoder), self.case.field.code
        scores, words = np.empty((len(rows), 2), np.float32), np.empty((len(rows), 2), np.int64)
        for begin in range(0, len(rows), ROWS_AT_ONCE):
            run = np.arange(begin, min(begin + ROWS_AT_ONCE, len(rows)))
            own = rows.decode(run) @ vectors.T
            words[run] = np.argpartition(-own, 1, axis=1)[:, :2]
            scores[run] = np.take_along_axis(own, words[run], 1)
        return scores, words

    @cached_property
    def best_words(self) -> Int64[np.ndarray, " o"]:
        """Per object the word that its mean feature fits best."""
        field = self.case.field
        assert field.objects is not None
        rows, things = np.arange(len(field)), field.objects.thing_of()
        inside = things >= 0
        members = csr_array((np.ones(inside.sum()), (things[inside], rows[inside])), (len(field.objects), len(rows)))
        return np.asarray((members @ field.code.decode(rows) @ list_vectors(self.case.encoder).T).argmax(1))

    @cached_property
    def negative(self) -> Values:
        """Per row the highest cosine of LERF's words."""
        assert self.negatives is not None
        return np.asarray(self.case.field.scores(self.negatives.astype(np.float32)).max(0), np.float32)


@dataclass(frozen=True, eq=False)
class Asked:
    """One word. plain, forced: the answers without objects, the second with nothing refused."""

    rules: Rules
    text: str
    plain: Answer
    forced: Answer

    @property
    def query(self) -> Float32[np.ndarray, " D"]:
        assert self.plain.vector is not None
        return self.plain.vector

    def selections(self) -> Iterator[tuple[str, Rows]]:
        """Yield each rule's name and the rows that it selects."""
        objects = self.rules.case.field.objects
        assert objects is not None
        values = self.plain.values
        kinds = {"plain": values, "objects": with_objects(values, objects.thing_of(), objects.piece_of())}
        for name, answered in kinds.items():
            yield name, (answered > self.plain.threshold) & (self.plain.certainty != NOTHING)
            yield name + PRESENT, answered > self.forced.threshold
        yield from self._others()

    def _others(self) -> Iterator[tuple[str, Rows]]:
        cosines, case = self.plain.scores, self.rules.case
        scores, words = self.rules.best_two
        of_word = list_vectors(case.encoder) @ self.query > 1 - 1e-5
        yield "best of the list", cosines > np.where(of_word[words], -1, scores).max(1)
        cut = np.flatnonzero(cosines > automatic_threshold(cosines))
        parts = components(case.gaussians.means[case.field.gaussian_ids[cut]].astype(np.float64), None)
        yield "component", _marked(cut[parts == np.bincount(parts).argmax()], len(cosines))
        assert case.field.objects is not None
        things = case.field.objects.thing_of()
        inside = things >= 0
        means = np.bincount(things[inside], cosines[inside]) / np.maximum(np.bincount(things[inside]), 1)
        yield "one object", things == means.argmax()
        yield "best word of objects", np.isin(things, np.flatnonzero(of_word[self.rules.best_words]))
        if self.rules.negatives is not None:
            relevancy = relevancy_from_scores(cosines, self.rules.negative)
            yield "LERF", relevancy > LERF_LEVEL
            low, high = float(relevancy.min()), float(relevancy.max())
            yield "LangSplat", relevancy > low + LANGSPLAT_LEVEL * (high - low)
        for level in COSINES:
            yield f"cosine {level:.2f}", cosines > level

    @property
    def missed(self) -> float:
        """Spreads by which the peak misses the clear margin, below 0 if it does not."""
        known, values = self.rules.known, self.plain.values
        margin = float(_margin(np.array(least_clear(known.num_rows, known.clear_margin))))
        return margin - float(_margin(np.array(peak_score(values, known.peak))))

    def clearness(self, pictures: Float32[np.ndarray, "m D"]) -> float:
        """Return by how many spreads the word stands above the best other word for the picture of its things.

        pictures: embeddings of the masks of these; their median is the picture, whatever a few wrong ones show.
        """
        known, picture = self.rules.known, np.median(pictures, axis=0)
        left = picture / np.linalg.norm(picture) - known.usual
        others = known.vectors[~known._not_competing(self.query, None)]
        return float((left @ self.query - (others @ left).max()) / known.spread)


def _marked(rows: np.ndarray, count: int) -> Rows:
    marked = np.zeros(count, bool)
    marked[rows] = True
    return marked
