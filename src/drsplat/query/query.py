"""The query: what is asked, how it is measured and where it is cut, under the same names in every front."""

from dataclasses import dataclass

import numpy as np

from ..base.arrays import Embedding, Embeddings, Pixels
from ..errors import InputError
from .defaults import AUTO, NEVER
from .schema import SUBJECTS


@dataclass(frozen=True, eq=False, kw_only=True)
class Cut:
    """How scores are measured, and above which threshold they select.

    threshold: a number, "auto", or None for the default; top_share, a share of the registered Gaussians,
    takes its place. relevancy: measure how much better the query fits than `negatives`, texts or vectors
    (n, D); None takes those of the field, else LERF's. during: start and end of a span of time, of a scene that moves:
    only what photos of that time have shown is asked; None: all of it. objects: "auto" lets objects answer as wholes
    where the field has them; with "never" every Gaussian answers for itself, as in a field without objects. present:
    what is asked for is known to be there, so that something is found even where other words fit better.

    Raises: InputError: parts that exclude each other, a span that ends before it starts, an unknown word.
    """

    threshold: float | str | None = None
    top_share: float | None = None
    relevancy: bool = False
    negatives: tuple[str, ...] | Embeddings | None = None
    during: tuple[float | int, float | int] | None = None
    objects: str = AUTO
    present: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.threshold, str) and self.threshold != AUTO:
            raise InputError(f"threshold: expected a number or 'auto', got {self.threshold!r}")
        if self.threshold is not None and self.top_share is not None:
            raise InputError("threshold=NUMBER and top_share=SHARE both set the cut: drop one")
        if self.threshold == AUTO and self.measures_relevancy:
            raise InputError(
                "threshold: 'auto' is for cosines: give a number, or drop relevancy=True and negatives=WORDS"
            )
        if self.during is not None and not -np.inf < self.during[0] <= self.during[1] < np.inf:
            raise InputError(f"during: expected two finite times, the first no later than the second: {self.during}")
        if self.objects not in (AUTO, NEVER):
            raise InputError(f"objects: expected 'auto' or 'never', got {self.objects!r}")

    @property
    def is_default(self) -> bool:
        """True without options of measuring and cutting, so that an object or a label may be the answer."""
        is_uncut = self.threshold is None and self.top_share is None
        return is_uncut and not self.measures_relevancy and self.asks_objects

    @property
    def asks_objects(self) -> bool:
        """True where objects answer as wholes, if the field has them."""
        return self.objects == AUTO

    @property
    def measures_relevancy(self) -> bool:
        return self.relevancy or self.negatives is not None


@dataclass(frozen=True, eq=False)
class Query(Cut):
    """Exactly one of text, vector, image, point and click.

    text: "mug, not red" leaves out what "red mug" fits as well; exclude: more such words. vector: (D,), of the
    encoder's space. image: RGB of a thing, best cut out on black, as masks are. point: world coordinates; what is
    there. click: a view's name and a pixel of it, the centre of the first one at (0.5, 0.5). Both find the object that
    is there; with a cut of their own, without objects, or where the field has none, all that is like it.

    Raises: InputError: not one of the five, or parts that exclude each other.
    """

    text: str | None = None
    vector: Embedding | None = None
    image: Pixels | None = None
    point: tuple[float, float, float] | None = None
    click: tuple[str, float, float] | None = None
    exclude: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        spelled = {field.name: f"{field.name}={field.value}" for field in SUBJECTS}
        given = [spelled[name] for name in spelled if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(
                f"expected exactly one of {', '.join(spelled.values())}; got {' and '.join(given) or 'none'}"
            )
        if self.exclude and self.text is None:
            raise InputError("exclude=WORDS goes with a query in words")
