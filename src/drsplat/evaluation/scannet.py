"""Common parts of the ScanNet protocols: labelled scenes, and predicting a class for every Gaussian."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arrays import Float32, Float64, Int32
from ..errors import FormatError, MismatchError
from ..field.codes import Track, untracked
from ..formats.npy import write_npy
from ..formats.scannet import (
    TABLE_NAME,
    check_vertices,
    raw_category_labels,
    read_label_table,
    read_scannet_instances,
    read_scannet_labels,
    scene_file,
)
from ..scene.gaussians import Gaussians
from . import scorers
from .label_sets import LabelSet
from .predictions import ANSWERED, AUTOMATIC, FIXED, Chooser, Manifest, columns_of, read_array, sweep_column
from .pseudo_labels import LabelledPoints, pseudo_labels
from .scorers import Scorer, hashed

LABELS = "labels.npy"
SCORES, ANSWER = "scores", "answer"  # answer: what a class's own threshold is compared with, if not the scores
ACCURACY_IOUS = (0.15, 0.30, 0.45)


@dataclass(frozen=True, eq=False)
class ScannetScene:
    """Labelled points, classes 1 to C of the label set and 0 for all others, and the Gaussians."""

    name: str
    points: LabelledPoints
    labels: LabelSet
    gaussians: Gaussians

    @cached_property
    def significance(self) -> Float64[np.ndarray, " n"]:
        """Significance d_i = s_x s_y s_z alpha_i.  Source: Dr. Splat Sec. C."""
        volumes = self.gaussians.scales.astype(np.float64).prod(1)
        return np.asarray(volumes * self.gaussians.opacities)

    @cached_property
    def pseudo_labels(self) -> Int32[np.ndarray, " n"]:
        """Class per Gaussian; 0 where other classes win or no point is near."""
        return np.asarray(np.maximum(pseudo_labels(self.gaussians, self.points), 0), np.int32)

    @property
    def inputs(self) -> dict[str, str]:
        """Hashes of the data that is scored."""
        return {
            "gaussians": self.gaussians.fingerprint,
            "points": hashed(self.points.positions),
            "classes": hashed(self.points.labels),
        }


def read_nyu40_scene(folder: Path, labels: LabelSet, gaussians: Gaussians) -> ScannetScene:
    """Read a scene whose classes are the NYU40 ids of `*_vh_clean_2.labels.ply`.

    Raises: InputError: no such folder or file. FormatError: damaged.
    """
    cloud = read_scannet_labels(scene_file(folder, "_vh_clean_2.labels.ply"))
    points = LabelledPoints(cloud.positions, labels.classes(cloud.labels))
    return ScannetScene(folder.resolve().name, points, labels, gaussians)


def read_raw_category_scene(
    folder: Path, labels: LabelSet, gaussians: Gaussians, table: Path | None = None
) -> ScannetScene:
    """Read a scene whose classes are raw category ids (ScanNet-200), by segments and their annotation.

    table: scannetv2-labels.combined.tsv; None looks in the folder, then in the one above.

    Raises: InputError: no such folder or file. FormatError: damaged. MismatchError: segments of
    another mesh than the labelled points.
    """
    cloud = read_scannet_labels(scene_file(folder, "_vh_clean_2.labels.ply"))
    segments, groups = scene_file(folder, ".segs.json"), scene_file(folder, ".aggregation.json")
    instances = read_scannet_instances(segments, groups)
    check_vertices(cloud, instances, str(folder))
    beside = folder / TABLE_NAME
    label_table = read_label_table(table or (beside if beside.is_file() else folder.resolve().parent / TABLE_NAME))
    ids = raw_category_labels(instances, label_table)
    points = LabelledPoints(cloud.positions, labels.classes(ids))
    return ScannetScene(folder.resolve().name, points, labels, gaussians)


def predict_classes(
    scene: ScannetScene,
    scorer: Scorer,
    folder: Path,
    *,
    protocol: str,
    choosers: Mapping[str, tuple[Chooser, str]] | None = None,
    keep_scores: bool = False,
    track: Track = untracked,
) -> None:
    """Write the class of the highest score of every Gaussian, 0 without a feature; ties go to the first.

    keep_scores: also the scores of each class, and thresholds for them.

    Raises: MismatchError: a scorer of another scene.
    """
    if scorer.num_gaussians != len(scene.gaussians):
        raise MismatchError(
            f"'{scorer.name}' scores {scorer.num_gaussians} Gaussians, the scene has {len(scene.gaussians)}"
        )
    place = folder / scene.name
    place.mkdir(parents=True, exist_ok=True)
    count = len(scene.gaussians)
    best, classes = np.full(count, -np.inf, np.float32), np.zeros(count, np.int32)
    chosen = choosers or {}
    answers = scorer.answer if AUTOMATIC in chosen else None
    picked: dict[str, dict[str, float]] = {name: {} for name in chosen}
    numbers = track(range(1, len(scene.labels.prompts) + 1), f"{scene.name}: classes")
    prompts = scene.labels.prompts
    several = zip(numbers, scorer.each(prompts), scorer.compared(prompts), strict=True)
    for number, scores, compared in several:
        higher = compared > best  # false for NaN
        classes[higher], best[higher] = number, compared[higher]
        if keep_scores:
            write_npy(scores_path(folder, scene.name, SCORES, number), scores, overwrite=True)
            for name, (choose, _) in chosen.items():
                picked[name][str(number)] = choose(scores)
            if answers is not None:
                values, threshold = answers(scene.labels.prompts[number - 1])
                write_npy(scores_path(folder, scene.name, ANSWER, number), values, overwrite=True)
                picked[AUTOMATIC][str(number)] = threshold
    write_npy(place / LABELS, classes, overwrite=True)
    columns = {"argmax": "the class of the highest score; no threshold"}
    if keep_scores:
        columns = columns_of(scorer.threshold, scorer.sweep, chosen)
        columns |= {AUTOMATIC: ANSWERED} if answers is not None else {}
    inputs = {
        **scene.inputs,
        "scorer": dict(scorer.about),
        "label_set": scene.labels.name,
        "prompts": list(scene.labels.prompts),
        "thresholds": {FIXED: scorer.threshold, **{sweep_column(t): t for t in scorer.sweep}, **picked},
    }
    Manifest(protocol, scorer.name, scene.name, columns, inputs).write(folder)


def predicted_classes(scene: ScannetScene, folder: Path) -> Int32[np.ndarray, " n"]:
    """Read the classes that `predict_classes` wrote; all 0 where they are missing.

    Raises: FormatError: damaged, or not one class of the label set per Gaussian.
    """
    path = folder / scene.name / LABELS
    classes = read_array(path, len(scene.gaussians), "iu")
    if classes is None:
        return np.zeros(len(scene.gaussians), np.int32)
    if len(classes) and not 0 <= classes.min() <= classes.max() <= len(scene.labels):
        raise FormatError(f"{path}: expected classes 0 to {len(scene.labels)}, got {classes.min()} to {classes.max()}")
    return classes.astype(np.int32)


def scores_path(folder: Path, scene: str, kind: str, number: int) -> Path:
    return folder / scene / f"{kind}_{number:03d}.npy"


def predicted_scores(scene: ScannetScene, folder: Path, kind: str, number: int) -> Float32[np.ndarray, " n"] | None:
    scores = read_array(scores_path(folder, scene.name, kind, number), len(scene.gaussians), "f")
    return None if scores is None else scores.astype(np.float32)


def segmentation_record(
    predicted: scorers.Labels, truth: scorers.Labels, labels: LabelSet, weights: Float64[np.ndarray, " n"] | None = None
) -> dict[str, Any]:
    """Return the means over the classes of the scene, and the numbers of each."""
    ious = scorers.class_ious(predicted, truth, len(labels), weights)
    accuracies = scorers.class_accuracies(predicted, truth, len(labels), weights)
    present = ~np.isnan(ious)
    names = [name for name, there in zip(labels.names, present, strict=True) if there]
    return {
        "miou": scorers.mean_present(ious),
        "macc": scorers.mean_present(accuracies),
        "classes": {
            name: {"iou": float(iou), "acc": float(acc)}
            for name, iou, acc in zip(names, ious[present], accuracies[present], strict=True)
        },
    }


def over_scenes(records: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> dict[str, float]:
    """Return the means over scenes; each scene counts alike."""
    return {key: scorers.mean([record[key] for record in records]) for key in keys}
