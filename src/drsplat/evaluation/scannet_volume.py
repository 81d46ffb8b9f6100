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

import numpy as np

from ..base.contents import Document
from ..errors import MismatchError
from . import scorers
from .predictions import (
    AUTOMATIC,
    FIXED,
    Manifest,
    common_columns,
    is_sweep,
    read_manifests,
    shown_columns,
    sweep_weighted_ious,
)
from .scannet import (
    ACCURACY_IOUS,
    ANSWER,
    SCORES,
    ScannetScene,
    predict_classes,
    predicted_classes,
    predicted_scores,
    segmentation_document,
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
    columns = common_columns(manifests)
    if FIXED not in columns:
        raise MismatchError(f"'{manifests[0].scene}': the predictions have no fixed threshold")
    located = [_class_ious_by_column(*pair, folder) for pair in zip(scenes, manifests, strict=True)]
    means = {c: scorers.scene_macro([list(s[c].values()) for s in located]) for c in columns}
    shown = shown_columns(columns, means)
    by_name = dict(zip((scene.name for scene in scenes), located, strict=True))
    records = [segmentation(scene, folder) for scene in scenes]
    return segmentation_document(PROTOCOL, scenes, manifests, records) | {
        "thresholds": {name: columns[source] for name, source in shown.items()},
        "localization": {name: _summary(by_name, source) for name, source in shown.items()},
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
    thresholds = manifest.inputs.get("thresholds")
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


def _threshold(thresholds: object, column: str, number: int) -> float:
    """Return a class's threshold; infinity, which selects nothing, if it was not written."""
    value = thresholds.get(column) if isinstance(thresholds, Mapping) else None
    if isinstance(value, Mapping):
        value = value.get(str(number))
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else np.inf


def _summary(by_name: Mapping[str, Mapping[str, Mapping[str, float]]], column: str) -> Document:
    """Return the numbers of a column, with those of each class of each scene."""
    ious = {name: dict(located[column]) for name, located in by_name.items()}
    document = scorers.summary({name: list(classes.values()) for name, classes in ious.items()}, _numbers)
    for name, classes in ious.items():
        document["by_scene"][name]["classes"] = classes
    return document


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
