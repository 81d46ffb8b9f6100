"""Masks that leave people out of photos with poses, but for those who stand as still as all else."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from ....base.arrays import MaskIds, Pixels
from ....base.working import Track, untracked
from ....formats.captures import SparsePoints
from ....formats.mask_files import write_mask
from ....scene.lens import distort_points
from ....scene.photos import load_image
from ....scene.views import View
from .finding import SIDE_PIXELS, people

LEAST_POINTS = 30  # that tell whether somebody stands still
STILL = 0.25  # least correlation of their brightness with that of the points; of who moves it is about 0


def without_people(
    views: Sequence[View], points: SparsePoints | None, folder: Path, *, track: Track = untracked, threads: int = 0
) -> list[View]:
    """Return the views, those that show people with a mask that leaves them out.

    Where a photo is bright within a person as the scene's points there are, what looks like a person stands still, and
    is kept: a statue, a doll, somebody who is scanned. Views with a mask, and those without a photo, stay as they are.

    points: of the scene; None: whoever stands still is left out as well. folder: of the masks. threads: photos at once,
    0 for as many as cores.

    Raises: FormatError: a photo that cannot be read.
    """
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        made = pool.map(lambda view: _without_people(view, points, folder), views)
        return [view for view, _ in zip(made, track(views, "looking for people"), strict=True)]


def _without_people(view: View, points: SparsePoints | None, folder: Path) -> View:
    if view.image_path is None or view.mask_path:
        return view
    seen = view.limited(SIDE_PIXELS)
    image = load_image(replace(seen, distortion=None))
    labels = people(image, threads=1)
    still = [] if points is None or not labels.any() else _still(seen, image, labels, points)
    shown = (labels > 0) & ~np.isin(labels, still)
    return write_mask(view, shown, folder) if shown.any() else view


def _still(view: View, image: Pixels, labels: MaskIds, points: SparsePoints) -> list[int]:
    """Return the numbers of those who stand still, by the points that the photo should show there."""
    at = (points.positions - view.center) @ view.cam_from_world[:3, :3].T
    ahead = at[:, 2] > 0
    pixels = distort_points(view, (at[ahead] / at[ahead, 2:] @ view.K.T)[:, :2])
    on_photo = ((pixels >= 0) & (pixels < view.size)).all(1)
    columns, rows = pixels[on_photo].astype(np.intp).T
    seen, known = image[rows, columns].mean(1), points.colors[ahead][on_photo].mean(1)
    owner = labels[rows, columns]
    still = []
    for number in range(1, labels.max() + 1):
        a, b = (colors[owner == number] for colors in (seen, known))
        if len(a) >= LEAST_POINTS and ((a - a.mean()) * (b - b.mean())).mean() > STILL * a.std() * b.std():
            still.append(number)
    return still
