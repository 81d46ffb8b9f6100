"""The answer to a query: values with a threshold, and the matches that they make."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..base.arrays import (
    Doubles,
    Embedding,
    Ids,
    Indices,
    Matrices,
    Matrix3,
    Numbers,
    PilImage,
    Points,
    Vector3,
    WholeNumbers,
)
from ..base.terminal import counted, facts_html
from ..errors import InputError
from ..field import LanguageField
from ..field.evidence.evidence import Explanation
from ..scene.moving import Span
from ..scene.views import View
from .defaults import COSINE, GIVEN, LABEL, MAYBE, NOTHING, OBJECT, RELEVANCY, SURE
from .search import UNSELECTED_COSINE


@dataclass(frozen=True, eq=False)
class Answer:
    """The values of a query for each row of a field, and the threshold that selects among them.

    vector: the query's unit vector, None where values came without one. values: what is compared with the threshold,
    one per row of the field. scores: cosines.

    measure: "cosine" or "relevancy". rule: who chose the threshold: given, top share, auto, list,
    encoder or default; object or label, where exactly what belongs together is meant. drawn: who draws it, the
    `picture` of its scene; None: nobody. doubt: reason not to rely on it, "" if there is none. sure: False where other
    words fit what is selected as well; `doubt` says which. seen_from: the photo that left and right are meant from.
    list_doubt: why the vocabulary that a text is told from says little, "" if it does not; it makes no maybe.
    """

    field: LanguageField
    vector: Embedding | None
    values: Numbers
    measure: str
    threshold: float
    rule: str
    scores: Numbers
    drawn: Callable[..., np.ndarray] | None = None
    doubt: str = ""
    sure: bool = True
    seen_from: str = ""
    list_doubt: str = ""

    @classmethod
    def of(cls, field: LanguageField, values: Numbers, threshold: float) -> "Answer":
        """Return an answer of values computed elsewhere. Raises: InputError: not one per row of the field.

        >>> ds.Answer.of(scene.field, np.ones(len(scene.field), np.float32), 0.5).certainty
        'sure'
        """
        if values.shape != (len(field),):
            raise InputError(f"expected {len(field)} values, one per row of the field; got shape {values.shape}")
        return cls(field, None, values, COSINE, threshold, GIVEN, values)

    @classmethod
    def of_rows(cls, field: LanguageField, rows: WholeNumbers, rule: str) -> "Answer":
        """Return exactly some rows of the field: 1 there, 0 elsewhere.

        >>> ds.Answer.of_rows(scene.field, np.arange(3), "object").gaussian_ids.shape
        (3,)
        """
        values = np.zeros(len(field), np.float32)
        values[rows] = 1
        return cls(field, None, values, COSINE, 0.5, rule, values)

    def __repr__(self) -> str:
        selected = f"{int((self.values > self.threshold).sum()):,} of {counted(len(self.field), 'Gaussian')}"
        return f"Answer({selected}, {self.measure} above {self.threshold:.4g}, rule '{self.rule}')"

    def _repr_html_(self) -> str:
        facts = {
            "selected": f"{len(self.gaussian_ids):,} of {counted(len(self.field), 'Gaussian')}",
            "above": f"{self.measure} {self.threshold:.4g}, by the rule '{self.rule}'",
            "values": f"{self.values.min():.3f} to {self.values.max():.3f}" if len(self.values) else "none",
        }
        return facts_html("Answer", facts) + self._picture_html()

    def show(self, view: View | str | None = None, max_side: int = 640) -> PilImage:
        """Draw what is selected, the rest in grey; a notebook shows the picture, `.show()` opens it elsewhere.

        view: as of `Scene.picture`. Raises: InputError: the answer is of no scene with Gaussians and views.

        >>> scene.ask("red mug").show("photo_0.png").size
        (96, 72)
        """
        if self.drawn is None:
            raise InputError("this answer is of a field alone: ask a scene that has Gaussians and views")
        from PIL import Image

        return Image.fromarray(self.drawn(view, self, max_side=max_side))

    def _picture_html(self) -> str:
        """Return the picture as HTML; "" where there is nothing to look at, or from."""
        from ..drawing.pictures import picture_html

        try:
            return picture_html(self.show(max_side=320)) if len(self.gaussian_ids) else ""
        except InputError:
            return ""

    @property
    def lowest(self) -> float:
        """The value of a Gaussian that no threshold selects."""
        return 0.0 if self.measure == RELEVANCY else UNSELECTED_COSINE

    @property
    def is_exact(self) -> bool:
        """True where an object or a label is meant as a whole, so that no other threshold makes sense."""
        return self.rule in (OBJECT, LABEL)

    @property
    def dense(self) -> Numbers:
        """Values per Gaussian of the scene; the lowest where there is no feature."""
        return self.field.dense(self.values, fill=self.lowest)

    @property
    def gaussian_ids(self) -> Indices:
        """Rows in the scene of the Gaussians above the threshold, ascending.

        Source: Dr. Splat Sec. B "3D object selection".
        """
        return self.field.gaussian_ids[self.values > self.threshold].astype(np.int64)

    @property
    def certainty(self) -> str:
        """Certainty that the right rows were found: "sure", "maybe" where there is a doubt, or "nothing"."""
        if not (self.values > self.threshold).any():
            return NOTHING
        return SURE if self.sure and not self.doubt else MAYBE

    def cut_at(self, threshold: float) -> "Answer":
        """Return the same values with another threshold.

        >>> len(scene.ask("red mug").cut_at(2.0).gaussian_ids)
        0
        """
        return replace(self, threshold=threshold, rule=GIVEN)

    def without_maybe(self) -> "Answer":
        """Return the answer, or one that selects nothing where other words fit as well.

        >>> scene.ask("red mug").without_maybe().certainty
        'sure'
        """
        if self.sure or not len(self.values):
            return self
        return replace(self, threshold=float(self.values.max()))


@dataclass(frozen=True, eq=False)
class Match:
    """A place that a query found, in scene units and world coordinates.

    center, axes, extent: oriented box; row a of `axes` is the unit direction of full length extent[a].
    Upright: the third axis is up, the first the longer of the others. Free: longest first. score: mean value of its
    Gaussians weighted by opacity, which with its mass makes its place among others (`tasks.rank`). support: the masks
    that contribute most, none where the field kept no evidence.
    object_id: the number of the object that it is, None where it is none. label: the name that people gave it. sure:
    whether the query surely means it; those that do are counted.
    """

    center: Vector3
    axes: Matrix3
    extent: Vector3
    score: float
    gaussian_ids: Indices
    support: tuple[Explanation, ...] = ()
    object_id: int | None = None
    label: str | None = None
    sure: bool = True

    def __repr__(self) -> str:
        place = ", ".join(f"{x:.4g}" for x in self.center)
        return f"Match({counted(len(self), 'Gaussian')} at ({place}), score {self.score:.3f})"

    def __len__(self) -> int:
        return len(self.gaussian_ids)


class Word(NamedTuple):
    """A text and the cosine of a place's feature with it."""

    text: str
    score: float


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Classes of a scene's Gaussians.

    labels: per Gaussian of the scene the number of its class, -1 for none. answers: one of each class.
    """

    names: tuple[str, ...]
    labels: Ids
    answers: list[Answer]

    @property
    def doubt(self) -> str:
        """Reason not to rely on some of the classes, "" if there is none."""
        return next((answer.doubt for answer in self.answers if answer.doubt), "")

    @property
    def list_doubt(self) -> str:
        """That of its answers, which are told from one list."""
        return self.answers[0].list_doubt

    @property
    def counts(self) -> list[int]:
        """Gaussians of each class."""
        kept = self.labels[self.labels >= 0]
        return np.bincount(kept, minlength=len(self.names)).tolist()


@dataclass(frozen=True, eq=False)
class MatchTrack:
    """A match over time, in world coordinates and scene units.

    times: those of the scene at which it is there, ascending. centers, axes, extents: its box at each, as of `Match`.
    spans: of the photos' times, first to last of those that follow each other in which a photo sees it. views: names of
    these photos. Both are empty where the field kept no evidence.
    """

    match: Match
    times: Doubles
    centers: Points
    axes: Matrices
    extents: Points
    spans: tuple[Span, ...] = ()
    views: tuple[str, ...] = ()

    def __repr__(self) -> str:
        when = "never" if not len(self.times) else f"{self.times[0]:g} to {self.times[-1]:g}"
        return f"MatchTrack({self.match!r}, {when})"

    def __len__(self) -> int:
        return len(self.times)

    def at(self, time: float) -> Match | None:
        """Return the match with its box at one of the scene's times, None where it is not there then."""
        (found,) = np.nonzero(self.times == time)
        if not len(found):
            return None
        number = int(found[0])
        box = (self.centers[number], self.axes[number], self.extents[number])
        return replace(self.match, center=box[0], axes=box[1], extent=box[2])
