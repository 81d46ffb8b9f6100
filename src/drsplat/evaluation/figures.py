"""Pictures of answers, as Figs. S6 to S10: the scores of a query, and the selection by a threshold."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ..base.arrays import Float32, Pixels
from ..drawing.pictures import as_pixels, best_views, highlighted, photo_or_rendering, visible_share
from ..kernels import SplatArrays, render_channels, splat_arrays
from ..scene.gaussians import Gaussians
from ..scene.views import View
from .lerf_ovs import LerfScene
from .report import Figure
from .scannet import ScannetScene
from .scorers import Scorer

LONG_SIDE_PIXELS = 480
SELECTED, OTHERS = (1.0, 0.85, 0.1), (0.1, 0.2, 0.65)  # Fig. S7: yellow, blue
_HEAT = np.array([[0.05, 0.03, 0.2], [0.3, 0.07, 0.45], [0.72, 0.2, 0.35], [0.98, 0.55, 0.2], [0.98, 0.98, 0.7]])


def lerf_figures(
    scene: LerfScene, gaussians: Gaussians, scorer: Scorer, most: int = 6, *, threads: int = 0
) -> list[Figure]:
    """Draw photo, activation and selection of up to `most` pairs of photo and category, spread over the scene."""
    pairs = scene.pairs
    spread = np.unique(np.linspace(0, len(pairs) - 1, min(most, len(pairs))).astype(int))
    splats, figures = splat_arrays(gaussians), []
    for at in spread.tolist():
        frame, category = pairs[at]
        view = small(scene.views[frame.name])
        scores = scorer.scores(category)
        photo = photo_or_rendering(gaussians, view, threads=threads)
        truth = np.asarray(Image.fromarray(frame.mask(category)).resize((view.width, view.height)), np.float32)
        where = f"{scene.name}, {frame.name}, “{category}”"
        figures.append(Figure(f"{where}: the label", highlighted(photo, truth)))
        figures += _answers(splats, view, scores, scorer.threshold, where, threads)
    return figures


def scannet_figures(
    scene: ScannetScene, views: Sequence[View], scorer: Scorer, most: int = 6, *, threads: int = 0
) -> list[Figure]:
    """Draw photo with labelled Gaussians, activation and selection of up to `most` classes of the scene.

    Each class is drawn from the view that shows most of it.
    """
    present = np.unique(scene.pseudo_labels[scene.pseudo_labels > 0])
    chosen = present[np.unique(np.linspace(0, len(present) - 1, min(most, len(present))).astype(int))]
    members = [np.flatnonzero(scene.pseudo_labels == number) for number in chosen.tolist()]
    splats, figures = splat_arrays(scene.gaussians), []
    for number, ids, view in zip(
        chosen.tolist(), members, best_views(scene.gaussians, views, members, threads=threads), strict=True
    ):
        at, scores = small(view), scorer.scores(scene.labels.prompts[number - 1])
        photo = photo_or_rendering(scene.gaussians, at, threads=threads)
        share = visible_share(scene.gaussians, at, ids, splats=splats, threads=threads)
        where = f"{scene.name}, {Path(view.name).stem}, “{scene.labels.prompts[number - 1]}”"
        figures.append(Figure(f"{where}: pseudo labels", highlighted(photo, share)))
        figures += _answers(splats, at, scores, scorer.threshold, where, threads)
    return figures


def _answers(
    splats: SplatArrays, view: View, scores: Float32[np.ndarray, " N"], threshold: float, where: str, threads: int
) -> list[Figure]:
    picture = selection(splats, view, scores, threshold, threads)
    return [
        Figure(f"{where}: scores", activation(splats, view, scores, threads)),
        Figure(f"{where}: above {threshold:g}", picture),
    ]


def small(view: View) -> View:
    """Resize a view to a longer side of at most LONG_SIDE_PIXELS."""
    scale = min(1.0, LONG_SIDE_PIXELS / max(view.width, view.height))
    return view.resized(max(1, round(view.width * scale)), max(1, round(view.height * scale)))


def activation(splats: SplatArrays, view: View, scores: Float32[np.ndarray, " N"], threads: int = 0) -> Pixels:
    """Draw scores from the 50th to the 99.9th percentile in colours from dark to light."""
    finite = scores[np.isfinite(scores)]
    low, high = np.percentile(finite, (50, 99.9)) if len(finite) else (0.0, 1.0)
    level = np.clip((np.nan_to_num(scores, nan=low) - low) / max(high - low, 1e-9), 0, 1)
    steps = np.linspace(0, 1, len(_HEAT))
    colors = np.stack([np.interp(level, steps, channel) for channel in _HEAT.T], 1)
    return _drawn(splats, view, colors.astype(np.float32), threads)


def selection(
    splats: SplatArrays, view: View, scores: Float32[np.ndarray, " N"], threshold: float, threads: int = 0
) -> Pixels:
    """Draw Gaussians above the threshold in yellow, the others in blue.  Source: Fig. S7."""
    chosen = (scores > np.float32(threshold))[:, None]
    return _drawn(splats, view, np.where(chosen, SELECTED, OTHERS).astype(np.float32), threads)


def _drawn(splats: SplatArrays, view: View, colors: Float32[np.ndarray, "N 3"], threads: int) -> Pixels:
    return as_pixels(render_channels(splats, view, colors, threads=threads).channels)
