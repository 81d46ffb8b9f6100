"""What can be asked."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8

from ..defaults import AUTO
from ..errors import InputError


@dataclass(frozen=True, eq=False)
class Question:
    """Exactly one of text, vector, image, point and click, and how its scores are measured and cut.

    text: "mug, not red" leaves out what "red mug" fits as well; unwanted: more such words. image: RGB of a
    thing, best cut out on black, as masks are. point: world coordinates; what is there. click: a view's
    name and a pixel of it, as in `feature_at`. threshold: a number, "auto", or None for the default;
    top_share, a share of the registered Gaussians, takes its place. relevancy: measure how much better
    the query fits than `negatives`, texts or vectors (n, D); None takes those of the field, else LERF's.

    Raises: InputError: not one of the five, or parts that exclude each other.
    """

    text: str | None = None
    vector: Float32[np.ndarray, " D"] | None = None
    image: UInt8[np.ndarray, "h w 3"] | None = None
    point: tuple[float, float, float] | None = None
    click: tuple[str, float, float] | None = None
    unwanted: tuple[str, ...] = ()
    threshold: float | str | None = None
    top_share: float | None = None
    relevancy: bool = False
    negatives: tuple[str, ...] | Float32[np.ndarray, "n D"] | None = None

    def __post_init__(self) -> None:
        given = (self.text, self.vector, self.image, self.point, self.click)
        if sum(one is not None for one in given) != 1:
            raise InputError("ask for one of these: text, vector, image, point or click")
        if self.unwanted and self.text is None:
            raise InputError("unwanted words go with a query in words")
        if isinstance(self.threshold, str) and self.threshold != AUTO:
            raise InputError(f"threshold: expected a number or 'auto', got {self.threshold!r}")
        if self.threshold is not None and self.top_share is not None:
            raise InputError("threshold and top_share both say where to cut: drop one")
        if self.threshold == AUTO and self.measures_relevancy:
            raise InputError(
                "the automatic threshold cuts cosines: drop relevancy and negatives, or give a number"
            )

    @property
    def measures_relevancy(self) -> bool:
        return self.relevancy or self.negatives is not None
