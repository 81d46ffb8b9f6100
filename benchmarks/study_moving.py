"""Things that move, against the same things standing still, and against a registration that knows of no time.

    python benchmarks/study_moving.py [SEED...]

For each film of `world.moving` and each thing, found by its words: "moving": registered with each photo at its time;
"still": the same things and cameras, all of them where they are in the middle of the film; "static": the photos of the
moving ones, registered with the scene as it is at the first time, as who has no times would. Masks are true ones,
embeddings words with noise. "space and time": IoU of the match's box and the true one, intersections summed over all
times over unions summed; "rows": of the Gaussians selected. Then when the car is left of the vase, as seen from the
first camera, against the true centres: the share of times at which it is told right.
"""

import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from world.moving import Film, make_film

from drsplat import DrSplatWarning, Mixture, Scene, WordEncoder, register
from drsplat.kernels.boxes import box_of
from drsplat.query.answer import MatchTrack
from drsplat.query.relations import is_beside
from drsplat.scene.boxes import Box, solid
from drsplat.scene.moving import Moving

UP = np.array([0.0, 0.0, 1.0])
GRID = 32  # points along each side, that boxes are compared at


def boxes_iou(one: Box, other: Box) -> tuple[float, float]:
    """Volumes of what two boxes share, and of what either has."""
    corners = np.concatenate([_corners(box) for box in (one, other)])
    low, high = corners.min(0), corners.max(0)
    sides = [np.linspace(a, b, GRID, endpoint=False) + (b - a) / GRID / 2 for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*sides), -1).reshape(-1, 3)
    cell = float(np.prod((high - low) / GRID))
    inside = [(np.abs((points - box.center) @ box.axes.T) <= box.extent / 2).all(1) for box in (one, other)]
    return cell * np.count_nonzero(inside[0] & inside[1]), cell * np.count_nonzero(inside[0] | inside[1])


def _corners(box: Box) -> np.ndarray:
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
    return np.asarray(box.center + (signs * box.extent) @ box.axes)


def over_time(moving: Moving, rows: np.ndarray, track: MatchTrack | None) -> float:
    """IoU over space and time; a match that is not there at a time shares nothing then."""
    shared = either = 0.0
    for stamp in moving.times.tolist():
        at = moving.at(stamp)
        true = box_of(at, solid(at, rows), UP)
        found = None if track is None else track.at(stamp)
        if found is None:
            either += float(np.prod(true.extent))
            continue
        both, any_of = boxes_iou(Box(found.center, found.axes, found.extent), true)
        shared, either = shared + both, either + any_of
    return shared / either


def opened(film: Film, moving: Moving, register_with: Moving | None, seed: int) -> Scene:
    """moving: what the photos show. register_with: None: the scene at its first time, for all photos."""
    features = film.features(moving, seed)
    views = film.views if register_with else [replace(view, time=None) for view in film.views]
    made = register(register_with or film.moving.canonical, views, features)
    field = replace(made, encoder=WordEncoder.identity).to_field(Mixture())
    return Scene(field, register_with or film.moving.canonical, film.views)


def standing(film: Film, scene: Scene, match) -> MatchTrack:
    """What a scene that stands still says of all times: the same."""
    times = film.moving.times
    each = [np.repeat(value[None], len(times), 0) for value in (match.center, match.axes, match.extent)]
    return MatchTrack(match, times, *each)


def found(film: Film, scene: Scene, moving: Moving, label: int) -> tuple[float, float, MatchTrack | None]:
    """IoU over space and time, IoU of rows, and the track of the best match."""
    rows = np.flatnonzero(film.labels == label)
    matches = scene.locate(film.names[label], top=1)
    selected = scene.ask(film.names[label]).gaussian_ids
    same = len(np.intersect1d(rows, selected)) / max(1, len(np.union1d(rows, selected)))
    if not matches:
        return 0.0, same, None
    track = scene.tracks(matches)[0] if scene.motion else standing(film, scene, matches[0])
    return over_time(moving, rows, track), same, track


def told_right(film: Film, scene: Scene, one: int, other: int) -> tuple[float, str, str]:
    """Share of times, the spans that are told, and the true ones."""
    view, times = film.views[0], film.moving.times
    spans = scene.when(film.names[one], "left_of", film.names[other], view)
    told = np.array([any(start <= stamp <= end for start, end in spans) for stamp in times.tolist()])
    true = []
    for stamp in times.tolist():
        at = film.moving.at(stamp)
        boxes = [box_of(at, np.flatnonzero(film.labels == label), UP) for label in (one, other)]
        match = scene.locate(film.names[one], top=1)[0]
        ends = [replace(match, center=box.center, axes=box.axes, extent=box.extent) for box in boxes]
        true.append(is_beside(view, "left_of", *ends))
    from drsplat.query.tracks import runs, spans_text

    return float((told == true).mean()), spans_text(spans), spans_text(runs(times, np.array(true)))


def study(seed: int) -> list[tuple[float, float, float]]:
    started = time.process_time()
    film = make_film(seed)
    print(f"\nfilm {seed}: {len(film.moving):,} Gaussians, {len(film.moving.times)} times, {len(film.views)} photos")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DrSplatWarning)
        moving = opened(film, film.moving, film.moving, seed)
        still = opened(film, film.still, film.still, seed)
        static = opened(film, film.moving, None, seed)
    print("| thing | moves | space and time: moving | still | static | rows: moving | still | static |")
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    ious = []
    for label, name in enumerate(film.names[:-1]):
        each = [found(film, scene, shown, label) for scene, shown in
                ((moving, film.moving), (still, film.still), (static, film.moving))]  # fmt: skip
        cells = [f"{100 * one[0]:.1f}" for one in each] + [f"{100 * one[1]:.1f}" for one in each]
        print(f"| {name} | {'yes' if label in film.moves else 'no'} | {' | '.join(cells)} |")
        if label in film.moves:
            ious.append((each[0][0], each[1][0], each[2][0]))
    share, told, true = told_right(film, moving, 1, 2)
    print(
        f"when is the {film.names[1]} left of the {film.names[2]}? {told}; true: {true}; right at {share:.1%} of times"
    )
    print(f"{time.process_time() - started:.0f} s of CPU")
    return ious


def main() -> None:
    every = [one for seed in ([int(text) for text in sys.argv[1:]] or [0, 1]) for one in study(seed)]
    moving, still, static = np.mean(every, axis=0)
    print(f"\nthings that move, mean: moving {moving:.1%}, still {still:.1%}, static {static:.1%}")
    print(f"moving is {moving / still:.1%} of still")


if __name__ == "__main__":
    main()
