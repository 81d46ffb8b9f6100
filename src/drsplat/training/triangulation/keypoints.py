"""Places of a photo that can be recognised in another one."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from skimage.color import rgb2gray
from skimage.feature import SIFT

from ...base.arrays import Bool, Float32, Float64, UInt8
from ...errors import InputError
from ...scene.lens import undistort_points
from ...scene.photo_masks import load_mask
from ...scene.photos import load_image, photo_size
from ...scene.views import View

MAX_SIDE_PIXELS = 640  # more cost more, and 3DGS starts no better from them
MAX_KEYPOINTS = 1000  # of a photo, those of the largest scale first
MIN_SIDE_PIXELS = 24  # SIFT has no octave on less
MIN_CONTRAST = 0.005  # of differences of Gaussians; Lowe's 0.03 / 3 leaves a blurred phone photo without any


class Keypoints(NamedTuple):
    """Keypoints of a view: pixels on its pinhole (lens undone) at its own size, and SIFT descriptors."""

    pixels: Float64[np.ndarray, "n 2"]
    colors: UInt8[np.ndarray, "n 3"]
    descriptors: UInt8[np.ndarray, "n 128"]


class Detection(NamedTuple):
    """Keypoints that SIFT detected. pixels: x and y on the raster that SIFT saw; sigmas: in its pixels."""

    pixels: Float64[np.ndarray, "n 2"]
    sigmas: Float32[np.ndarray, " n"]
    colors: UInt8[np.ndarray, "n 3"]
    descriptors: UInt8[np.ndarray, "n 128"]


NOTHING = Detection(np.empty((0, 2)), np.empty(0, np.float32), np.empty((0, 3), np.uint8), np.empty((0, 128), np.uint8))


def keypoints(view: View) -> Keypoints:
    """Detect keypoints on the photo as stored: undoing the lens first would add the photo's border as an edge.

    Raises: InputError, FormatError: as `load_image`.
    Source: Lowe, "Distinctive Image Features from Scale-Invariant Keypoints" (2004).
    """
    stored = as_stored(view)
    return located(view, stored, detect(stored))


def located(view: View, stored: View, detection: Detection) -> Keypoints:
    """Return the detected keypoints on the pinhole of a view. stored: `as_stored(view)`."""
    scale = (view.width / stored.width, view.height / stored.height)
    pixels = undistort_points(view, detection.pixels * scale)
    chosen = _largest(detection.sigmas, np.isfinite(pixels).all(axis=1) & _inside_mask(stored, detection.pixels))
    return Keypoints(pixels[chosen], detection.colors[chosen], detection.descriptors[chosen])


def _inside_mask(stored: View, pixels: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Return which pixels of a stored photo lie inside its mask; all where it has none."""
    mask = load_mask(stored)
    if mask is None:
        return np.ones(len(pixels), bool)
    x, y = np.clip(pixels.astype(np.intp), 0, (stored.width - 1, stored.height - 1)).T
    inside: Bool[np.ndarray, " n"] = mask[y, x]
    return inside


def detect(stored: View) -> Detection:
    """Run SIFT on the raster of `as_stored`.

    Raises: InputError, FormatError: as `load_image`.
    """
    photo = load_image(stored)
    sift = _detected(photo)
    if sift is None:
        return NOTHING
    rows, columns = np.rint(sift.positions).astype(np.intp).T
    pixels = sift.positions[:, ::-1].astype(np.float64) + 0.5  # centres are at half integers
    return Detection(pixels, sift.sigmas.astype(np.float32), photo[rows, columns], sift.descriptors)


def as_stored(view: View) -> View:
    """Return the view without its lens, on the raster that SIFT sees: the photo's own, or a smaller one.

    Raises: InputError: no photo, or as `photo_size`.
    """
    return _shrunk(replace(view, distortion=None))


def _shrunk(view: View) -> View:
    if view.image_path is None:
        raise InputError(f"view '{view.name}' has no photo: read it with images=FOLDER")
    width, height = photo_size(view.image_path)
    scale = min(1.0, MAX_SIDE_PIXELS / max(width, height))
    return view.resized(max(1, round(width * scale)), max(1, round(height * scale)))


@np.errstate(all="ignore")  # a patch without gradients divides by their sum
def _detected(photo: UInt8[np.ndarray, "h w 3"]) -> Any:
    """Return a SIFT with its keypoints, or None for a photo without texture."""
    if min(photo.shape[:2]) < MIN_SIDE_PIXELS:
        return None
    sift: Any = SIFT(upsampling=1, c_dog=MIN_CONTRAST)  # type: ignore[no-untyped-call]
    try:
        sift.detect_and_extract(rgb2gray(photo).astype(np.float32))
    except (RuntimeError, ValueError):  # how scikit-image says that there is none
        return None
    return sift


def _largest(sigmas: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the ascending indices of the `MAX_KEYPOINTS` usable keypoints of largest scale: these reappear most."""
    order = np.argsort(-sigmas, kind="stable")
    return np.sort(order[usable[order]][:MAX_KEYPOINTS])
