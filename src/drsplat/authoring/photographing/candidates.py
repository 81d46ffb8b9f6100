"""Settings of pictures, cameras that could take them, and the choice of those that show most of the scene."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.sparse import csc_array

from ...base.arrays import Doubles, Flags, Indices, OtherDoubles, Points, Vector3
from ...errors import InputError
from ...field.codes import Track, untracked
from ...kernels import view_weights
from ...photos.embedding.view_choice import SIGHTS_PER_GAUSSIAN, greedy
from ...scene.views import View
from ..filming.looking import looking_at
from ..filming.paths import FOV_BOUNDS_DEGREES, check_size
from .space import MAX_NEAR_SHARE, Space, spread_out

DEFAULT_SIZE_PIXELS = (1024, 768)
DEFAULT_FOV_DEGREES = 60.0
MAX_PICTURES = 10_000


@dataclass(frozen=True)
class PhotographSettings:
    """Settings for pictures of a scene.

    Attributes:
        number: pictures, 1 to 10,000; None for as many as coverage takes, 48 to 150.
        size: width and height in pixels.
        fov_degrees: from the top to the bottom of a picture.
        up: direction that is up in the pictures; None for what the scene itself suggests.
        time: of a scene that moves.
        background: RGB in [0, 1] behind the Gaussians.

    Raises:
        InputError: a number that is out of range.
    """

    number: int | None = None
    size: tuple[int, int] = DEFAULT_SIZE_PIXELS
    fov_degrees: float = DEFAULT_FOV_DEGREES
    up: tuple[float, float, float] | None = None
    time: float | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_size(self.size)
        if self.number is not None and not 1 <= self.number <= MAX_PICTURES:
            raise InputError(f"number: expected 1 to {MAX_PICTURES:,} pictures, got {self.number:,}")
        if not FOV_BOUNDS_DEGREES[0] <= self.fov_degrees <= FOV_BOUNDS_DEGREES[1]:
            raise InputError(
                f"fov: expected {FOV_BOUNDS_DEGREES[0]:g} to {FOV_BOUNDS_DEGREES[1]:g} degrees, "
                f"got {self.fov_degrees:g}"
            )
        if self.up is not None and not 0 < sum(number * number for number in self.up) < float("inf"):
            raise InputError(f"up: expected a direction of three finite numbers, got {self.up}")
        if not all(0 <= number <= 1 for number in self.background):
            raise InputError(f"background: expected red, green and blue from 0 to 1, got {self.background}")


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


def candidates(space: Space, settings: PhotographSettings) -> tuple[str, list[View]]:
    """Return "room", "object" or "mixed", and cameras in free space, none of them inside Gaussians.

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
    return "room" if is_room else "mixed" if inside else "object", views


def _in_room(space: Space, places: list[Vector3], settings: PhotographSettings) -> Iterator[View]:
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


def _targets(space: Space) -> Points:
    """Return places of the scene that are spread out over it, its middle first."""
    low, high = space.box
    points = space.solid[((space.solid >= low) & (space.solid <= high)).all(1)]
    middle = np.median(points, axis=0)
    first = points[np.linalg.norm(points - middle, axis=1).argmin()]
    sample = points[:: max(1, len(points) // 4096)]
    return spread_out(np.concatenate([first[None], sample]), NUM_TARGETS)


def _ring(up: Vector3, turns: int, pitch_degrees: float) -> Points:
    """Return unit directions all around, at a pitch above the horizon."""
    ahead, aside = _level(up)
    angles = np.arange(turns)[:, None] * 2 * np.pi / turns
    pitch = np.radians(pitch_degrees)
    return np.cos(pitch) * (np.cos(angles) * ahead + np.sin(angles) * aside) + np.sin(pitch) * up


def _sphere(up: Vector3, count: int, first_turn: float = 0.0) -> Points:
    """Return unit directions that are spread evenly between the lowest and the highest elevation.

    first_turn: of the first one around `up`, in radians.
    """
    ahead, aside = _level(up)
    heights = MIN_ELEVATION_SINE + (MAX_ELEVATION_SINE - MIN_ELEVATION_SINE) * (np.arange(count)[:, None] + 0.5) / count
    angles = first_turn + np.arange(count)[:, None] * GOLDEN_TURN_RADIANS
    return np.sqrt(1 - heights**2) * (np.cos(angles) * ahead + np.sin(angles) * aside) + heights * up


def _level(up: Vector3) -> tuple[Vector3, Vector3]:
    """Return two unit directions at right angles to up and to each other."""
    first = np.eye(3)[int(np.abs(up).argmin())]
    ahead = first - (first @ up) * up
    ahead /= np.linalg.norm(ahead)
    return ahead, np.cross(up, ahead)


def _view(space: Space, eye: Vector3, target: Vector3, settings: PhotographSettings) -> View:
    return looking_at(eye, target, space.up, settings.size, settings.fov_degrees)


PLANNING_SIDE_PIXELS = 252  # longer side of pictures for planning
ENOUGH_PIXELS = 1.0  # blending weight, summed over a picture's pixels, at which a Gaussian counts as seen
SIGNIFICANT_WEIGHT = 0.98  # of all weight, each Gaussian counted by its best picture
ENOUGH_SIGHTS = int(SIGHTS_PER_GAUSSIAN)  # of a Gaussian
ENOUGH_SHARE = 0.98  # of the coverage by all candidates, at which the default number of pictures is reached
DEFAULT_PICTURES_BOUNDS = (48, 150)
SMEAR_SHARE = 0.1  # of a picture's height: a Gaussian with a larger standard deviation is a smear
SHARP_QUANTILE, SHARP_MARGIN = 0.1, 0.1  # cameras are sharp up to this quantile of all smears, and this above it


@dataclass(frozen=True)
class Coverage:
    """Coverage of a scene by pictures.

    Attributes:
        significant: number of Gaussians that matter: those with the largest blending weights, by their best picture,
            which have 98 % of it together.
        often: share of these that three pictures or more show with a weight of a pixel or more.
        once: share of these that one picture or more shows.
        reachable: `often`, of all cameras that the choice was made from.
    """

    significant: int
    often: float
    once: float
    reachable: float

    def json(self) -> dict[str, object]:
        """Return the numbers for the record, with their definition."""
        return {**asdict(self), "pictures": ENOUGH_SIGHTS, "pixels": ENOUGH_PIXELS}


@dataclass(frozen=True, eq=False)
class Sights:
    """Sights of cameras: what each picture shows.

    Attributes:
        views: the cameras.
        pixels: blending weight of each Gaussian in each picture, in pixels, (N, V).
        smears: share of each picture that large Gaussians make up. From where no photo was taken a trained scene looks
            smeared.
    """

    views: list[View]
    pixels: csc_array
    smears: Doubles

    def sharp(self) -> "Sights":
        """Return the sights of cameras hardly more smeared than the best tenth."""
        if not self.views:
            return self
        (sharp,) = np.nonzero(self.smears <= np.quantile(self.smears, SHARP_QUANTILE) + SHARP_MARGIN)
        return Sights([self.views[at] for at in sharp], csc_array(self.pixels[:, sharp]), self.smears[sharp])

    @property
    def significant(self) -> Flags:
        """Gaussians that have SIGNIFICANT_WEIGHT of all weight together, each counted by its best picture."""
        best = np.zeros(self.pixels.shape[0])
        np.maximum.at(best, self.pixels.indices, self.pixels.data)
        order = np.argsort(-best, kind="stable")
        before = np.cumsum(best[order]) - best[order]
        matters = np.zeros(len(best), np.bool_)
        matters[order] = (before < SIGNIFICANT_WEIGHT * best.sum()) & (best[order] > 0)
        return matters

    @property
    def seen(self) -> csc_array:
        """Matrix with 1 where a picture shows enough of a Gaussian that matters, (M, V)."""
        seen = self.pixels.copy()
        seen.data = (seen.data >= ENOUGH_PIXELS).astype(np.float64)
        seen.eliminate_zeros()
        return csc_array(seen.tocsr()[np.flatnonzero(self.significant)].tocsc())

    def coverage(self, chosen: Sequence[int]) -> Coverage:
        """Measure the coverage by some of the pictures."""
        seen = self.seen
        counts, possible = _counts(seen, np.array(chosen, np.int64)), _counts(seen, np.arange(seen.shape[1]))
        if not len(counts):
            return Coverage(0, 0.0, 0.0, 0.0)
        often, reachable = ((numbers >= ENOUGH_SIGHTS).mean() for numbers in (counts, possible))
        once = (counts >= 1).mean()
        return Coverage(len(counts), float(often), float(once), float(reachable))


def sights(space: Space, views: Sequence[View], track: Track = untracked) -> Sights:
    """Look through cameras, in small pictures; cameras with Gaussians right before them are left out."""
    ids, weights, smears, accepted = [np.empty(0, np.int64)], [np.empty(0)], [], []
    sizes, positions = space.gaussians.scales.max(1), space.positions
    for view in track(views, "planning pictures"):
        small = view.limited(PLANNING_SIDE_PIXELS)
        raster = np.zeros((small.height, small.width), np.int32)
        triples = view_weights(space.splats, small, raster, None, threads=space.threads)
        rows, seen = triples.gaussian_ids.astype(np.int64), triples.weights.astype(np.float64)
        if seen[space.is_near(view.center)[rows]].sum() > MAX_NEAR_SHARE * raster.size or not len(rows):
            continue
        away = positions[rows] @ view.cam_from_world[2, :3] + view.cam_from_world[2, 3]
        is_large = sizes[rows] * view.K[1, 1] > SMEAR_SHARE * view.height * away
        smears.append(seen[is_large].sum() / seen.sum())
        accepted.append(view)
        ids.append(rows)
        weights.append(seen * (view.width * view.height / raster.size))
    starts = np.cumsum([len(row_ids) for row_ids in ids])
    shape = (len(space.gaussians), len(accepted))
    pixels = csc_array((np.concatenate(weights), np.concatenate(ids), starts), shape=shape)
    return Sights(accepted, pixels, np.array(smears))


def chosen_views(seen: Sights, number: int | None) -> list[int]:
    """Choose views one after another, each the one that shows most that is not yet in three pictures.

    number: pictures; None for as many as bring coverage near to that of all, 48 to 150. When nothing is left to gain,
    everything is to be seen three times more.
    """
    marks = seen.seen
    if number is None:
        enough = greedy(marks, ENOUGH_SHARE, DEFAULT_PICTURES_BOUNDS[1])[0]
        number = max(len(enough), DEFAULT_PICTURES_BOUNDS[0])
    chosen: list[int] = []
    rest = np.arange(marks.shape[1])
    while len(chosen) < min(number, marks.shape[1]):
        more = greedy(csc_array(marks[:, rest]), 1.0, number - len(chosen))[0] or list(range(number - len(chosen)))
        chosen += rest[more[: len(rest)]].tolist()
        rest = np.setdiff1d(rest, chosen)
    return chosen


def _counts(seen: csc_array, chosen: Indices) -> OtherDoubles:
    """Return the number of pictures that show each Gaussian."""
    return np.asarray(seen[:, chosen].sum(1)).reshape(-1)
