"""A place that is pointed at: what a ray meets or an outline holds, its words, its masks, and what is like it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from ...base.arrays import Doubles, Flags, Indices, OtherPixels, PlanePoints, RowIds, Vector3
from ...errors import DrSplatError
from ...field.evidence.evidence import Explanation
from ...kernels import SplatArrays, view_weights
from ...query import Match, Query, Scene, Word
from ...query.suggesting import words_of
from ...scene.gaussians import Gaussians
from ...scene.views import View
from .results import Result, result_of

REACH_DEVIATIONS = 3.0  # standard ones, at which a Gaussian ends
MIN_ALPHA = 1 / 255
MAX_ALPHA = 0.99
GAUSSIANS_PER_PIXEL = 8  # the heaviest: those behind what is seen have next to no weight
MIN_INSIDE_SHARE = 0.5  # of a Gaussian's weight in the picture
MIN_WEIGHT_PIXELS = 0.02  # of a Gaussian in the whole picture


class Ray(NamedTuple):
    """A half-line. direction: of length 1, as `ray_along` makes it."""

    origin: Vector3
    direction: Vector3


class Hit(NamedTuple):
    """gaussian_ids: met by a ray, by falling weight; point: where the first of them is met, in the world."""

    gaussian_ids: Indices
    weights: Doubles
    point: Vector3


def ray_along(origin: Vector3, direction: Vector3) -> Ray:
    """Return the ray in a direction, also in one so short or long that its square is 0 or infinite."""
    scaled = direction / np.abs(direction).max()
    return Ray(origin, np.asarray(scaled / np.linalg.norm(scaled)))


def hit_by_ray(gaussians: Gaussians, ray: Ray, visible: Flags | None = None) -> Hit | None:
    """Return the Gaussians along a ray in the world by blending weight, None where it meets nothing.

    Each is taken where it is densest along the ray, front to back, as one pixel would blend them.

    Source: 3DGS Eq. 3, in 3D instead of in the picture.
    """
    return blended(met_by_ray(gaussians, ray, visible), ray)


class Met(NamedTuple):
    """Gaussians that a ray meets: their rows, depths along it, and opacities where they are densest on it."""

    gaussian_ids: Indices
    depths: Doubles
    alphas: Doubles


def met_by_ray(gaussians: Gaussians, ray: Ray, visible: Flags | None = None) -> Met:
    """Return the Gaussians that a ray in the world meets, the nearest first."""
    origin, ahead = ray.origin - gaussians.origin, ray.direction
    # those whose bounding sphere the ray passes: all that can be met, and few of the scene
    offsets = gaussians.means - origin.astype(np.float32)
    along = offsets @ ahead.astype(np.float32)
    apart = np.einsum("ni,ni->n", offsets, offsets) - along**2
    reach = REACH_DEVIATIONS * gaussians.scales.max(1)
    near = np.flatnonzero((apart <= 1.01 * reach**2) & (along > -reach))
    near = near if visible is None else near[visible[near]]
    part = gaussians.subset(near)
    axes = part.whitening()
    start = np.einsum("nij,nj->ni", axes, origin - part.means.astype(np.float64))
    step = axes @ ahead
    depth = -np.einsum("ni,ni->n", start, step) / np.einsum("ni,ni->n", step, step)
    at = start + depth[:, None] * step
    alpha = part.opacities * np.exp(-0.5 * np.einsum("ni,ni->n", at, at))
    kept = (alpha >= MIN_ALPHA) & (depth > 0)
    order = np.flatnonzero(kept)[np.argsort(depth[kept], kind="stable")]
    return Met(near[order], depth[order], np.minimum(alpha[order], MAX_ALPHA))


def blended(met: Met, ray: Ray) -> Hit | None:
    """Return what a ray meets by falling blending weight, None for nothing. met: the nearest first."""
    if not len(met.depths):
        return None
    weights = met.alphas * np.concatenate([[1.0], np.cumprod(1 - met.alphas)[:-1]])
    ranked = np.argsort(-weights, kind="stable")
    point = ray.origin + met.depths[ranked[0]] * ray.direction
    return Hit(met.gaussian_ids[ranked], weights[ranked], point)


def inside_outline(splats: SplatArrays, view: View, outline: PlanePoints, *, threads: int = 0) -> RowIds:
    """Return the Gaussians, ascending, of which most that a view shows lies inside an outline.

    outline: corners of a polygon, in pixels of the view.
    """
    # 1 for each pixel inside a polygon and 0 for the others
    picture = Image.new("L", view.size)
    corners = np.clip(outline, -8 * max(view.size), 9 * max(view.size))
    ImageDraw.Draw(picture).polygon([tuple(corner) for corner in corners.tolist()], fill=1)
    seen = view_weights(splats, view, np.asarray(picture, np.int32), GAUSSIANS_PER_PIXEL, threads=threads)
    weights = seen.weights.astype(np.float64)
    count = len(splats.opacities)
    every = np.bincount(seen.gaussian_ids, weights, minlength=count)
    inside = np.bincount(seen.gaussian_ids, weights * (seen.mask_ids == 1), minlength=count)
    return np.flatnonzero((inside > MIN_INSIDE_SHARE * every) & (every >= MIN_WEIGHT_PIXELS))


MAX_EVIDENCE_MASKS, PICTURE_SIDE_PIXELS = 3, 480


@dataclass(frozen=True, eq=False)
class This:
    """words: best first, none where no encoder is known. evidence: photos and masks behind it.

    match: what is like it and holds it, None where that is too little. alike: all that is like it.
    """

    gaussian_id: int
    point: Vector3
    words: list[Word]
    evidence: list[Explanation]
    match: Match | None
    alike: Result

    @property
    def name(self) -> str:
        return self.words[0].text if self.words else ""


def this_is(scene: Scene, hit: Hit, words: Sequence[str] | None = None) -> This:
    """Describe what the first Gaussian of a hit is; all of them must have a feature."""
    first = int(hit.gaussian_ids[0])
    feature = scene.feature_of(first)
    alike = result_of(scene, "", scene.ask(Query(vector=feature)))
    holding = [match for match in alike.matches if first in match.gaussian_ids]
    try:
        named = scene.what_is(first, words or words_of(scene))
    except DrSplatError:  # nobody embeds words here
        named = []
    return This(
        first,
        hit.point,
        named,
        [] if scene.field.evidence is None else scene.field.explain(first, feature, MAX_EVIDENCE_MASKS),
        holding[0] if holding else None,
        alike,
    )


def known_words(scene: Scene, words: Sequence[str] | None) -> tuple[str, ...]:
    """Return words to name things with: given ones, else as `words_of`; none where the encoder is not at hand."""
    try:
        return tuple(words or words_of(scene))
    except DrSplatError:
        return ()


def photo_of(scene: Scene, this: This) -> OtherPixels | None:
    """Return the photo of most support, with the place in colour; None where there is none."""
    best = best_photo(scene, this)
    if best is None or this.match is None:
        return None
    return scene.picture(best, this.match.gaussian_ids, photo=True, max_side=PICTURE_SIDE_PIXELS)


def best_photo(scene: Scene, this: This) -> str | None:
    """Return the name of the photo of most support; None where there is none to show."""
    names = {view.name for view in scene.views}
    best = next((one.view_name for one in this.evidence if one.view_name in names), None)
    return None if this.match is None else best
