"""Cameras to choose from: all around in a room, on spheres around an object."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...base.arrays import Float64, Vector
from ...errors import InputError
from ...scene.views import View
from ..filming.looking import looking_at
from .settings import PhotographSettings
from .space import Space, spread_out

MAX_PLACES = 48  # in free space to consider
MIN_ENCLOSED_SHARE = 0.65  # of directions that show something, at a place within a room
ROOM_SHARE = 0.5  # of the places: if so many are free and enclosed, the scene is a room
LEVEL_TURNS = 8  # directions around the vertical at one place
STEEP_TURNS = 6  # likewise, looking down or up
LEVEL_PITCH_DEGREES = -5.0
DOWN_PITCH_DEGREES = -40.0
UP_PITCH_DEGREES = 25.0
NUM_TARGETS = 24  # parts of an object, or of a room, to look at
TARGETS_PER_PLACE = 4  # in a room
EXTRA_TARGETS = 2  # from a place around an object, beside the middle
FAR_SHARES = (1.0, 0.7)  # of the distance at which all of an object is in the picture
FAR_VIEWS = 48  # places at each of these
NEAR_SHARE = 0.4  # of that distance
NEAR_VIEWS = 8  # places around each part
MIN_ELEVATION_SINE, MAX_ELEVATION_SINE = np.sin(np.radians((-25.0, 80.0)))  # elevations
WHOLE_QUANTILE = 0.95  # of the Gaussians' distances from the middle, for a picture of the whole
GOLDEN_TURN_RADIANS = np.pi * (3 - np.sqrt(5))


class Candidates(NamedTuple):
    """Cameras that a choice is made from. kind: "room", "object", or "mixed"."""

    kind: str
    views: list[View]


def candidates(space: Space, settings: PhotographSettings) -> Candidates:
    """Return cameras in free space, none of them inside Gaussians.

    In a room they are at the places enclosed by it. Where few free places are enclosed, the scene is an object with
    more or less around it: cameras are around it, and at the enclosed places, too.

    Raises: InputError: there is no place for any.
    """
    places = spread_out(space.free_places, MAX_PLACES)
    around = [space.surroundings(place) for place in places]
    inside = [
        place
        for place, surroundings in zip(places, around, strict=True)
        if surroundings.is_free and surroundings.enclosed >= MIN_ENCLOSED_SHARE
    ]
    is_room = len(inside) > 0 and len(inside) >= ROOM_SHARE * len(places)
    views = list(_in_room(space, inside, settings))
    views += [] if is_room else _around(space, settings)
    if not views:
        raise InputError(
            "there is no free place for a camera in or around this scene: name a path of your own, key frames of which "
            "are in front of what is to be seen"
        )
    return Candidates("room" if is_room else "mixed" if inside else "object", views)


def _in_room(space: Space, places: list[Vector], settings: PhotographSettings) -> Iterator[View]:
    """Yield cameras that look all around at each place, level, down and up, and at near targets."""
    targets = _targets(space)
    level, down, up = (_ring(space.up, *ring) for ring in (
        (LEVEL_TURNS, LEVEL_PITCH_DEGREES), (STEEP_TURNS, DOWN_PITCH_DEGREES), (STEEP_TURNS, UP_PITCH_DEGREES)
    ))  # fmt: skip
    for place in places:
        nearest = targets[np.argsort(np.linalg.norm(targets - place, axis=1), kind="stable")[:TARGETS_PER_PLACE]]
        for target in (*(place + np.concatenate([level, down, up])), *nearest):
            if np.linalg.norm(target - place) > 1e-6 * space.diagonal:
                yield _view(space, place, target, settings)


def _around(space: Space, settings: PhotographSettings) -> Iterator[View]:
    """Yield cameras on a sphere around an object that show all of it, and on smaller ones around its parts."""
    middle = np.median(space.solid, axis=0)
    radius = float(np.quantile(np.linalg.norm(space.solid - middle, axis=1), WHOLE_QUANTILE))
    width, height = settings.size
    half = np.arctan(np.tan(np.radians(settings.fov_degrees) / 2) * min(1.0, width / height))
    far = max(radius / np.sin(half), 2 * space.clearance)
    targets = _targets(space)
    places = [
        (middle, middle + share * far * direction)
        for share in FAR_SHARES
        for direction in _sphere(space.up, FAR_VIEWS, first_turn=share)
    ]
    for number, target in enumerate(targets):
        turned = _sphere(space.up, NEAR_VIEWS, first_turn=number * GOLDEN_TURN_RADIANS / NEAR_VIEWS)
        places += [(target, target + NEAR_SHARE * far * direction) for direction in turned]
    for number, (target, eye) in enumerate(places):
        if eye @ space.up >= space.bottom and space.is_free(eye):
            aside = targets[(number + np.arange(EXTRA_TARGETS) * NUM_TARGETS // EXTRA_TARGETS) % len(targets)]
            for looked_at in (target, *aside):
                if np.linalg.norm(looked_at - eye) > space.clearance:
                    yield _view(space, eye, looked_at, settings)


def _targets(space: Space) -> Float64[np.ndarray, "t 3"]:
    """Return places of the scene that are spread out over it, its middle first."""
    low, high = space.box
    points = space.solid[((space.solid >= low) & (space.solid <= high)).all(1)]
    middle = np.median(points, axis=0)
    first = points[np.linalg.norm(points - middle, axis=1).argmin()]
    sample = points[:: max(1, len(points) // 4096)]
    return spread_out(np.concatenate([first[None], sample]), NUM_TARGETS)


def _ring(up: Vector, turns: int, pitch_degrees: float) -> Float64[np.ndarray, "t 3"]:
    """Return unit directions all around, at a pitch above the horizon."""
    ahead, aside = _level(up)
    angles = np.arange(turns)[:, None] * 2 * np.pi / turns
    pitch = np.radians(pitch_degrees)
    return np.asarray(np.cos(pitch) * (np.cos(angles) * ahead + np.sin(angles) * aside) + np.sin(pitch) * up)


def _sphere(up: Vector, count: int, first_turn: float = 0.0) -> Float64[np.ndarray, "c 3"]:
    """Return unit directions that are spread evenly between the lowest and the highest elevation.

    first_turn: of the first one around `up`, in radians.
    """
    ahead, aside = _level(up)
    heights = MIN_ELEVATION_SINE + (MAX_ELEVATION_SINE - MIN_ELEVATION_SINE) * (np.arange(count)[:, None] + 0.5) / count
    angles = first_turn + np.arange(count)[:, None] * GOLDEN_TURN_RADIANS
    return np.asarray(np.sqrt(1 - heights**2) * (np.cos(angles) * ahead + np.sin(angles) * aside) + heights * up)


def _level(up: Vector) -> tuple[Vector, Vector]:
    """Return two unit directions at right angles to up and to each other."""
    first = np.eye(3)[int(np.abs(up).argmin())]
    ahead = first - (first @ up) * up
    ahead /= np.linalg.norm(ahead)
    return ahead, np.cross(up, ahead)


def _view(space: Space, eye: Vector, target: Vector, settings: PhotographSettings) -> View:
    return looking_at(eye, target, space.up, settings.size, settings.fov_degrees)
