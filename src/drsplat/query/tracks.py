"""Matches over time in a moving scene: where they are, when photos see them, when they stand in a relation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from typing import TYPE_CHECKING, cast

import numpy as np

from ..base.arrays import Doubles, Flags
from ..errors import InputError
from ..field import LanguageField
from ..field.objects.describing import objects_during
from ..field.regrowing import field_during
from ..formats.tiles import Tiles
from ..kernels.boxes import box_of
from ..scene.boxes import HAZE_OPACITY, solid
from ..scene.moving import Moving, Span, canonical_of
from ..scene.views import View
from .answer import Match, MatchTrack
from .query import Query
from .relations import RELATIONS, SIDES, Relation, Up, is_beside, related
from .tasks import meant_of

if TYPE_CHECKING:
    from .scene import Scene

MIN_PRESENT_SHARE = 0.1  # of the Gaussians that a match has where it has most
MAX_MATCHES_RELATED = 8  # of a query
MAX_CACHED_SCENES = 2  # of a time, and of a span
MIN_SHOWN_SHARE = 0.01  # of what the best photo shows of a match


def tracks(moving: Moving, field: LanguageField, matches: Sequence[Match], up: Up | None = None) -> list[MatchTrack]:
    """Return the box of each match at all times of the scene, taken one time after another.

    up: boxes stand upright along it; None: as things lie.
    """
    times = moving.times.tolist()
    counts = np.zeros((len(matches), len(times)), np.int64)
    boxes: list[list[tuple[np.ndarray, ...]]] = [[] for _ in matches]
    for column, time in enumerate(times):
        gaussians = moving.at(time)
        for row, match in enumerate(matches):
            ids = match.gaussian_ids
            counts[row, column] = np.count_nonzero(gaussians.opacities[ids] >= HAZE_OPACITY)
            boxes[row].append(tuple(box_of(gaussians, solid(gaussians, ids), up)))
    there = counts >= MIN_PRESENT_SHARE * counts.max(1, keepdims=True, initial=1)
    there |= (counts.max(1, initial=0) == 0)[:, None]  # haze at all times: it is what there is
    found = []
    for match, of_match, own in zip(matches, boxes, there, strict=True):
        center, axes, extent = (np.array([box[part] for box in of_match])[own] for part in range(3))
        found.append(MatchTrack(match, moving.times[own], center, axes, extent, *seen_during(field, match)))
    return found


def seen_during(field: LanguageField, match: Match) -> tuple[tuple[Span, ...], tuple[str, ...]]:
    """Return the spans of time in which photos see a match, and these photos, by the weights of its Gaussians.

    Both are empty where the field has no evidence or no times.
    """
    if field.evidence is None or field.times is None:
        return (), ()
    masks, rows = field.evidence.masks, field.rows_of(match.gaussian_ids)
    weights = field.evidence.weights[rows[rows >= 0]]
    shown = np.bincount(masks.views[weights.indices], weights.data, minlength=len(masks.view_names))
    sees = shown > MIN_SHOWN_SHARE * shown.max(initial=0)
    stamps = np.unique(field.times)
    seen = np.isin(stamps, field.times[sees])
    return runs(stamps, seen), tuple(np.array(masks.view_names, object)[sees].tolist())


def runs(times: Doubles, holds: Flags) -> tuple[Span, ...]:
    """Return the first and last of times that follow each other where something holds."""
    steps = np.diff(np.concatenate([[0], holds.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1) - 1
    return tuple((float(times[start]), float(times[end])) for start, end in zip(starts, ends, strict=True))


def when_of(
    scene: Scene, one: Match | Query | str, relation: str, other: Match | Query | str, view: View | str | None
) -> tuple[Span, ...]:
    """Do what `Scene.when` says: any of the first matches stands so to any of the others, both there.

    Source: docs/moving.md.
    """
    known = (*RELATIONS, *SIDES)
    if relation not in known:
        raise InputError(f"relation: expected one of {', '.join(known)}; got '{relation[:60]}'")
    if relation == "between":
        raise InputError("when: 'between' has three ends; ask for on, in, next_to, above, left_of or right_of")
    seen_from = scene.view(view) if isinstance(view, str) else view
    if relation in SIDES and seen_from is None:
        raise InputError(f"'{relation}' is meant as seen from a camera: give view=NAME, a photo's or a View")
    ones, others = _meant(scene, one), _meant(scene, other)
    tracked = scene.tracks([*ones, *others])
    pairs = list(product(tracked[: len(ones)], tracked[len(ones) :]))
    times = scene.moving.times
    holds = [any(_holds(scene, relation, time, pair, seen_from) for pair in pairs) for time in times.tolist()]
    return runs(times, np.array(holds, np.bool_))


def _holds(
    scene: Scene, relation: str, time: float, pair: tuple[MatchTrack, MatchTrack], view: View | None
) -> bool:  # fmt: skip
    first, second = (track.at(time) for track in pair)
    if first is None or second is None:
        return False
    if view is not None and relation in SIDES:
        return is_beside(view, relation, first, second)
    return bool(related(scene.moving.at(time), cast("Relation", relation), [first], second, up=scene.up))


def at_time(scene: Scene, time: float) -> Scene:
    """Do what `Scene.at` says."""
    return _cached(scene, ("at", time), lambda: _still(scene, time))


def of_span(scene: Scene, span: Span) -> Scene:
    """Do what `Scene.during` says."""
    return _cached(scene, ("during", span), lambda: _spanned(scene, span))


def _cached(scene: Scene, key: tuple[str, object], make: Callable[[], Scene]) -> Scene:
    """Return a scene from the cache of the last ones, or make it, outside of any lock and at worst twice."""
    made = scene.kept.pop(key, None) or make()
    for old in [other for other in list(scene.kept) if other[0] == key[0]][: 1 - MAX_CACHED_SCENES]:
        scene.kept.pop(old, None)
    scene.kept[key] = made
    return made


def _still(scene: Scene, time: float) -> Scene:
    still = scene.sibling(scene.field, scene.moving.at(time))
    still.background = scene.background  # what queries are compared with is made once
    return still


def _spanned(scene: Scene, span: Span) -> Scene:
    gaussians = scene.motion or scene.tiles or (scene.gaussians if scene.has_gaussians else None)
    in_memory = None if gaussians is None or isinstance(gaussians, Tiles) else canonical_of(gaussians)
    field = field_during(scene.field, span, in_memory, threads=scene.threads)
    if scene.field.objects is not None:
        field = field.with_objects(objects_during(scene.field, field, threads=scene.threads))
    return scene.sibling(field, gaussians)


def _meant(scene: Scene, what: Match | Query | str) -> list[Match]:
    """Return a match itself, or the sure ones of a query. Raises: InputError: it has none."""
    found = [what] if isinstance(what, Match) else meant_of(scene.locate(what), scene.rows)
    matches = found[:MAX_MATCHES_RELATED]
    if not matches:
        asked = what.text if isinstance(what, Query) else what
        raise InputError(f"no match for '{str(asked)[:60]}': ask for other words, or lower the threshold")
    return matches


def spans_text(spans: Iterable[Sequence[float | int]]) -> str:
    """Return spans as people read them: "0 to 0.5, 1"."""
    return ", ".join(f"{start:.4g}" if start == end else f"{start:.4g} to {end:.4g}" for start, end in spans)
