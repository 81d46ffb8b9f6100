"""Find what moves between photos: the regions of a photo that its scene, made of all photos, does not show.

A scene of all photos shows what most of them agree on. Somebody's hand, a pet or a chair that was moved stands out of
it where one photo shows it. So does a glossy or finely patterned thing, but in every photo: what the *other* photos
lack of the same Gaussians is what this one may lack. And so does a shadow, under which photo and scene still have the
same pattern.

Source: ours; masks from residuals are those of "NeRF On-the-go" and "SpotLessSplats" in outline.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..base.arrays import Float64, Mask, Pixels
from ..drawing.rendering import render
from ..formats.mask_files import SUFFIX, write_mask
from ..kernels import render_channels, splat_arrays, topk_contributions
from ..photos.models.outlines import region_tree
from ..scene.gaussians import Gaussians
from ..scene.masks.region_tree import RegionTree
from ..scene.photo_masks import load_mask
from ..scene.photos import distort_ids, load_image, photo_coverage
from ..scene.views import View

SIDE_PIXELS = 252  # at which photos are compared
WINDOW = 5  # pixels over which differences are averaged
MAX_SMALL_PHOTOS = 1000  # that are kept while they are compared, at most 190 MB
NUM_WEIGHTS = 10  # of a pixel
DARK = 0.02  # of a colour: darker ones do not tell how bright a photo is
NOISE = 0.05  # of a colour, added to what the other photos lack
MIN_TIMES = 1.15  # what they lack, from which on a region stands out
MIN_TIMES_IN_LIGHT = 1.0  # the same, once the region is as bright as the photo
MIN_COVERED = 0.5  # of a pixel, by Gaussians
MIN_PHOTOS = 4.0  # that show the same Gaussians; of fewer nothing is said
MIN_SHARE, MAX_SHARE = 0.004, 0.4  # of a photo; more than that is a photo with a wrong pose
MIN_FLAGGED = 0.6  # of a part of the photo's hierarchy, from which on it stands out as a whole
SAME = 0.4  # correlation of fine patterns, from which on it is the same thing in another light
LIGHTS = 0.4, 2.0  # how much darker or brighter the same thing may be than in most photos
PATTERN = 6.0  # pixels: what is coarser is light
FRAME, MARGIN = 4, 2  # pixels at the photo's border that are not judged, and that are left out around what moves
_WHITE = 255


class _Compared(NamedTuple):
    """A photo beside its scene as bright, colours in [0, 1]; their mean difference, and which pixels are judged."""

    photo: Float64[np.ndarray, "h w 3"]
    drawn: Float64[np.ndarray, "h w 3"]
    difference: Float64[np.ndarray, "h w"]
    seen: Mask


def without_transients(
    views: Sequence[View], gaussians: Gaussians, folder: Path, *, held_out: Sequence[View] = (), threads: int = 0
) -> list[View]:
    """Return the views and then the held-out ones; those that show something that moves have a mask without it.

    What a view's mask leaves out already stays out, and is not judged.

    Args:
        views: posed photos that the scene is trained on.
        gaussians: the scene, some way into its training, in the frame of the views.
        folder: of the masks, NAME.png on the raster of the photo as stored, white where it is kept.
        held_out: further photos, which are judged and do not judge.
        threads: 0 for all cores; the same bits at any number.

    Raises: FormatError: a photo or a mask that cannot be read. InputError: the disk is full.
    """
    jury = _Jury(gaussians, threads)
    for view in views:
        jury.totals += jury.sums(view, jury.compared(view))
    found = []
    for number, view in enumerate([*views, *held_out]):
        moving = jury.judged(view, is_heard=number < len(views))
        if moving.any():  # its mask is on the photo's own raster
            shown = distort_ids(view.limited(SIDE_PIXELS), moving.astype(np.int32)) == 1
            view = write_mask(view, shown, folder)
        found.append(view)
    return found


def with_masks(views: Sequence[View], folder: Path) -> list[View]:
    """Return the views with the masks that `without_transients` wrote into a folder; those without one as they are."""
    paths = [folder / f"{view.name}{SUFFIX}" for view in views]
    return [
        replace(view, mask_path=path, mask_inverted=False) if path.is_file() else view
        for view, path in zip(views, paths, strict=True)
    ]


class _Jury:
    """The scene, and what its photos lack of each Gaussian. totals: (3, n), sums over all photos of `sums`."""

    def __init__(self, gaussians: Gaussians, threads: int) -> None:
        self.gaussians, self.threads = gaussians, threads
        self.splats = splat_arrays(gaussians)
        self.totals = np.zeros((3, len(gaussians)))
        self._photos: dict[str, Pixels] = {}

    def compared(self, view: View) -> _Compared:
        small = view.limited(SIDE_PIXELS)
        # read once while there is room: to decode it takes longest
        pixels = self._photos[small.name] if small.name in self._photos else load_image(small)
        if len(self._photos) < MAX_SMALL_PHOTOS:
            self._photos[small.name] = pixels
        photo = pixels / _WHITE
        drawn = render(self.gaussians, _pinhole(view), splats=self.splats, threads=self.threads).rgb.astype(np.float64)
        kept = load_mask(small)
        seen = ndimage.binary_erosion(photo_coverage(small), iterations=FRAME)
        seen = seen if kept is None else seen & kept
        ratios = photo.mean(axis=2)[seen] / np.maximum(drawn.mean(axis=2)[seen], DARK)
        drawn = np.clip(drawn * (np.median(ratios) if len(ratios) else 1), 0, 1)
        return _Compared(photo, drawn, ndimage.uniform_filter(np.abs(photo - drawn).mean(axis=2), WINDOW), seen)

    def sums(self, view: View, compared: _Compared) -> Float64[np.ndarray, "3 n"]:
        """Return each Gaussian's weights in a photo, these times the difference there, and their sum squared."""
        found = topk_contributions(self.splats, _pinhole(view), NUM_WEIGHTS, threads=self.threads)
        kept = (found.weights > 0) & compared.seen[..., None]
        ids, weights = found.ids[kept], found.weights[kept].astype(np.float64)
        differences = np.broadcast_to(compared.difference[..., None], kept.shape)[kept]
        weight, lacking = (np.bincount(ids, some, len(self.gaussians)) for some in (weights, weights * differences))
        return np.stack([weight, lacking, weight**2])

    def judged(self, view: View, is_heard: bool) -> Mask:
        """Return which pixels show something that moves, on the raster on which photos are compared."""
        compared = self.compared(view)
        others = self.totals - (self.sums(view, compared) if is_heard else 0)
        weight, lacked, squared = np.maximum(others, 1e-9)
        values = np.stack([lacked / weight, weight**2 / squared, np.ones_like(weight)], 1).astype(np.float32)
        drawn = render_channels(self.splats, _pinhole(view), values, threads=self.threads).channels
        lacking, photos, covered = np.moveaxis(drawn.astype(np.float64), 2, 0)
        seen = compared.seen & (covered > MIN_COVERED) & (photos >= MIN_PHOTOS * covered)
        level = np.where(seen, lacking / np.maximum(covered, MIN_COVERED) + NOISE, np.inf)
        tree = region_tree(np.round(compared.photo * _WHITE).astype(np.uint8), threads=self.threads)
        return _moving(_flagged(tree, compared.difference / level)[tree.labels], compared, level)


def _flagged(tree: RegionTree, times: Float64[np.ndarray, "h w"]) -> np.ndarray:
    """Return which regions stand out, by themselves or as a part of something that mostly does."""
    areas = tree.areas
    flagged = np.bincount(tree.labels.ravel(), times.ravel(), len(areas)) >= MIN_TIMES * areas
    wholes = tree.candidates
    shares = (wholes @ (areas * flagged)) / np.maximum(wholes @ areas, 1)
    filled = (shares >= MIN_FLAGGED) & (wholes @ areas < MAX_SHARE * areas.sum())
    return flagged | ((wholes.T @ filled) > 0)


def _moving(flagged: Mask, compared: _Compared, level: Float64[np.ndarray, "h w"]) -> Mask:
    """Return the flagged pixels, but for small pieces, and for what the scene shows as well, in another light.

    level: the difference that is nothing, of each pixel.
    """
    pieces, count = ndimage.label(flagged)
    moving = np.zeros_like(flagged)
    patterns = [
        colors - ndimage.gaussian_filter(colors, (PATTERN, PATTERN, 0)) for colors in (compared.photo, compared.drawn)
    ]
    for number in range(1, count + 1):
        piece = pieces == number
        if piece.mean() <= MIN_SHARE or _correlation(*(pattern[piece] for pattern in patterns)) >= SAME:
            continue
        photo, drawn = compared.photo[piece], compared.drawn[piece]
        light = np.clip((photo * drawn).sum() / ((drawn**2).sum() + DARK), *LIGHTS)
        if (np.abs(photo - light * drawn).mean(axis=1) / level[piece]).mean() >= MIN_TIMES_IN_LIGHT:
            moving |= piece
    if not moving.any() or moving.mean() > MAX_SHARE:
        return np.zeros_like(flagged)
    return ndimage.binary_dilation(moving, iterations=MARGIN)


def _correlation(one: Float64[np.ndarray, "n 3"], other: Float64[np.ndarray, "n 3"]) -> float:
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    return float((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum() + 1e-12))


def _pinhole(view: View) -> View:
    return replace(view.limited(SIDE_PIXELS), distortion=None)
