"""Localisation and segmentation: functions of arrays that turn values per Gaussian into matches and classes."""

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np

from ..base.arrays import Indices, Numbers, OtherIds, Vector3
from ..errors import InputError
from ..field import LanguageField
from ..kernels.boxes import box_of
from ..scene.boxes import HAZE_OPACITY, solid
from ..scene.gaussians import Gaussians
from ..scene.parted import AnyGaussians
from .answer import Answer, Match
from .defaults import MIN_GAUSSIANS

NO_CLASS = -1
MASS_POWER = 0.1  # ten times the mass weighs as much as a score that is 1.26 times as high
SURE_RANK_SHARE = 0.85  # of the best match's rank: from it on another is meant as well
PART_SCORE_SHARE = 0.9  # of the score of a sure match, for what touches it and is a part of it


def locate(
    answer: Answer,
    gaussians: AnyGaussians,
    *,
    link_distance: float | None = None,
    min_gaussians: int = MIN_GAUSSIANS,
    up: Vector3 | None = None,
) -> list[Match]:
    """Return the places that an answer's Gaussians make, the highest `rank` first; nothing found is [].

    What is selected of an object of the field is one place. Loose Gaussians nearer than `link_distance` (scene units)
    belong together; None takes three times the median distance to the 8th neighbour among them. Where half of those
    are as near to an object that is selected as well they are its border, and part of its place. Places with
    fewer than `min_gaussians` Gaussians that can be seen (opacity of 0.1 or more) are left out: specks, and haze in
    the air. up: a unit direction that boxes stand upright along; None: free, as the thing lies.

    Raises: MismatchError: the answer is of another scene.
    Source: Dr. Splat Sec. B "Open-vocabulary 3D object localization".
    """
    answer.field.check_scene(gaussians)
    ids = answer.gaussian_ids
    if len(ids) < max(min_gaussians, 2):
        return []
    selected, values = gaussians.shapes_of(ids), answer.values[answer.values > answer.threshold]
    places = _places(answer, selected, link_distance)
    order = np.argsort(places, kind="stable")
    members = np.split(order, np.flatnonzero(np.diff(places[order])) + 1)
    visible = selected.opacities >= HAZE_OPACITY
    found = [
        _match(selected.shapes_of(group), values[group], ids[group], up, int(place))
        for place, group in zip(np.unique(places), members, strict=True)
        if np.count_nonzero(visible[group]) >= min_gaussians
    ]
    return sorted(found, key=lambda match: (-rank(match, gaussians), int(match.gaussian_ids[0])))


def rank(match: Match, gaussians: AnyGaussians) -> float:
    """Return how good a match is: its score times the tenth root of its mass, the sum of its Gaussians' opacities.

    So a splinter that fits a little better does not come before the thing that it is of, and a large thing that fits
    clearly worse does not come before a small one. A score that is not above 0 stands for itself.
    """
    mass = float(gaussians.opacities_of(match.gaussian_ids).sum(dtype=np.float64))
    return match.score * mass**MASS_POWER if match.score > 0 else match.score


def sure_matches(matches: Sequence[Match], gaussians: AnyGaussians) -> list[Match]:
    """Return the matches whose rank is near that of the best, in their order: those that a query certainly means."""
    ranks = [rank(match, gaussians) for match in matches]
    best = max(ranks, default=0.0)
    return [match for match, own in zip(matches, ranks, strict=True) if own >= min(SURE_RANK_SHARE * best, best)]


def whole_of(matches: Sequence[Match], meant: Sequence[bool], gaussians: AnyGaussians) -> list[int]:
    """Return of each match the number of the one that is meant of which it is a part, its own where it is itself.

    A part touches that match, or another part of it, has a lower rank, and fits at least nine tenths as well: masks cut
    a lamp in foot and shade. -1: of none. meant: of each match whether a query certainly means it.
    """
    from .linking import seen_of, touch

    reaches = [float(np.linalg.norm(match.extent)) for match in matches]  # twice as far as their boxes
    seen = cache(lambda number: seen_of(matches[number], gaussians))
    wholes: list[int] = []
    for number, match in enumerate(matches):
        touched = {
            of for other, of in enumerate(wholes)
            if of >= 0 and match.score >= PART_SCORE_SHARE * matches[of].score
            and np.linalg.norm(match.center - matches[other].center) <= reaches[number] + reaches[other]
            and touch(seen(number), seen(other))
        }  # fmt: skip
        whole = min(touched, default=number if meant[number] else -1)
        wholes = [whole if of in touched else of for of in wholes] + [whole]
    return wholes


def meant_of(matches: Sequence[Match], gaussians: AnyGaussians) -> list[Match]:
    """Return the sure matches of a query with their parts, of which none is sure itself."""
    wholes = whole_of(matches, [match.sure for match in matches], gaussians)
    return [match for match, whole in zip(matches, wholes, strict=True) if whole >= 0]


def _places(answer: Answer, selected: Gaussians, link_distance: float | None) -> Indices:
    """Return the object's number of each selected Gaussian; loose ones that hang together share one below 0."""
    objects = answer.field.objects
    places = np.full(len(selected), -1, np.int64)
    if objects is not None:
        places[:] = objects.thing_of(np.flatnonzero(answer.values > answer.threshold))
    points = selected.means.astype(np.float64)
    (loose,), (held,) = np.nonzero(places < 0), np.nonzero(places >= 0)
    if len(loose):
        from .linking import components, join_to_held

        if len(loose) > 1:
            places[loose] = -1 - components(points[loose], link_distance)
        if len(held) > 1:
            join_to_held(places, points, loose, held, link_distance)
    return places


def segment(
    field: LanguageField, class_scores: Iterable[Numbers], thresholds: float | Sequence[float] = -np.inf
) -> OtherIds:
    """Return the class of the highest score for each Gaussian of the scene, NO_CLASS where there is none.

    class_scores: per class one score per row of the field, taken one class at a time. thresholds: one for
    all classes or one for each; only classes above theirs compete, and the first of equals wins.
    By default every Gaussian with a feature gets a class, as in the paper.

    Raises: InputError: not one score per row, or not one threshold per class.
    Source: Dr. Splat Sec. B "Open-vocabulary 3D semantic segmentation".
    """
    best = np.full(len(field), -np.inf, np.float32)
    labels, count = np.full(len(field), NO_CLASS, np.int32), 0
    for scores in class_scores:
        # check that there is one score per row of the field. Raises: InputError: there is not.
        if scores.shape != (len(field.gaussian_ids),):
            raise InputError(
                f"expected {len(field.gaussian_ids)} scores, one per row of the field; got shape {scores.shape}"
            )
        better = (scores > best) & (scores > _threshold(thresholds, count))
        labels[better], best[better] = count, scores[better]
        count += 1
    if not isinstance(thresholds, int | float) and len(thresholds) != count:
        raise InputError(f"{len(thresholds)} thresholds for {count} classes: give one of each")
    of_scene = np.full(field.num_gaussians, NO_CLASS, np.int32)
    of_scene[field.gaussian_ids] = labels
    return of_scene


def _threshold(thresholds: float | Sequence[float], label: int) -> float:
    if isinstance(thresholds, int | float):
        return thresholds
    return thresholds[label] if label < len(thresholds) else np.inf


def _match(gaussians: Gaussians, scores: Numbers, ids: Indices, up: Vector3 | None, place: int) -> Match:
    """Return the match that some Gaussians make. ids: their rows in the scene."""
    mass = gaussians.opacities.astype(np.float64)
    mass = mass / mass.sum() if mass.sum() > 0 else np.full(len(ids), 1 / len(ids))
    score = float((mass * scores).sum())  # a BLAS sums in as many parts as it has threads
    box = box_of(gaussians, solid(gaussians, np.arange(len(ids))), up)
    return Match(*box, score, ids, object_id=place if place >= 0 else None)
