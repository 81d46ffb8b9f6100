"""Plan of a film: which path, how many pictures, how large."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...query import Match
from ...scene.boxes import up_of
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .looking import UP_WITHOUT_VIEWS, Vector
from .path_files import read_path
from .paths import CameraPath, check_size, frame_count
from .ways import around_match, around_scene, orbit, swinging, through_photos

ORBIT, SWING, PHOTOS = "orbit", "swing", "photos"
DEFAULT_FPS = 30.0
SECONDS_PER_KEY = 2.0  # unless the path says otherwise
DEFAULT_SIZE_PIXELS = (1280, 720)  # without photos
MAX_PHOTO_SIDE_PIXELS = 1280  # of pictures shaped as the photos


class Plan(NamedTuple):
    """views: one for each picture. size: of the film's pictures, both sides together where there are two."""

    views: list[View]
    fps: float
    size: tuple[int, int]

    @property
    def seconds(self) -> float:
        return len(self.views) / self.fps


def path_named(
    name: str, gaussians: Gaussians, views: Sequence[View], match: Match | None = None, up: Vector | None = None,
    seconds: float | None = None,
) -> CameraPath:  # fmt: skip
    """Return a path by its name: orbit or swing (around a match, else the scene), photos, or a file's.

    up: None for the direction that the photos tell.

    Raises: InputError: photos without any; no such file. FormatError: as `read_path`.
    """
    if name == PHOTOS:
        return through_photos(views, seconds)
    if name not in (ORBIT, SWING):
        return _from_file(name)
    upward = up_of(views) if up is None else up
    upward = np.array(UP_WITHOUT_VIEWS) if upward is None else upward
    around = around_scene(gaussians, views, upward) if match is None else around_match(match, gaussians, views, upward)
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
    rate = _first(fps, path.fps, DEFAULT_FPS)
    lasts = _first(seconds, path.seconds, SECONDS_PER_KEY * (len(path.keys) - 1))
    whole = _wished(path, views, sides) if size is None else size
    check_size(whole)
    if whole[0] % sides:
        raise InputError(
            f"size: {sides} pictures side by side have equal widths: expected a multiple of {sides} across, "
            f"got {whole[0]}x{whole[1]}"
        )
    return Plan(path.views(frame_count(lasts, rate), (whole[0] // sides, whole[1])), rate, whole)


def _wished(path: CameraPath, views: Sequence[View], sides: int) -> tuple[int, int]:
    """Return the size of a path or of the photos, with even sides as films need them."""
    width, height = path.size or DEFAULT_SIZE_PIXELS
    if path.size is None and views:
        view = views[0].limited(MAX_PHOTO_SIDE_PIXELS)
        width, height = view.width, view.height
    return sides * max(2, width - width % 2), max(2, height - height % 2)


def _first(*given: float | None) -> float:
    """Return the first value that is not None."""
    return next(one for one in given if one is not None)


def _from_file(name: str) -> CameraPath:
    if not Path(name).is_file():
        known = f"{ORBIT}, {SWING}, {PHOTOS} or a file of key frames"
        raise InputError(f"path: expected {known}; got {name!a}, and there is no such file")
    return read_path(name)
