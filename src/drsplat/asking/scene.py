"""One opened scene, and everything that can be asked of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, Integer

from ..boxes import BoxKind
from ..defaults import MIN_GAUSSIANS
from ..encoders import Encoder
from ..errors import InputError
from ..evidence import Explanation
from ..field import LanguageField
from ..gaussians import Gaussians
from ..kernels import SplatArrays, splat_arrays
from ..pictures import (
    OtherPixels,
    as_pixels,
    best_views,
    highlighted,
    photo_or_rendering,
    visible_share,
)
from ..rendering import render
from ..search import feature_at, gaussian_at
from ..support import supporting_masks
from ..tasks import Instance, locate, segment
from ..terminal import counted
from ..views import View
from .answering import Asked, Asking, Background
from .naming import best_names
from .places import nearest_gaussian
from .questions import Question
from .views import view_named

SUPPORT = 3  # masks listed for a thing
Place = int | tuple[float, float, float] | tuple[str, float, float]


class Found(NamedTuple):
    """A thing and the photos and masks that speak most for it; none where the field kept no evidence."""

    thing: Instance
    support: list[Explanation]


class Named(NamedTuple):
    """A text and the cosine of a place's feature with it."""

    text: str
    score: float


class Classes(NamedTuple):
    """labels: per Gaussian of the scene the number of its class, -1 for none. answers: one of each class."""

    names: tuple[str, ...]
    labels: Int32[np.ndarray, " n"]
    answers: list[Asked]


@dataclass(frozen=True, eq=False)
class AskableScene:
    """A scene, its field and its posed photos. Nothing in it changes; several threads may ask at once.

    encoder: makes the encoder when words are first asked for, and raises where there is none. threads: of
    one question, 0 for all cores.

    Raises: MismatchError: the field is of another scene.
    """

    name: str
    gaussians: Gaussians
    field: LanguageField
    views: tuple[View, ...]
    source: Callable[[], Encoder]
    threads: int = 0

    def __repr__(self) -> str:
        return f"AskableScene('{self.name}', {self.gaussians}, {self.field}, {counted(len(self.views), 'view')})"

    def __post_init__(self) -> None:
        self.field.check_scene(self.gaussians)

    @property
    def encoder(self) -> Encoder:
        """Raises: InputError: none is known for this field; the message says what to give."""
        return self.background.encoder

    @cached_property
    def background(self) -> Background:
        return Background(self.field, self.source, self.threads)

    @cached_property
    def splats(self) -> SplatArrays:
        """The Gaussians as the renderer takes them, made once."""
        return splat_arrays(self.gaussians)

    @cached_property
    def box(self) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]:
        """Lowest and highest corner of the box of the middle 98 % of the Gaussians, along the world's axes."""
        low, high = np.quantile(self.gaussians.positions, (0.01, 0.99), axis=0)
        return low, high

    def view(self, name: str) -> View:
        """Raises: InputError: there is none of that name."""
        return view_named(self.views, name)

    def ask(self, question: Question) -> Asked:
        """Scores of the field for a question, and the threshold.

        Raises: InputError: words that the encoder does not know, no encoder, no such view, nothing at the
        point. MismatchError: a vector of another dimension.
        """
        asking = Asking(self.background, question)
        if question.text is not None:
            return asking.about(question.text)
        if question.image is not None:
            return asking.like_image(question.image)
        if question.vector is not None:
            return asking.like(question.vector)
        place = question.click if question.point is None else question.point
        assert place is not None
        return asking.like(self.feature_of(place))

    def find(
        self,
        question: Question | Asked,
        min_gaussians: int = MIN_GAUSSIANS,
        top: int | None = None,
        box: BoxKind = "upright",
    ) -> list[Found]:
        """The things that a question means, best first, with their evidence; nothing found is [].

        top: how many of them. box: as for `locate`. Raises: as `ask`.
        """
        asked = question if isinstance(question, Asked) else self.ask(question)
        things = locate(
            self.field, self.gaussians, asked.values, asked.threshold, min_gaussians=min_gaussians,
            box=box,
        )  # fmt: skip
        return [Found(thing, self._support(thing, asked)) for thing in things[:top]]

    def classes(self, texts: Sequence[str], question: Question | None = None) -> Classes:
        """The best of several texts for each Gaussian, where it is above its threshold.

        question: how all of them are measured and cut; its own text is not asked.

        Raises: as `ask`; InputError: no texts, or one twice.
        """
        names = tuple(texts)
        if not names or len(set(names)) < len(names):
            raise InputError(
                f"expected one or more different classes, got {', '.join(names) or 'none'}"
            )
        asking = Asking(self.background, question or Question(text=names[0]))
        answers = list(asking.about_each(names))
        thresholds = [answer.threshold for answer in answers]
        labels = segment(self.field, (answer.values for answer in answers), thresholds)
        return Classes(names, labels, answers)

    def what_is(
        self, place: Place, vocabulary: Sequence[str] | None = None, top: int = 5
    ) -> list[Named]:
        """The best words for what is at a Gaussian (its row), a point (world xyz) or a click (view, x, y).

        vocabulary: the words to choose from, None for those of an encoder that knows a list.

        Raises: InputError: nothing with a feature there, or no list of words.
        """
        feature = self.feature_of(place)
        return [
            Named(*one) for one in best_names(self.encoder, self.field, feature, vocabulary, top)
        ]

    def feature_of(self, place: Place) -> Float32[np.ndarray, " D"]:
        """The unit feature at a Gaussian, a point or a click.

        Raises: InputError: nothing with a feature there.
        """
        if isinstance(place, int | np.integer):
            return self._feature(int(place))
        if isinstance(place[0], str):
            view = self.view(place[0])
            xy = (float(place[1]), float(place[2]))
            return feature_at(self.field, self.gaussians, view, xy, threads=self.threads)
        return self._feature(self.nearest(place))  # type: ignore[arg-type]

    def nearest(self, point: tuple[float, float, float]) -> int:
        """Row of the Gaussian nearest to a point of the world among those that have a feature.

        Nearest is meant in its own standard deviations, and all within one are equal but for opacity.

        Raises: InputError: a point that is not finite, or further than 3 standard deviations and a hundredth
        of the scene's size from all of them.
        """
        return nearest_gaussian(self.gaussians, self.field.gaussian_ids, point)

    def point_at(self, click: tuple[str, float, float]) -> Float64[np.ndarray, " 3"]:
        """Centre of the heaviest Gaussian with a feature at a pixel of a view, in world coordinates.

        Raises: InputError: no such view or pixel, or nothing with a feature there.
        """
        view, xy = self.view(click[0]), (float(click[1]), float(click[2]))
        found = gaussian_at(self.field, self.gaussians, view, xy, threads=self.threads)
        return np.asarray(self.gaussians.positions[found])

    def picture(
        self,
        view: View | str | None = None,
        shown: Asked | Integer[np.ndarray, " m"] | None = None,
        *,
        photo: bool = False,
        max_side: int | None = None,
    ) -> OtherPixels:
        """RGB of the scene from a view: as it is, or with what was found in colour and the rest grey.

        view: a View, a name, or None for the one that shows most of what is shown. photo: the photo of
        the view, if there is one, instead of a rendering. max_side: pixels of the longer side, at most.

        Raises: InputError: no such view, or none to choose from.
        """
        ids = shown.gaussian_ids if isinstance(shown, Asked) else shown
        chosen = self.best_view(ids) if view is None else view
        chosen = self.view(chosen) if isinstance(chosen, str) else chosen
        chosen = _limited(chosen, max_side)
        if photo:
            pixels = photo_or_rendering(self.gaussians, chosen, threads=self.threads)
        else:
            drawn = render(self.gaussians, chosen, threads=self.threads, splats=self.splats)
            pixels = as_pixels(drawn.rgb)
        if ids is None:
            return pixels
        share = visible_share(self.gaussians, chosen, ids, splats=self.splats, threads=self.threads)
        return highlighted(pixels, share)

    def best_view(self, gaussian_ids: Integer[np.ndarray, " m"] | None = None) -> View:
        """The view that shows most of some Gaussians; the first one for None.

        Raises: InputError: the scene has no views.
        """
        if not self.views:
            raise InputError(f"scene '{self.name}' has no views to look from")
        if gaussian_ids is None:
            return self.views[0]
        return best_views(self.gaussians, self.views, [gaussian_ids], threads=self.threads)[0]

    def _feature(self, gaussian_id: int) -> Float32[np.ndarray, " D"]:
        row = self.field.rows_of(np.array([gaussian_id]))
        if row[0] < 0:
            raise InputError(
                f"Gaussian {gaussian_id} has no feature: no mask of any photo covers it"
            )
        feature: np.ndarray = self.field.feature(row)[0]
        return feature

    def _support(self, thing: Instance, asked: Asked) -> list[Explanation]:
        if self.field.evidence is None:
            return []
        return supporting_masks(self.field, thing.gaussian_ids, asked.query, top=SUPPORT)


def _limited(view: View, max_side: int | None) -> View:
    longest = max(view.width, view.height)
    if max_side is None or longest <= max_side:
        return view
    scale = max_side / longest
    size = (max(1, round(side * scale)) for side in (view.width, view.height))
    return view.resized(*size)
