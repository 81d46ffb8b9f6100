"""lerf-ovs@1: 3D object selection as OpenGaussian measures it, on labelled photos.

A text selects Gaussians; only these are rendered from each labelled photo's place; the predicted mask is where their
alpha exceeds 0.7. mIoU is the mean over all pairs of a photo and a category labelled on it. A pair without prediction
counts 0; categories that a photo does not show are not asked.

In a rendering of the selection alone, Gaussians that are hidden in the scene are visible, and count as wrong. So we
add `seen`: the mIoU of the pixels where the selection is more than half of the picture of the whole scene. Of
selections that share no Gaussian, at most one is seen at a pixel, and none where nothing covers it.

Source: OpenGaussian (Wu et al. 2024); Dr. Splat Sec. B "3D object selection".
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from ..base.arrays import Float32, Mask, PixelNumbers, RowIds
from ..base.contents import Document
from ..errors import FormatError, InputError, MismatchError
from ..field.codes import Track, untracked
from ..formats.captures import read_views
from ..formats.json_files import as_vector, excerpt, read_json
from ..formats.lerf_ovs import LabelledFrame, read_lerf_labels
from ..formats.replacing import replacing
from ..kernels import SplatArrays, render_channels, splat_arrays
from ..scene.gaussians import Gaussians
from ..scene.views import View, same_aspect
from . import scorers
from .predictions import (
    ANSWERED,
    AUTOMATIC,
    FIXED,
    TUNED,
    Chooser,
    Manifest,
    best_sweep,
    columns_of,
    is_sweep,
    mask_path,
    read_manifests,
    read_mask,
    seen_column,
    sweep_column,
    write_mask,
)
from .scorers import Scorer, Scores

PROTOCOL = "lerf-ovs@1"
SILHOUETTE_ALPHA = 0.7  # of the selected Gaussians, rendered alone
MAJORITY_SHARE = 0.5  # of the whole picture's blending weights that the selection has
PEAK_WINDOW_SHARE = 1 / 33  # of the width; LangSplat smooths over 30 pixels of photos about 990 wide
PEAKS = "peaks.json"
ACCURACY_IOUS = (0.25, 0.5)
MAX_THRESHOLD = 2.0  # above all cosines and relevancies


@dataclass(frozen=True, eq=False)
class LerfScene:
    """Labelled photos of a scene and their views, on the labels' raster."""

    name: str
    frames: Sequence[LabelledFrame]
    views: Mapping[str, View]

    @property
    def pairs(self) -> list[tuple[LabelledFrame, str]]:
        return [(frame, category) for frame in self.frames for category in frame.categories]

    @property
    def categories(self) -> list[str]:
        return sorted({category for _, category in self.pairs})


def read_lerf_scene(data: Path, name: str) -> LerfScene:
    """Read the capture DATA/NAME and its labels, DATA/label/NAME.

    Raises: InputError: no such folders, a labelled photo without pose, or with a lens that is not a
    pinhole. MismatchError: a label of another shape than its photo.
    """
    frames = read_lerf_labels(data / "label" / name)
    by_stem = {Path(view.name).stem: view for view in read_views(data / name)}
    missing = [frame.name for frame in frames if frame.name not in by_stem]
    if missing:
        raise InputError(f"{data / name}: {len(missing)} labelled photos have no pose, first '{missing[0]}'")
    return LerfScene(name, frames, {f.name: _on_labels(by_stem[f.name], f) for f in frames})


def predict(
    scene: LerfScene,
    gaussians: Gaussians,
    scorer: Scorer,
    folder: Path,
    *,
    choosers: Mapping[str, tuple[Chooser, str]] | None = None,
    threads: int = 0,
    track: Track = untracked,
) -> None:
    """Write masks for the fixed threshold, for every threshold of the sweep and for each chooser.

    choosers: by column, a function that returns a query's threshold from its scores, and its description. If the scorer
    has an `answer`, the automatic column is that.

    Raises: MismatchError: a scorer of another scene.
    """
    if scorer.num_gaussians != len(gaussians):
        raise MismatchError(f"'{scorer.name}' scores {scorer.num_gaussians} Gaussians, the scene has {len(gaussians)}")
    chosen = choosers or {}
    columns = columns_of(scorer.threshold, scorer.sweep, chosen)
    if AUTOMATIC in chosen and scorer.answer is not None:
        columns[AUTOMATIC] = ANSWERED
    splats = splat_arrays(gaussians)
    peaks: dict[str, dict[str, list[float] | None]] = {}
    picked: dict[str, dict[str, float]] = {name: {} for name in chosen}
    categories = track(scene.categories, f"{scene.name}: queries")
    for category, scores in zip(categories, scorer.each(scene.categories), strict=True):
        cuts = _cuts(scorer, category, scores, chosen)
        for name in chosen:
            picked[name][category] = next(cut.at[name] for cut in cuts if name in cut.at)
        for frame in (f for f in scene.frames if category in f.polygons):
            view = scene.views[frame.name]
            path = partial(mask_path, folder, scene.name, frame=frame.name, category=category)
            drawn = [_write_masks(splats, view, cut, path, threads) for cut in cuts]
            peaks.setdefault(frame.name, {})[category] = peak(drawn[0])
    inputs = {
        "gaussians": gaussians.fingerprint,
        "scorer": dict(scorer.about),
        "silhouette": SILHOUETTE_ALPHA,
        "majority": MAJORITY_SHARE,
        "peak_window": PEAK_WINDOW_SHARE,
        "chosen": picked,
    }
    Manifest(PROTOCOL, scorer.name, scene.name, columns, inputs, leaked_frames(scene, scorer)).write(folder)
    with replacing(folder / scene.name / PEAKS, overwrite=True) as file:
        file.write(json.dumps(peaks, indent=1).encode() + b"\n")


def without_labelled(views: Sequence[View], scene: LerfScene) -> list[View]:
    """Return the views without the labelled photos, so that a method has not seen what is tested."""
    labelled = {frame.name for frame in scene.frames}
    return [view for view in views if Path(view.name).stem not in labelled]


def leaked_frames(scene: LerfScene, scorer: Scorer) -> tuple[str, ...] | None:
    """Return the labelled photos that the method was made from; None where the scorer does not say."""
    if scorer.views is None:
        return None
    used = {Path(name).stem for name in scorer.views}
    return tuple(frame.name for frame in scene.frames if frame.name in used)


def score(scenes: Sequence[LerfScene], folder: Path) -> Document:
    """Score the predictions in a folder; reads labels and predictions and nothing else.

    columns: by choice of threshold. Of the sweep, the one threshold with the best mean over scenes
    becomes "tuned on test", and says so.

    Raises: InputError: no scene, or one without predictions. FormatError: damaged predictions.
    """
    manifests = read_manifests(folder, [scene.name for scene in scenes], PROTOCOL)
    columns = _common_columns(manifests)
    by_scene = [_ious(scene, folder, list(columns)) for scene in scenes]
    ious = {column: [scene_ious[column] for scene_ious in by_scene] for column in columns}
    seen = {column: [_seen_ious(scene, folder, column) for scene in scenes] for column in columns}
    peaks = [_peak_hits(scene, folder) for scene in scenes]
    means = {column: scorers.scene_macro(values) for column, values in ious.items()}
    tuned = best_sweep(means)
    shown_columns = {c: c for c in columns if not is_sweep(c)}
    if tuned is not None:
        shown_columns[TUNED] = tuned
    return {
        "protocol": PROTOCOL,
        "method": manifests[0].method,
        "scenes": [_scene_record(*pair) for pair in zip(scenes, manifests, strict=True)],
        "thresholds": {name: columns[source] for name, source in shown_columns.items()},
        "columns": {
            name: _summary(scenes, ious[source], seen[source], peaks) for name, source in shown_columns.items()
        },
        "sweep": {column: means[column] for column in columns if is_sweep(column)},
        "sweep_seen": {c: scorers.scene_macro(seen[c]) for c in columns if is_sweep(c)},
        "queries": _queries(
            scenes,
            {name: ious[c] for name, c in shown_columns.items()},
            {name: seen[c] for name, c in shown_columns.items()},
            peaks,
        ),
    }


def _on_labels(view: View, frame: LabelledFrame) -> View:
    if view.distortion is not None:
        raise InputError(
            f"'{view.name}': the photo has a lens distortion and the labels lie on it: undistort the "
            "capture first, with `colmap image_undistorter`"
        )
    if not same_aspect(view.size, (frame.width, frame.height)):
        raise MismatchError(f"'{view.name}' is {view.width}x{view.height}, its labels are {frame.width}x{frame.height}")
    return view.resized(frame.width, frame.height)


class _Cut(NamedTuple):
    """Scores of a query, and the thresholds to compare them with, by column."""

    scores: Scores
    at: dict[str, float]


def _cuts(scorer: Scorer, category: str, scores: Scores, chosen: Mapping[str, tuple[Chooser, str]]) -> list[_Cut]:
    """Return the cuts of the scores and, if the scorer has an `answer`, of that."""
    at = {FIXED: scorer.threshold, **{sweep_column(t): t for t in scorer.sweep}}
    answer = scorer.answer(category) if scorer.answer and AUTOMATIC in chosen else None
    for name, (choose, _) in chosen.items():
        if answer is None or name != AUTOMATIC:
            threshold = choose(scores)
            at[name] = threshold if np.isfinite(threshold) else MAX_THRESHOLD  # selects nothing
    return [_Cut(scores, at)] + ([] if answer is None else [_Cut(answer[0], {AUTOMATIC: answer[1]})])


def _write_masks(splats: SplatArrays, view: View, cut: _Cut, path: Callable[..., Path], threads: int) -> PixelNumbers:
    """Write the masks of a selection, alone and within the scene, by column; return the scores' picture."""
    for column, mask in _masks(splats, view, cut, threads):
        write_mask(path(column=column), mask)
    whole = _whole_picture(splats, view, cut, threads)
    for column, share in zip(cut.at, whole[1:], strict=True):
        write_mask(path(column=seen_column(column)), share > MAJORITY_SHARE)
    return whole[0]


def _masks(splats: SplatArrays, view: View, cut: _Cut, threads: int) -> Iterator[tuple[str, Mask]]:
    """Yield each column's mask; equal selections are rendered once."""
    count, mask = -1, np.zeros((view.height, view.width), bool)
    for column, threshold in sorted(cut.at.items(), key=lambda item: item[1]):
        selected = np.flatnonzero(cut.scores > np.float32(threshold))  # false for NaN
        if len(selected) != count:  # selections by threshold are nested
            count, mask = len(selected), silhouette(splats, view, selected, threads)
        yield column, mask


def silhouette(splats: SplatArrays, view: View, selected: RowIds, threads: int = 0) -> Mask:
    """Return where the selected Gaussians, rendered alone, are more opaque than 0.7."""
    if not len(selected):
        return np.zeros((view.height, view.width), bool)
    alone = splats.subset(selected)
    drawn = render_channels(alone, view, np.zeros((len(selected), 1), np.float32), threads=threads)
    return drawn.alpha > SILHOUETTE_ALPHA


def _whole_picture(splats: SplatArrays, view: View, cut: _Cut, threads: int) -> Float32[np.ndarray, "c h w"]:
    """Render sum_i w_i v_i of the whole scene: for v = max(s, 0), then for each threshold's selection (v = 1)."""
    positive = np.nan_to_num(np.maximum(cut.scores, 0), nan=0.0)
    thresholds = np.array([*cut.at.values()], np.float32)
    values = np.column_stack([positive, cut.scores[:, None] > thresholds]).astype(np.float32)
    return np.moveaxis(render_channels(splats, view, values, threads=threads).channels, 2, 0)


def peak(drawn: PixelNumbers) -> list[float] | None:
    """Return (x, y) of the maximum of the smoothed score map; None where nothing scores above 0.

    The map is of the whole scene: 0 where no Gaussian covers it, and outside the frame. LangSplat's window of 30
    pixels does not grow with the photo and is not centred on a pixel, and its borders are mirrored.
    """
    window = round(drawn.shape[1] * PEAK_WINDOW_SHARE) | 1  # odd: centred on a pixel
    smooth = uniform_filter(drawn.astype(np.float64), window, mode="constant")
    if not smooth.max() > 0:
        return None
    y, x = np.unravel_index(int(smooth.argmax()), smooth.shape)
    return [float(x), float(y)]


def _common_columns(manifests: Sequence[Manifest]) -> dict[str, str]:
    first = manifests[0]
    for other in manifests[1:]:
        if set(other.columns) != set(first.columns) or other.method != first.method:
            raise MismatchError(
                f"'{other.scene}' was predicted by '{other.method}' with other thresholds than "
                f"'{first.scene}' by '{first.method}': predict all scenes in one way"
            )
    return dict(first.columns)


def _ious(scene: LerfScene, folder: Path, columns: Sequence[str]) -> dict[str, list[float]]:
    """Return the IoU of each pair, by column; 0 where there is no prediction."""
    ious: dict[str, list[float]] = {column: [] for column in columns}
    for frame, category in scene.pairs:
        truth = frame.mask(category)
        for column in columns:
            path = mask_path(folder, scene.name, column, frame.name, category)
            mask = read_mask(path, frame.width, frame.height)
            ious[column].append(0.0 if mask is None else scorers.mask_iou(mask, truth))
    return ious


def _seen_ious(scene: LerfScene, folder: Path, column: str) -> list[float]:
    """Return the IoU of each pair within the scene; NaN where predictions have no such masks."""
    if not (folder / scene.name / seen_column(column)).is_dir():
        return [float("nan")] * len(scene.pairs)
    return _ious(scene, folder, [seen_column(column)])[seen_column(column)]


def _peak_hits(scene: LerfScene, folder: Path) -> list[float]:
    """Return 1 for each pair whose peak lies in a box of the category, else 0; 0 without a peak."""
    path = folder / scene.name / PEAKS
    document = read_json(path) if path.is_file() else {}
    if not isinstance(document, dict):
        raise FormatError(f"{path}: expected a JSON object, got {excerpt(document)}")
    hits = []
    for frame, category in scene.pairs:
        of_frame = document.get(frame.name, {})
        peak = of_frame.get(category) if isinstance(of_frame, dict) else None
        if peak is None:
            hits.append(0.0)
            continue
        x, y = as_vector(peak, 2, f"{path}: {frame.name}: {category[:60]!a}").tolist()
        hits.append(float(scorers.in_any_box(x, y, frame.boxes[category])))
    return hits


def _summary(
    scenes: Sequence[LerfScene], ious: Sequence[list[float]], seen: Sequence[list[float]], hits: Sequence[list[float]]
) -> Document:
    by_scene = [_numbers(*of_scene) for of_scene in zip(ious, seen, hits, strict=True)]
    pooled = [[value for values in kind for value in values] for kind in (ious, seen, hits)]
    return {
        "scene_macro": {key: scorers.mean([numbers[key] for numbers in by_scene]) for key in by_scene[0]},
        "query_micro": _numbers(*pooled),
        "by_scene": {s.name: numbers for s, numbers in zip(scenes, by_scene, strict=True)},
    }


def _numbers(ious: list[float], seen: list[float], hits: list[float]) -> dict[str, float]:
    accuracies = {f"acc@{t:g}": scorers.share_above(ious, t) for t in ACCURACY_IOUS}
    means = {"miou": scorers.mean(ious), "seen": scorers.mean(seen)}
    return {**means, **accuracies, "localization": scorers.mean(hits)}


def _scene_record(scene: LerfScene, manifest: Manifest) -> Document:
    leaked = None if manifest.leaked is None else list(manifest.leaked)
    counts = {"frames": len(scene.frames), "pairs": len(scene.pairs)}
    return {"name": scene.name, **counts, "leaked": leaked, "inputs": dict(manifest.inputs)}


def _queries(
    scenes: Sequence[LerfScene],
    ious: Mapping[str, Sequence[list[float]]],
    seen: Mapping[str, Sequence[list[float]]],
    hits: Sequence[list[float]],
) -> list[Document]:
    rows = []
    for s, scene in enumerate(scenes):
        for p, (frame, category) in enumerate(scene.pairs):
            alone, whole = ({column: by_scene[s][p] for column, by_scene in kind.items()} for kind in (ious, seen))
            rows.append(
                {"scene": scene.name, "frame": frame.name, "category": category}
                | {"iou": alone, "seen": whole, "localized": bool(hits[s][p])}
            )
    return rows
