"""scannet-volume@1: the paper's protocol for Gaussians that trained freely.

Gaussians get pseudo labels from the labelled points near them (`pseudo_labels`), and count by their
significance s_x s_y s_z alpha (Eq. 3). Gaussians whose pseudo label is no class of the set, or that no
point is near, are left out of prediction and truth. Segmentation: the class of the highest score.
Localization: for each class of a scene, the Gaussians that score above a threshold.

Source: Dr. Splat Sec. B-C.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..base.contents import Document
from ..errors import MismatchError
from . import scorers
from .predictions import AUTOMATIC, FIXED, TUNED, Manifest, best_sweep, is_sweep, read_manifests, sweep_weighted_ious
from .scannet import (
    ACCURACY_IOUS,
    ANSWER,
    SCORES,
    ScannetScene,
    over_scenes,
    predict_classes,
    predicted_classes,
    predicted_scores,
    segmentation_record,
)

PROTOCOL = "scannet-volume@1"

predict = partial(predict_classes, protocol=PROTOCOL, keep_scores=True)


def score(scenes: Sequence[ScannetScene], folder: Path) -> Document:
    """Score the predictions in a folder. Missing ones count as nothing selected: 0.

    Raises: InputError: no scene, or one without predictions. MismatchError: scenes predicted in
    different ways. FormatError: damaged predictions.
    """
    manifests = read_manifests(folder, [scene.name for scene in scenes], PROTOCOL)
    columns = _common_columns(manifests)
    segmented = {scene.name: segmentation(scene, folder) for scene in scenes}
    located = [
        _class_ious_by_column(scene, manifest, folder) for scene, manifest in zip(scenes, manifests, strict=True)
    ]
    means = {c: scorers.scene_macro([list(s[c].values()) for s in located]) for c in columns}
    tuned = best_sweep(means)
    shown = {c: c for c in columns if not is_sweep(c)} | ({TUNED: tuned} if tuned else {})
    names = [scene.name for scene in scenes]
    return {
        "protocol": PROTOCOL,
        "method": manifests[0].method,
        "label_set": scenes[0].labels.name,
        "thresholds": {name: columns[source] for name, source in shown.items()},
        "segmentation": {"scene_macro": over_scenes(list(segmented.values()), ("miou", "macc")), "by_scene": segmented},
        "localization": {name: _summary(names, [scene[source] for scene in located]) for name, source in shown.items()},
        "sweep": {column: means[column] for column in columns if is_sweep(column)},
        "scenes": [_scene_record(*pair) for pair in zip(scenes, manifests, strict=True)],
    }


def segmentation(scene: ScannetScene, folder: Path, *, weighted: bool = True) -> Document:
    """Score the segmentation by Eq. 3; if not weighted, every Gaussian counts alike (the left of Fig. S3)."""
    weights = scene.significance if weighted else None
    return segmentation_record(predicted_classes(scene, folder), scene.pseudo_labels, scene.labels, weights)


def _class_ious_by_column(scene: ScannetScene, manifest: Manifest, folder: Path) -> dict[str, dict[str, float]]:
    """Return the IoU of the classes that the scene has, by column and name."""
    truth, counted = scene.pseudo_labels, scene.pseudo_labels > 0
    weights = scene.significance[counted]
    thresholds = manifest.inputs.get("thresholds", {})
    ious_by_column: dict[str, dict[str, float]] = {column: {} for column in manifest.columns}
    for number in np.unique(truth[counted]).tolist():
        name, scores = scene.labels.names[number - 1], predicted_scores(scene, folder, SCORES, number)
        at = [_threshold(thresholds, column, number) for column in manifest.columns]
        ious = np.zeros(len(at))
        if scores is not None:
            is_class = truth[counted] == number
            ious = sweep_weighted_ious(scores[counted], is_class, weights, at)
            values = predicted_scores(scene, folder, ANSWER, number)
            if AUTOMATIC in ious_by_column and values is not None:
                own = list(manifest.columns).index(AUTOMATIC)
                cut = sweep_weighted_ious(values[counted], is_class, weights, [at[own]])
                ious[own] = cut[0]
        for column, iou in zip(manifest.columns, ious.tolist(), strict=True):
            ious_by_column[column][name] = iou
    return ious_by_column


def _threshold(thresholds: Mapping[str, Any], column: str, number: int) -> float:
    """Return a class's threshold; infinity, which selects nothing, if it was not written."""
    value = thresholds.get(column) if isinstance(thresholds, Mapping) else None
    if isinstance(value, Mapping):
        value = value.get(str(number))
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else np.inf


def _common_columns(manifests: Sequence[Manifest]) -> dict[str, str]:
    first = manifests[0]
    for other in manifests[1:]:
        same_sets = other.inputs.get("label_set") == first.inputs.get("label_set")
        if dict(other.columns) != dict(first.columns) or other.method != first.method or not same_sets:
            raise MismatchError(
                f"'{other.scene}' was predicted by '{other.method}' in another way than '{first.scene}' by "
                f"'{first.method}': predict all scenes with the same classes and thresholds"
            )
    if FIXED not in first.columns:
        raise MismatchError(f"'{first.scene}': the predictions have no fixed threshold")
    return dict(first.columns)


def _summary(names: Sequence[str], by_scene: Sequence[Mapping[str, float]]) -> Document:
    records = [_numbers(list(classes.values())) for classes in by_scene]
    pooled = [iou for classes in by_scene for iou in classes.values()]
    return {
        "scene_macro": over_scenes(records, list(_numbers([]))),
        "query_micro": _numbers(pooled),
        "by_scene": {
            name: {**record, "classes": dict(classes)}
            for name, record, classes in zip(names, records, by_scene, strict=True)
        },
    }


def _numbers(ious: list[float]) -> dict[str, float]:
    shares = {f"iou>{t:.2f}": scorers.share_above(ious, t) for t in ACCURACY_IOUS}
    return {"miou": scorers.mean(ious), **shares}


def _scene_record(scene: ScannetScene, manifest: Manifest) -> Document:
    labelled = scene.pseudo_labels > 0
    return {
        "name": scene.name,
        "gaussians": len(scene.gaussians),
        "labelled": int(labelled.sum()),
        "labelled_significance": float(scene.significance[labelled].sum() / max(scene.significance.sum(), 1e-300)),
        "classes": len(np.unique(scene.pseudo_labels[labelled])),
        "inputs": dict(manifest.inputs),
    }
