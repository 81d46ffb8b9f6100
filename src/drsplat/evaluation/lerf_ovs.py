"""lerf-ovs@1: 3D object selection as OpenGaussian measures it, on labelled photos.

A text selects Gaussians; only these are rendered from each labelled photo's place; the predicted mask is where their
alpha exceeds 0.7. mIoU is the mean over all pairs of a photo and a category labelled on it. A pair without prediction
counts 0; categories that a photo does not show are not asked.

In a rendering of the selection alone, Gaussians that are hidden in the scene are visible, and count as wrong. So we
add `seen`: the mIoU of the pixels where the selection is more than half of the picture of the whole scene. Of
selections that share no Gaussian, at most one is seen at a pixel, and none where nothing covers it.

Source: OpenGaussian (Wu et al. 2024); Dr. Splat Sec. B "3D object selection".
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from ..base.arrays import Float32, Mask, PixelNumbers, RowIds
from ..base.contents import Document
from ..errors import InputError, MismatchError
from ..field.codes import Track, untracked
from ..formats.captures import read_views
from ..formats.json_files import as_object, as_vector, read_json, write_json
from ..formats.lerf_ovs import LabelledFrame, read_lerf_labels
from ..kernels import SplatArrays, render_channels, splat_arrays
from ..scene.gaussians import Gaussians
from ..scene.views import View, same_aspect
from . import scorers
from .predictions import (
    ANSWERED,
    AUTOMATIC,
    FIXED,
    Chooser,
    Manifest,
    columns_of,
    common_columns,
    is_sweep,
    mask_path,
    read_manifests,
    read_mask,
    seen_column,
    shown_columns,
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
    write_json(folder / scene.name / PEAKS, peaks, overwrite=True)


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
    columns = common_columns(manifests)
    rows = {scene.name: _judged(scene, folder, list(columns)) for scene in scenes}
    means, seen = (
        {c: scorers.scene_macro([[row[kind][c] for row in own] for own in rows.values()]) for c in columns}
        for kind in ("iou", "seen")
    )
    shown = shown_columns(columns, means)
    return {
        "protocol": PROTOCOL,
        "method": manifests[0].method,
        "scenes": [_scene_record(*pair) for pair in zip(scenes, manifests, strict=True)],
        "thresholds": {name: columns[source] for name, source in shown.items()},
        "columns": {name: scorers.summary(rows, partial(_numbers, source)) for name, source in shown.items()},
        "sweep": {column: means[column] for column in columns if is_sweep(column)},
        "sweep_seen": {column: seen[column] for column in columns if is_sweep(column)},
        "queries": [
            row | {kind: {name: row[kind][source] for name, source in shown.items()} for kind in ("iou", "seen")}
            for own in rows.values()
            for row in own
        ],
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
    """Write the masks of a selection, alone and within the scene, by column; return the scores' picture.

    Equal selections are rendered once: selections by threshold are nested.
    """
    count, mask = -1, np.zeros((view.height, view.width), bool)
    for column, threshold in sorted(cut.at.items(), key=lambda item: item[1]):
        selected = np.flatnonzero(cut.scores > np.float32(threshold))  # false for NaN
        if len(selected) != count:
            count, mask = len(selected), silhouette(splats, view, selected, threads)
        write_mask(path(column=column), mask)
    whole = _whole_picture(splats, view, cut, threads)
    for column, share in zip(cut.at, whole[1:], strict=True):
        write_mask(path(column=seen_column(column)), share > MAJORITY_SHARE)
    return whole[0]


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


def _judged(scene: LerfScene, folder: Path, columns: Sequence[str]) -> list[Document]:
    """Return for each pair the IoUs by column, alone and within the scene, and whether the peak lies in a box of it.

    IoUs are 0 where there is no prediction, NaN within the scene where predictions have no such masks.
    """
    has_seen = [column for column in columns if (folder / scene.name / seen_column(column)).is_dir()]
    path, rows = folder / scene.name / PEAKS, []
    peaks = as_object(read_json(path), str(path)) if path.is_file() else {}
    for frame, category in scene.pairs:
        place = partial(mask_path, folder, scene.name, frame=frame.name, category=category)
        truth, where = frame.mask(category), f"{path}: {frame.name}"
        peak = as_object(peaks.get(frame.name, {}), where).get(category)
        at = None if peak is None else as_vector(peak, 2, f"{where}: {category[:60]!a}").tolist()
        seen = {column: _iou(place(column=seen_column(column)), truth) for column in has_seen}
        rows.append({
            "scene": scene.name,
            "frame": frame.name,
            "category": category,
            "iou": {column: _iou(place(column=column), truth) for column in columns},
            "seen": {column: seen.get(column, float("nan")) for column in columns},
            "localized": at is not None and scorers.in_any_box(at[0], at[1], frame.boxes[category]),
        })  # fmt: skip
    return rows


def _iou(path: Path, truth: Mask) -> float:
    mask = read_mask(path, truth.shape[1], truth.shape[0])
    return 0.0 if mask is None else scorers.mask_iou(mask, truth)


def _numbers(column: str, rows: list[Document]) -> dict[str, float]:
    ious = [row["iou"][column] for row in rows]
    return {
        "miou": scorers.mean(ious),
        "seen": scorers.mean([row["seen"][column] for row in rows]),
        **{f"acc@{t:g}": scorers.share_above(ious, t) for t in ACCURACY_IOUS},
        "localization": scorers.mean([float(row["localized"]) for row in rows]),
    }


def _scene_record(scene: LerfScene, manifest: Manifest) -> Document:
    leaked = None if manifest.leaked is None else list(manifest.leaked)
    counts = {"frames": len(scene.frames), "pairs": len(scene.pairs)}
    return {"name": scene.name, **counts, "leaked": leaked, "inputs": dict(manifest.inputs)}
