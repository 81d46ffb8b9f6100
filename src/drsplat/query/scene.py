"""One opened scene, and everything that can be asked of it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..base.arrays import Embedding, Indices, Integer, Numbers, OtherPixels, RowIds, Shaped, Vector3, WholeNumbers
from ..base.terminal import facts_html
from ..errors import InputError
from ..field import LanguageField
from ..field.forest import Objects
from ..formats.tiles import Tiles
from ..scene.boxes import BoxKind
from ..scene.gaussians import Gaussians
from ..scene.moving import Moving, Span
from ..scene.views import View
from .answer import Answer, Match, MatchTrack, Segmentation, Word
from .defaults import COSINE, LABEL, MIN_GAUSSIANS, OBJECT, SURE
from .held import Held
from .measuring import Measuring
from .naming import best_names
from .objects import answer_of, most_seen, objects_of, support_in
from .places import Point, nearest_gaussian
from .query import Cut, Query
from .search import PixelWeights, feature_of, pixel_weights, row_of, seen_among
from .tasks import locate, segment, sure_matches, whole_of
from .wholes import for_comparing

Place = int | Point | tuple[str, float, float]


class Scene(Held):
    """A field, the Gaussians it was registered on, posed photos and who embeds words. Several threads may ask at once.

    gaussians: a moving scene's are its canonical rows; those of `Tiles` stay on disk, and what is asked for is read;
    None where only selections are wanted. views, encoder:
    themselves, or what makes them when they are first needed; encoder None: the built-in one that the field names.
    threads: of one query, 0 for all cores.
    labels: the file of names that people give to objects, None where there is none to keep them in. path: of the file
    with the Gaussians, beside which edits and annotations are kept. georeference: reads where on the Earth it lies.

    Raises: MismatchError: the field is of another scene.
    """

    def object_at(self, place: Place) -> list[int]:
        """Return the nodes at a Gaussian, a point or a click, smallest first: parts, thing, groups.

        Raises: InputError: nothing with a feature there, or nothing that belongs to an object.

        >>> scene.object_at(0)
        [0]
        """
        objects = objects_of(self.field)
        path = objects.path(self._row_at(place, objects))
        if not path:
            raise InputError("what is there belongs to no object")
        return path

    def _repr_html_(self) -> str:
        facts = {
            "Gaussians": f"{len(self.rows):,}" if self.has_gaussians else "none",
            "views": f"{len(self.views):,}",
            "field": f"{len(self.field):,} features by {self.field.encoder.name}",
            "objects": "none" if self.field.objects is None else f"{len(self.field.objects):,}",
        }
        seen = self.has_gaussians and bool(self.views)
        return facts_html(f"Scene '{self.name}'", facts) + (self._picture_html() if seen else "")

    def _picture_html(self) -> str:
        from PIL import Image

        from ..drawing.pictures import picture_html

        return picture_html(Image.fromarray(self.picture(max_side=320)))

    def ask(self, query: Query | str) -> Answer:
        """Return the values of the field for a query, and the threshold. A text stands for `Query(text)`.

        Raises: InputError: words that the encoder does not know, no encoder, no such view, nothing at the
        point. MismatchError: a vector of another dimension.

        >>> answer = scene.ask("red mug")
        >>> answer.certainty
        'sure'
        """
        query = Query(query) if isinstance(query, str) else query
        if not isinstance(query, Query):
            raise InputError(f"expected words or a Query, got {type(query).__name__}")
        if query.during is not None:
            return self.during(query.during).ask(replace(query, during=None))
        return replace(self._answer(query), drawn=self.picture)

    def _labelled(self, query: Query) -> Answer | None:
        """Return exactly what people have given this name; None where they have not, or something is to be measured."""
        nodes = self.labels.called(query.text or "")
        exact = bool(nodes) and query.is_default and not query.exclude
        return answer_of(self.field, nodes, LABEL) if exact else None

    def _answer(self, query: Query) -> Answer:
        measuring = Measuring(self.background, query, query.exclude)
        place = query.click if query.point is None else query.point
        if place is None:
            named = None if query.text is None else self._labelled(query)
            return (self._said(query) or measuring.of(query)) if named is None else named
        if query.is_default and self.field.objects is not None:
            # answer with the object at a place, or, where there is none, with what is like the place
            objects = objects_of(self.field)
            row = self._row_at(place, objects)
            number = int(objects.thing_of()[row])
            if number < 0:
                return measuring.of_vector(self.field.feature(np.array([row]))[0])
            return answer_of(self.field, [objects.thing(number)], OBJECT)
        return measuring.of_vector(self.feature_of(place))

    def _said(self, query: Query) -> Answer | None:
        """Return the answer to a sentence; None for a query that is none."""
        from .sentences import parsed, related_answer

        if query.text is None or not self.has_gaussians or query.text in getattr(self.encoder, "texts", ()):
            return None
        sentence = parsed(query.text)
        if sentence.relation:
            return related_answer(self, query, sentence)
        return None if sentence.text == query.text else self._answer(replace(query, text=sentence.text))

    def sibling(self, field: LanguageField, gaussians: Gaussians | Moving | Tiles | None) -> "Scene":
        """Return a scene of another field or of other Gaussians, with the photos, words and names of this one.

        >>> scene.sibling(scene.field, None).has_gaussians
        False
        """
        return Scene(
            field, gaussians, lambda: self.views, lambda: self.encoder, name=self.name, threads=self.threads,
            labels=self.label_file, georeference=lambda: self.georeference,
        )  # fmt: skip

    def during(self, span: Span) -> "Scene":
        """Return the scene with only the photos of a span of time registered; the last two results are kept.

        Raises: InputError: a field without evidence or of a scene that stands still, or no photo in the span.

        >>> film.during((0, 1)).field.encoder.name
        'drsplat-words'
        """
        from .tracks import of_span

        return of_span(self, (float(span[0]), float(span[1])))

    @property
    def moving(self) -> Moving:
        """Raises: InputError: a scene that stands still, or without Gaussians."""
        if self.motion is None:
            raise InputError(f"'{self.name}' stands still: pass scene=SCENE, the moving scene that was registered")
        return self.motion

    def at(self, time: float | int) -> "Scene":
        """Return the still scene at a time. Raises: InputError: a time outside of the scene's span.

        >>> film.at(1.0).motion is None
        True
        """
        from .tracks import at_time

        return at_time(self, self.moving.inside(time))

    def seen_by(self, view: View) -> "Scene":
        """Return the scene at the time of a photo; the scene itself if it is still or the photo has no time.

        >>> scene.seen_by(scene.views[0]) is scene
        True
        """
        return self if self.motion is None or view.time is None else self.at(view.time)

    def tracks(self, matches: Sequence[Match], box: BoxKind = "upright") -> list[MatchTrack]:
        """Return where matches are over time, and when photos see them. Raises: InputError: a still scene.

        >>> track = film.tracks(film.locate("red mug"))[0]
        >>> track.centers.shape
        (4, 3)
        """
        from .tracks import tracks

        return tracks(self.moving, self.field, matches, self.up if box == "upright" else None)

    def when(
        self, one: Match | Query | str, relation: str, other: Match | Query | str, view: View | str | None = None
    ) -> tuple[Span, ...]:
        """Return the spans of time in which one match, or any of a query, stands in a relation to another.

        relation: on, in, next_to, above, left_of or right_of. view: the camera, or a photo's name, that left_of and
        right_of are meant from.

        Raises: InputError: no match for a query, no such view, a scene that stands still; an unknown relation.

        >>> film.when("red mug", "on", "blue plate")
        ()
        """
        from .tracks import when_of

        return when_of(self, one, relation, other, view)

    def locate(
        self,
        query: Query | Answer | str,
        *,
        min_gaussians: int = MIN_GAUSSIANS,
        top: int | None = None,
        box: BoxKind = "upright",
    ) -> list[Match]:
        """Return the matches of a query or of an answer, best first (`tasks.rank`), with their support; none is [].

        Where it is only maybe what is meant, as the answer's `doubt` says, no match is sure.

        min_gaussians: smaller ones are specks. top: how many of them. box: "upright" stands on the ground, where
        the photos tell which way is up; "free" lies as the thing does.

        Raises: as `ask`; InputError: a scene without Gaussians.

        >>> mug = scene.locate("red mug")[0]
        >>> mug.sure, len(mug.center)
        (True, 3)
        """
        answer = query if isinstance(query, Answer) else self.ask(query)
        up = self.up if box == "upright" else None
        matches = locate(answer, self.rows, min_gaussians=min_gaussians, up=up)
        sure = [answer.certainty == SURE] * len(matches if answer.is_exact else sure_matches(matches, self.rows))
        if not answer.is_exact:
            wholes = whole_of(matches[: len(sure)], sure, self.rows)
            sure = [whole == number for number, whole in enumerate(wholes)]
        sure += [False] * (len(matches) - len(sure))
        return [
            replace(match, support=support_in(match, answer), label=self._label_of(match.object_id), sure=sure[number])
            for number, match in enumerate(matches[:top])
        ]

    def segment(self, classes: Sequence[str], cut: Cut | None = None) -> Segmentation:
        """Give each Gaussian the best of several texts, where that is above its threshold.

        cut: how all of them are measured and cut.

        Raises: as `ask`; InputError: no classes, or one twice.

        >>> scene.segment(["red mug", "blue plate"]).counts
        [150, 150]
        """
        if cut is not None and cut.during is not None:
            return self.during(cut.during).segment(classes, replace(cut, during=None))
        names = tuple(classes)
        if not names or len(set(names)) < len(names):
            raise InputError(f"expected one or more different classes, got {', '.join(names) or 'none'}")
        answers = [one.without_maybe() for one in Measuring(self.background, cut or Cut()).of_texts(names)]
        labels = segment(self.field, map(self._compared, answers))
        return Segmentation(names, labels, answers)

    @staticmethod
    def _compared(answer: Answer) -> Numbers:
        """Return values by which classes are compared where this one is selected, -inf elsewhere."""
        values = for_comparing(answer.field, answer.values, answer.vector if answer.measure == COSINE else None)
        return np.where(answer.values > answer.threshold, values, np.float32(-np.inf))

    def what_is(self, place: Place, names: Sequence[str] | None = None, top: int = 5) -> list[Word]:
        """Return the best words for a place: a Gaussian (its row), a point (world xyz) or a click (view, x, y).

        names: the words to choose from, None for those of an encoder that knows a list.

        Raises: InputError: nothing with a feature there, or no list of words.

        >>> scene.what_is(0, ["red mug", "blue plate"])[0].text
        'red mug'
        """
        feature = self.feature_of(place)
        return [Word(*one) for one in best_names(self.encoder, self.field, feature, names, top)]

    def feature_of(self, place: Place) -> Embedding:
        """Return the unit feature at a Gaussian, a point or a click. Raises: InputError: no feature there.

        >>> scene.feature_of(0).shape
        (512,)
        """
        if isinstance(place, int | np.integer):
            return feature_of(self.field, int(place))
        if isinstance(place[0], str):
            rows, weights = self._weights_at(place)  # type: ignore[arg-type]
            return self.field.feature(rows[[weights.argmax()]])[0]
        return feature_of(self.field, self.nearest(place))  # type: ignore[arg-type]

    def nearest(self, point: Point) -> int:
        """Return the row of the Gaussian nearest to a point of the world among those that have a feature.

        Nearest is meant in its own standard deviations, and all within one are equal but for opacity.

        Raises: InputError: a point that is not finite, or further than 3 standard deviations and a hundredth
        of the scene's size from all of them.

        >>> scene.nearest((-0.7, -0.3, 0.0)) < 150
        True
        """
        return nearest_gaussian(self.rows, self.field.gaussian_ids, point)

    def point_at(self, click: tuple[str, float, float]) -> Vector3:
        """Return the centre of the heaviest Gaussian with a feature at a pixel of a view, in world coordinates.

        Raises: InputError: no such view or pixel, or nothing with a feature there.

        >>> scene.point_at(("photo_0.png", 30.5, 36.5)).shape
        (3,)
        """
        rows, weights = self._weights_at(click)
        ids = self.field.gaussian_ids[rows[[weights.argmax()]]]
        return self.seen_by(self.view(click[0])).rows.shapes_of(ids).positions[0]

    def weights_at(
        self, view: View | str, pixels: Sequence[tuple[float, float]] | Shaped[np.ndarray, "p xy"], k: int = 8
    ) -> PixelWeights:
        """Return the k Gaussians of the largest blending weights at pixels of a photo, and these weights (3DGS Eq. 3).

        pixels: from the left and from the top of the photo without distortion; the first one's centre is (0.5, 0.5).

        Raises: InputError: no such view, a pixel outside of it, k < 1, or a scene without Gaussians.

        >>> rows, weights = scene.weights_at("photo_0.png", [(30.5, 36.5), (60.5, 36.5)])
        >>> rows.shape
        (2, 8)
        """
        view = self.view(view) if isinstance(view, str) else view
        seen = self.seen_by(view).seen(view)
        at = np.asarray(pixels, np.float64).reshape(-1, 2)
        return pixel_weights(seen.splats, seen.rows, view, at, k, threads=self.threads)

    def picture(
        self,
        view: View | str | None = None,
        shown: Answer | WholeNumbers | None = None,
        *,
        photo: bool = False,
        max_side: int | None = None,
    ) -> OtherPixels:
        """Return the RGB of the scene from a view: as it is, or with what was found in colour and the rest grey.

        view: a View, a name, or None for the one that shows most of what is shown. photo: the photo of
        the view, if there is one, instead of a rendering. max_side: pixels of the longer side, at most.

        Raises: InputError: no such view, or none to choose from.

        >>> scene.picture("photo_0.png", scene.ask("red mug")).shape
        (72, 96, 3)
        """
        from ..drawing.pictures import as_pixels, highlighted, photo_or_rendering, visible_share
        from ..drawing.rendering import render

        ids = shown.gaussian_ids if isinstance(shown, Answer) else shown
        chosen = self.best_view(ids) if view is None else view
        chosen = self.view(chosen) if isinstance(chosen, str) else chosen
        if self.seen_by(chosen) is not self:
            return self.seen_by(chosen).picture(chosen, ids, photo=photo, max_side=max_side)
        chosen = chosen.limited(max_side)
        seen = self.seen(chosen)
        seen.warn(chosen)
        if photo:
            pixels = photo_or_rendering(seen.gaussians, chosen, splats=seen.splats, threads=self.threads)
        else:
            drawn = render(seen.gaussians, chosen, threads=self.threads, splats=seen.splats)
            pixels = as_pixels(drawn.rgb)
        if ids is None:
            return pixels
        share = visible_share(seen.gaussians, chosen, seen.local(ids), splats=seen.splats, threads=self.threads)
        return highlighted(pixels, share)

    def best_view(self, gaussian_ids: RowIds | None = None) -> View:
        """Return the view that shows most of some Gaussians; the first one for None.

        Raises: InputError: the scene has no views.

        >>> view = scene.best_view(scene.ask("red mug").gaussian_ids)
        """
        if not self.views:
            raise InputError(
                f"scene '{self.name}' has no views to look from: pass views=CAPTURE, the photos and their poses"
            )
        if gaussian_ids is None:
            return self.views[0]
        return self.best_views([gaussian_ids])[0]

    def best_views(
        self, selections: Sequence[Integer[np.ndarray, " _"]], among: Sequence[View] | None = None
    ) -> list[View]:
        """Return for each selection the view that shows most of it and does not cut it off.

        among: views to choose from. None takes all, or, of a scene in tiles, those whose masks have most of it.

        Raises: InputError: no views, or no Gaussians.

        >>> len(scene.best_views([match.gaussian_ids for match in scene.objects]))
        2
        """
        from ..drawing.pictures import best_views, shown_areas
        from .seen import views_showing

        if self.tiles is None:
            return best_views(self.motion or self.gaussians, among or self.views, selections, threads=self.threads)
        best = []
        for ids in selections:
            views = among or views_showing(self.field, self.rows, self.views, ids)
            seen = ((view, self.seen(view)) for view in views)
            areas = [shown_areas(one.splats, at, [one.local(ids)], threads=self.threads)[0] for at, one in seen]
            best.append(views[int(np.argmax(areas))])
        return best

    def _row_at(self, place: Place, objects: Objects) -> int:
        """Return the row at a place; for a click, the heaviest Gaussian of the object that is seen most there."""
        if isinstance(place, int | np.integer):
            return row_of(self.field, int(place))
        if not isinstance(place[0], str):
            return row_of(self.field, self.nearest(place))  # type: ignore[arg-type]
        return most_seen(objects, *self._weights_at(place))  # type: ignore[arg-type]

    def _weights_at(self, click: tuple[str, float, float]) -> tuple[Indices, Numbers]:
        """Return the rows of the field that a pixel of a photo shows, and their blending weights there."""
        view, xy = self.view(click[0]), (float(click[1]), float(click[2]))
        seen = self.seen_by(view).seen(view)
        return seen_among(self.field, seen.splats, seen.rows, view, xy, threads=self.threads)
