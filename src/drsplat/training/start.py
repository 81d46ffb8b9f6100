"""The start of an optimisation: views that can be trained on, their extent, the first Gaussians."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..base.arrays import Vector3
from ..errors import InputError, warn
from ..formats.captures import SparsePoints
from ..kernels.training import SceneParameters
from ..scene.gaussians import SH_C0, SH_COEFFICIENTS, local_origin, size_of
from ..scene.photo_masks import views_with_something
from ..scene.views import View
from .metrics import WINDOW
from .settings import TrainingSettings

NEIGHBOURS = 3
MIN_DISTANCE2 = 1e-7  # scene units squared, between points in one place
MIN_DISTANCE_SHARE = 1e-3  # of the extent of all points, where that is less
SAME_PLACE_SHARE = 1e-8  # of the cameras' distance from zero: float64 rounding
MIN_TRAIN_PHOTOS = 2
SMALL_SIDE_PIXELS = 64  # about six windows of SSIM: smaller photos get a warning


class Split(NamedTuple):
    """train: optimised on. test: held out, every n-th by name, as 3DGS and LLFF do."""

    train: list[View]
    test: list[View]


def split_views(views: Sequence[View], test_every: int) -> Split:
    """Check the views and hold every `test_every`-th out, from the first on; 0 holds none out.

    Warns: DrSplatWarning: photos whose masks leave all of them out have no part.
    Raises: InputError: views without photos, a name that occurs twice, fewer than two views to
    train on, or all of them in one place.
    """
    ordered = sorted(views, key=lambda view: view.name)
    _require_photos(ordered)
    ordered = views_with_something(ordered)
    train: list[View] = []
    test: list[View] = []
    for index, view in enumerate(ordered):
        (test if test_every > 0 and index % test_every == 0 else train).append(view)
    if len(train) < MIN_TRAIN_PHOTOS:
        raise InputError(
            f"a scene is trained on at least {MIN_TRAIN_PHOTOS} photos from different places: of "
            f"{len(ordered)} there are {len(train)} left after every {test_every}th is held "
            "out for testing: add photos, or hold none out with test_every=0"
            if test_every and len(ordered) >= MIN_TRAIN_PHOTOS
            else f"a scene is trained on at least {MIN_TRAIN_PHOTOS} photos from different places, got "
            f"{len(ordered)}: add photos"
        )
    scene_extent(train)
    return Split(train, test)


def local_capture(split: Split, points: SparsePoints | None) -> tuple[Split, SparsePoints | None, Vector3]:
    """Count a capture from its local origin, which float32 can hold without loss, and return that too.

    It moves if it is far from zero for its size, see `placing.local_origin`.
    """
    given = points is not None and len(points.positions) > NEIGHBOURS
    cameras = np.array([view.center for view in split.train])
    origin = local_origin(points.positions if points is not None and given else cameras)
    if not origin.any():
        return split, points, origin
    train, test = ([view.relative_to(origin) for view in views] for views in split)
    return Split(train, test), None if points is None else points.moved(-origin), origin


def _require_photos(views: Sequence[View]) -> None:
    without = [view.name for view in views if view.image_path is None]
    if without:
        raise InputError(
            f"{len(without)} of {len(views)} views have no photo, the first is '{without[0]}': "
            "read them with images=FOLDER, or leave these views out"
        )
    names = [view.name for view in views]
    if len(set(names)) < len(names):
        raise InputError("two views have one name: names are how photos are told apart")
    # the window of SSIM has to fit into them
    least = min(views, key=lambda view: min(view.size), default=None)
    if least is None:
        return
    small = f"photos of {least.width}x{least.height} pixels"
    if min(least.size) < WINDOW:
        raise InputError(
            f"{small}: the loss compares squares of {WINDOW}x{WINDOW} pixels, so no side may be shorter, and less than "
            f"{SMALL_SIDE_PIXELS} pixels teach little. Scale them down less: resolution=PIXELS is the longer side, and "
            "1, 2, 4 or 8 divide the sides"
        )
    if max(least.size) < SMALL_SIDE_PIXELS:
        warn(f"{small}: only what fills a good part of a photo is learnt: take {SMALL_SIDE_PIXELS} pixels or more", 2)


def scene_extent(views: Sequence[View]) -> float:
    """Return 1.1 x the distance of the farthest camera from the mean of all, in scene units.

    Raises: InputError: all cameras are in one place, so that nothing tells how far things are.
    Source: the published defaults of 3DGS ("cameras_extent").
    """
    centers = np.array([view.center for view in views])
    mean = centers.mean(0)
    farthest = float(np.linalg.norm(centers - mean, axis=1).max())
    if not farthest > SAME_PLACE_SHARE * (1 + float(np.linalg.norm(mean))):
        raise InputError(
            f"all {len(views)} cameras are in one place, {np.array2string(mean, precision=3)}: depth cannot be learnt "
            "from there. Take photos from different places, and check that the poses were read from the right file"
        )
    return 1.1 * farthest


def first_gaussians(points: SparsePoints, settings: TrainingSettings) -> SceneParameters:
    """Return a round Gaussian per point, as large as its neighbours are far.

    Size: root of the mean squared distance to the 3 nearest. Higher SH are zero.
    Source: 3DGS Sec. 5.1 and its published defaults.
    """
    count = len(points.positions)
    tree = cKDTree(points.positions)
    distances = tree.query(points.positions, k=min(NEIGHBOURS + 1, count), workers=1)[0]
    least = min(MIN_DISTANCE2, (MIN_DISTANCE_SHARE * size_of(points.positions)) ** 2)
    mean2 = np.maximum((distances[:, 1:] ** 2).mean(1), least or MIN_DISTANCE2)
    log_scales = np.log(settings.first_scale * np.sqrt(mean2))
    sh = np.zeros((count, SH_COEFFICIENTS[settings.sh_degree], 3), np.float32)
    sh[:, 0] = (points.colors / 255 - 0.5) / SH_C0
    opacity = settings.first_opacity
    return SceneParameters(
        np.ascontiguousarray(points.positions, np.float32),
        np.repeat(log_scales[:, None], 3, axis=1).astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        np.full(count, math.log(opacity / (1 - opacity)), np.float32),
        sh,
    )
