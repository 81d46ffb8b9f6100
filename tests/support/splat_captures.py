"""Captures made of any splat: cameras around it, photos, and masks by colour with embeddings of colours.

A trained scene usually comes with its photos, and masks and embeddings come from SAM and CLIP. Here all three
are made from the scene itself: masks are patches of one colour, and the cosine of two embeddings falls with the
distance of their colours. "red" has a vector of the same space, as a text has with CLIP.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64
from scipy import ndimage
from skimage.color import rgb2lab
from skimage.measure import label

import drsplat as ds
from drsplat.authoring.filming.looking import looking_at
from drsplat.base.arrays import Image, MaskIds, PixelNumbers, Points, Vector3
from drsplat.drawing.pictures import as_pixels, write_picture
from drsplat.formats.langsplat import write_features
from drsplat.formats.poses import write_cameras_json
from drsplat.kernels import splat_arrays

BACKDROP = 0.93  # grey level of the studio behind the object
ELEVATIONS = (-12.0, 14.0, 40.0)  # degrees; views take them in turn
FIELD_OF_VIEW = 40.0  # degrees, along the photo's longer side
SMOOTHING = 1.0  # pixels, before colours are told apart
COLOUR_STEP = (24.0, 24.0, 24.0)  # L, a, b: one mask holds colours within one such cell
MIN_PIXELS = 40  # smaller patches get no mask
NOTHING = -(1 << 40)  # no colour
COLOUR_WIDTH = 30.0  # colours this far apart in Lab are at cosine exp(-1/2) = 0.61
COLOURS = {
    "red": (165, 35, 45), "orange": (225, 125, 40), "yellow": (215, 180, 80), "green": (50, 140, 60),
    "blue": (40, 80, 180), "brown": (95, 55, 30), "skin": (180, 130, 110), "white": (230, 228, 222),
    "grey": (120, 120, 120), "black": (22, 22, 24),
}  # fmt: skip


def orbit(gaussians: ds.Gaussians, up: Vector3, num_views: int, long_side: int = 800) -> list[ds.View]:
    """Cameras around the scene that show all of it; portrait format for tall scenes."""
    middle, half_height, radius = upright_cylinder(gaussians, up)
    tall = half_height > radius
    short_side = long_side * 3 // 4
    width, height = (short_side, long_side) if tall else (long_side, short_side)
    focal = 0.5 * long_side / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    fits = 2.0 * focal * max(half_height / height, radius / width)
    side = np.cross(up, np.roll(up, 1))
    views = []
    for index in range(num_views):
        azimuth = 2 * np.pi * index / num_views
        elevation = np.radians(ELEVATIONS[index % len(ELEVATIONS)])
        level = np.cos(azimuth) * side + np.sin(azimuth) * np.cross(up, side)
        away = np.cos(elevation) * level + np.sin(elevation) * up
        pose = looking_at(middle + (fits + radius) * away, middle, up, (width, height)).cam_from_world
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        views.append(ds.View(f"photo_{index:03d}.png", K, pose, width, height))
    return views


def upright_cylinder(gaussians: ds.Gaussians, up: Vector3) -> tuple[Vector3, float, float]:
    """Middle, half height and radius of the scene, whatever few Gaussians float far off."""
    points, mass = gaussians.means.astype(np.float64), gaussians.opacities
    low, high = (np.array([weighted_quantile(axis, mass, q) for axis in points.T]) for q in (0.002, 0.998))
    middle = (low + high) / 2
    heights = (points - middle) @ up
    across = np.linalg.norm(points - middle - heights[:, None] * up, axis=1)
    return (middle, weighted_quantile(np.abs(heights), mass, 0.998), weighted_quantile(across, mass, 0.998))


def weighted_quantile(values: np.ndarray, weights: np.ndarray, q: float) -> float:
    """The value below which a share q of the weight lies."""
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order], dtype=np.float64)
    return float(values[order][np.searchsorted(cumulated, q * cumulated[-1])])


class ColourEncoder:
    """Colours to unit vectors, by random Fourier features of Lab: cosine = exp(-(d / width)^2 / 2).

    It stands where CLIP stands: it has `identity` and `encode_texts`, which is all that
    a query asks of an encoder. Source: Rahimi and Recht 2007.
    """

    identity = ds.EncoderIdentity("colour-512", 512, weights="lab-fourier-1")

    def __init__(self) -> None:
        shape = (3, self.identity.dim // 2)
        self._frequencies = np.random.default_rng(0).standard_normal(shape) / COLOUR_WIDTH

    def encode_lab(self, lab: Points) -> Float32[np.ndarray, "n 512"]:
        phases = lab @ self._frequencies
        features = np.hstack([np.cos(phases), np.sin(phases)])
        features /= np.linalg.norm(features, axis=1, keepdims=True)
        return np.asarray(features, np.float32)

    def encode_texts(self, texts: Sequence[str]) -> Float32[np.ndarray, "t 512"]:
        """Vectors of colours by name."""
        return self.encode_lab(rgb2lab(np.array([COLOURS[text] for text in texts]) / 255))


def colour_patches(rgb: Image, alpha: PixelNumbers) -> tuple[MaskIds, Float64[np.ndarray, "s 3"]]:
    """Segment map of connected patches of one colour, and the mean Lab colour of each.

    rgb is over black, so that rgb / alpha is the object's own colour. Pixels of alpha < 0.5 are -1.
    """
    smooth = ndimage.gaussian_filter(rgb, (SMOOTHING, SMOOTHING, 0))
    cover = ndimage.gaussian_filter(alpha, SMOOTHING)
    lab = rgb2lab(np.clip(smooth / np.maximum(cover, 1e-3)[..., None], 0, 1))
    cells = np.round(lab / COLOUR_STEP).astype(np.int64) @ (1 << 20, 1 << 10, 1)
    patches = label(np.where(alpha < 0.5, NOTHING, cells), background=NOTHING, connectivity=1)
    sizes = np.bincount(patches.ravel())
    sizes[patches[alpha < 0.5]] = 0
    kept = np.flatnonzero(sizes >= MIN_PIXELS)
    renumbered = np.full(len(sizes), -1, np.int32)
    renumbered[kept] = np.arange(len(kept))
    sums = [np.bincount(patches.ravel(), channel.ravel()) for channel in np.moveaxis(lab, -1, 0)]
    return renumbered[patches], np.stack(sums, -1)[kept] / sizes[kept, None]


def write_capture(folder: Path, gaussians: ds.Gaussians, views: Sequence[ds.View]) -> None:
    """folder/images, folder/cameras.json and folder/features, as a user would have them."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    write_cameras_json(folder / "cameras.json", views, overwrite=True)
    encoder, splats = ColourEncoder(), splat_arrays(gaussians)
    for view in views:
        seen = ds.render(gaussians, view, splats=splats)
        photo = seen.rgb + (1 - seen.alpha[..., None]) * np.float32(BACKDROP)
        write_picture(folder / "images" / view.name, as_pixels(photo), overwrite=True)
        mask_ids, lab = colour_patches(seen.rgb, seen.alpha)
        stem = Path(view.name).stem
        write_features(folder / "features", stem, mask_ids, encoder.encode_lab(lab), overwrite=True)
