"""Plan of a film: which path, how many pictures, how large."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.arrays import Points, Vector3
from ...errors import InputError
from ...query import Match
from ...scene.boxes import up_of
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .looking import FOV_DEGREES, UP_WITHOUT_VIEWS, before, looking_at, swing
from .paths import CameraPath, KeyFrame, check_size, frame_count, read_path

ORBIT, SWING, PHOTOS = "orbit", "swing", "photos"
DEFAULT_FPS = 30.0
SECONDS_PER_KEY = 2.0  # unless the path says otherwise
DEFAULT_SIZE_PIXELS = (1280, 720)  # without photos
MAX_PHOTO_SIDE_PIXELS = 1280  # of pictures shaped as the photos
MAX_PHOTOS_PER_SECOND = 2.0  # more would show the shaking of a hand
PHOTO_BOUNDS_S = (4.0, 30.0)
ORBIT_S = 10.0
SWING_S = 5.0
ORBIT_KEYS = 36
SWING_KEYS = 24
ORBIT_RISE = 0.5  # height of an orbit without photos, over its radius
ORBIT_RADIUS = 1.6  # of an orbit without photos, over the radius that holds the next share of Gaussians
RADIUS_QUANTILE = 0.9
MIN_UNSEEN_RADIANS = 2 * np.pi / 3  # without a photo: an orbit turns back there
ANGLE_QUANTILES = (0.1, 0.9)  # of the photos: the outermost stand where there is little room
MIN_FACING_SHARE = 0.5  # of the photos, for a place that they were taken of


class Plan(NamedTuple):
    """views: one for each picture. size: of the film's pictures, both sides together where there are two."""

    views: list[View]
    fps: float
    size: tuple[int, int]

    @property
    def seconds(self) -> float:
        return len(self.views) / self.fps


def path_named(
    name: str, gaussians: Gaussians, views: Sequence[View], match: Match | None = None, up: Vector3 | None = None,
    seconds: float | None = None,
) -> CameraPath:  # fmt: skip
    """Return a path by its name: orbit or swing (around a match, else the scene), photos, or a file's.

    up: None for the direction that the photos tell.

    Raises: InputError: photos without any; no such file. FormatError: as `read_path`.
    """
    if name == PHOTOS:
        return through_photos(views, seconds)
    if name not in (ORBIT, SWING):
        if not Path(name).is_file():
            known = f"{ORBIT}, {SWING}, {PHOTOS} or a file of key frames"
            raise InputError(f"path: expected {known}; got {name!a}, and there is no such file")
        return read_path(name)
    upward = up_of(views) if up is None else up
    upward = np.array(UP_WITHOUT_VIEWS) if upward is None else upward
    if match is None:
        around = around_scene(gaussians, views, upward)
    else:  # from the side that most photos see it from
        around = Around(match.center, before(match, gaussians, views, upward))
    return orbit(around, upward, views) if name == ORBIT else swinging(around, upward)


def planned(
    path: CameraPath, *, views: Sequence[View] = (), fps: float | None = None, seconds: float | None = None,
    size: tuple[int, int] | None = None, sides: int = 1,
) -> Plan:  # fmt: skip
    """Plan the pictures of a film along a path.

    What is None comes from the path, else it is the photos' size, 30 pictures a second, and two seconds for each key
    frame. sides: number of pictures side by side in each, which share its width.

    Raises: InputError: no pictures or too many, too large ones, or a width that cannot be shared.
    """
    defaults = DEFAULT_FPS, SECONDS_PER_KEY * (len(path.keys) - 1)
    wishes = zip((fps, seconds), (path.fps, path.seconds), defaults, strict=True)
    rate, lasts = (next(one for one in wish if one is not None) for wish in wishes)
    whole = size
    if whole is None:  # that of the path or of the photos, with even sides as films need them
        default = views[0].limited(MAX_PHOTO_SIDE_PIXELS).size if views else DEFAULT_SIZE_PIXELS
        width, height = path.size or default
        whole = sides * max(2, width - width % 2), max(2, height - height % 2)
    check_size(whole)
    if whole[0] % sides:
        raise InputError(
            f"size: {sides} pictures side by side have equal widths: expected a multiple of {sides} across, "
            f"got {whole[0]}x{whole[1]}"
        )
    return Plan(path.views(frame_count(lasts, rate), (whole[0] // sides, whole[1])), rate, whole)


class Around(NamedTuple):
    """A circling camera: it looks at `target` and begins at `eye`."""

    target: Vector3
    eye: Vector3
    fov_degrees: float = FOV_DEGREES


def through_photos(views: Sequence[View], seconds: float | None = None) -> CameraPath:
    """Return key frames in the order of the photos, at most two photos a second, evenly chosen.

    seconds: of the film; None for half of one for each photo, 4 to 30. Raises: InputError: fewer than two photos.
    """
    if len(views) < 2:
        raise InputError(f"a path through the photos needs two of them or more, got {len(views)}")
    lasts = float(np.clip(len(views) / MAX_PHOTOS_PER_SECOND, *PHOTO_BOUNDS_S)) if seconds is None else seconds
    count = int(np.clip(round(lasts * MAX_PHOTOS_PER_SECOND) + 1, 2, len(views)))
    chosen = np.linspace(0, len(views) - 1, count).round().astype(int)
    return CameraPath([KeyFrame.of(views[i]) for i in chosen], seconds=lasts)


def orbit(around: Around, up: Vector3, views: Sequence[View] = ()) -> CameraPath:
    """Round the target, level, at one height: once, or to and fro where the photos leave out a third of the circle.

    There nobody has seen what the scene looks like; as often as not it is the inside of a wall.

    Raises: InputError: the camera would stand above or below its target.
    """
    arm = around.eye - around.target
    level = arm - (arm @ up) * up
    if not np.linalg.norm(level) > 1e-9 * max(1.0, float(np.linalg.norm(arm))):
        raise InputError("an orbit cannot begin right above or below what it goes around: name another place")
    aside = np.cross(up, level)
    turns = np.arange(ORBIT_KEYS) * 2 * np.pi / ORBIT_KEYS
    arc = _arc([view.center - around.target for view in views], level, aside)
    if arc is not None:
        turns = arc[0] + (arc[1] - arc[0]) * (0.5 + 0.5 * np.sin(turns))
    eyes = around.target + (arm @ up) * up + np.outer(np.cos(turns), level) + np.outer(np.sin(turns), aside)
    return CameraPath(_looking(eyes, around, up), closed=True, even=True, seconds=ORBIT_S)


def _arc(arms: Sequence[Vector3], level: Vector3, aside: Vector3) -> tuple[float, float] | None:
    """Return the range of angles that the photos are in, None where they are all around, or nowhere."""
    if not arms:
        return None
    angles = np.sort([np.arctan2(arm @ aside, arm @ level) for arm in arms])
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    widest = int(gaps.argmax())
    if gaps[widest] < MIN_UNSEEN_RADIANS:
        return None
    turns = np.mod(angles - angles[(widest + 1) % len(angles)], 2 * np.pi)
    low, high = float(angles[(widest + 1) % len(angles)]) + np.quantile(turns, ANGLE_QUANTILES)
    return float(low), float(high)


def swinging(around: Around, up: Vector3, turn_degrees: float = 60.0) -> CameraPath:
    """Return key frames to one side, to the other and back, slow at the turns: a loop that keeps to its first side."""
    eyes = np.array(swing(around.eye, around.target, up, SWING_KEYS, turn_degrees))
    return CameraPath(_looking(eyes, around, up), closed=True, even=True, seconds=SWING_S)


def around_scene(gaussians: Gaussians, views: Sequence[View], up: Vector3) -> Around:
    """Return a camera that circles what the photos look at, from their distance and height.

    Without photos it circles the middle of the scene, from outside.

    Raises: InputError: no Gaussians.
    """
    if not len(gaussians):
        raise InputError("there is nothing to go around: the scene has no Gaussians")
    middle = np.median(gaussians.positions, axis=0)
    if not views:
        away = np.linalg.norm(gaussians.positions - middle, axis=1)
        reach = float(np.quantile(away, RADIUS_QUANTILE)) or 1.0
        side = np.cross(up, np.roll(up, 1) + 1e-3)
        side = side / np.linalg.norm(side)
        return Around(middle, middle + ORBIT_RADIUS * reach * (side + ORBIT_RISE * up))
    target = focus_of(views, middle)
    arms = np.array([view.center for view in views]) - target
    heights = arms @ up
    level = np.linalg.norm(arms - heights[:, None] * up, axis=1)
    first = arms[0] - heights[0] * up
    if not np.linalg.norm(first) > 1e-9:
        first = np.cross(up, np.roll(up, 1) + 1e-3)
    eye = target + np.median(level) * first / np.linalg.norm(first) + np.median(heights) * up
    return Around(target, eye, KeyFrame.of(views[len(views) // 2]).fov_degrees)


def focus_of(views: Sequence[View], middle: Vector3) -> Vector3:
    """Return the place that the photos' optical axes pass nearest to; `middle` where most do not face it."""
    eyes, ahead = np.array([view.center for view in views]), np.array([view.cam_from_world[2, :3] for view in views])
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None]
    held = 1e-3 * np.eye(3)  # where all axes are parallel, or there is one, any place along them will do
    found = np.linalg.solve(
        across.sum(0) + held * len(views), np.einsum("vij,vj->i", across, eyes) + held @ middle * len(views)
    )
    faced = np.einsum("vi,vi->v", found - eyes, ahead) > 0
    return found if faced.mean() > MIN_FACING_SHARE else middle


def _looking(eyes: Points, around: Around, up: Vector3) -> list[KeyFrame]:
    """Return key frames at some places that look at the target."""
    return [KeyFrame.of(looking_at(eye, around.target, up, (64, 64), around.fov_degrees)) for eye in eyes]
