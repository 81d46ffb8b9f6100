"""Common parts of the ScanNet protocols: sets of classes, labelled scenes, and a class for every Gaussian."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import numpy as np

from ..base.arrays import Doubles, Ids, Numbers, WholeNumbers
from ..base.contents import Document, file_text
from ..errors import FormatError, InputError, MismatchError
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
from .predictions import ANSWERED, AUTOMATIC, FIXED, Chooser, Manifest, columns_of, read_array, sweep_column
from .pseudo_labels import LabelledPoints, pseudo_labels
from .scorers import Scorer, hashed

BUILT_IN = ("scannet19", "scannet15", "scannet10", "scannet200", "household")
MAX_ID = 1 << 20


@dataclass(frozen=True, eq=False)
class LabelSet:
    """C classes, in this order. Class k of a prediction, 1 to C, is `names[k - 1]`.

    ids: in the data's files. prompts: the texts that are embedded.

    Raises: InputError: no class, lists of different lengths, an id or a name twice.
    """

    name: str
    ids: tuple[int, ...]
    names: tuple[str, ...]
    prompts: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.ids or not len(self.ids) == len(self.names) == len(self.prompts):
            raise InputError(f"label set '{self.name}': expected an id, a name and a prompt per class")
        for values in (self.ids, self.names):
            twice = [value for k, value in enumerate(values) if value in values[:k]]
            if twice:
                raise InputError(f"label set '{self.name}': {twice[0]!r} occurs twice")
        if not all(0 < number <= MAX_ID for number in self.ids):
            raise InputError(f"label set '{self.name}': ids must be 1 to {MAX_ID}")

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def _class_of(self) -> Ids:
        table = np.zeros(max(self.ids) + 1, np.int32)
        table[list(self.ids)] = np.arange(1, len(self) + 1)
        return table

    def classes(self, ids: WholeNumbers) -> Ids:
        """Return 1 to C for the ids of the set, 0 for all others."""
        in_table = (ids >= 0) & (ids < len(self._class_of))
        return np.where(in_table, self._class_of[np.where(in_table, ids, 0)], 0).astype(np.int32)

    def prompted(self, template: str) -> "LabelSet":
        """Return the same classes with prompts from a template: "a photo of a {}"."""
        if "{}" not in template:
            raise InputError(f"prompt template: expected '{{}}' in it, got {template!r}")
        prompts = tuple(template.replace("{}", name) for name in self.names)
        return LabelSet(self.name, self.ids, self.names, prompts)


def label_set(name: str) -> LabelSet:
    """Return a built-in label set, or read one from a file of lines "id<TAB>name[<TAB>prompt]".

    scannet19, scannet15, scannet10: NYU40 ids and the prompts of OpenGaussian.
    scannet200: raw category ids. household: NYU40 ids of the rendered test rooms.

    Raises: InputError: neither a name nor a file. FormatError: the message names the line.
    """
    if name in BUILT_IN:
        text = (files(__package__) / "label_sets.tsv").read_text(encoding="utf-8")
        rows = [line.split("\t") for line in text.splitlines()[1:]]
        return _label_set(name, [row[1:] for row in rows if row[0] == name])
    path = Path(name)
    if not path.is_file():
        raise InputError(f"label set '{name}': expected one of {', '.join(BUILT_IN)}, or a .tsv file")
    return _label_set(path.stem, _rows_of(path))


def _rows_of(path: Path) -> list[list[str]]:
    try:
        lines = file_text(path).splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: expected UTF-8: {error}") from error
    rows = []
    for number, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in line.split("\t")]
        if line.startswith("#") or not line.strip() or cells[0] == "id":
            continue
        is_id = cells[0].isascii() and cells[0].isdecimal() and len(cells[0]) < 8
        if not is_id or len(cells) not in (2, 3) or not all(cells):
            raise FormatError(f"{path}: line {number}: expected id, name and optionally prompt; tabs between")
        rows.append(cells)
    return rows


def _label_set(name: str, rows: Sequence[Sequence[str]]) -> LabelSet:
    return LabelSet(
        name, tuple(int(row[0]) for row in rows), tuple(row[1] for row in rows), tuple(row[-1] for row in rows)
    )


LABELS = "labels.npy"
SCORES, ANSWER = "scores", "answer"  # answer: what a class's own threshold is compared with, if not the scores
ARGMAX, ARGMAX_RULE = "argmax", "the class of the highest score; no threshold"
ACCURACY_IOUS = (0.15, 0.30, 0.45)


@dataclass(frozen=True, eq=False)
class ScannetScene:
    """Labelled points, classes 1 to C of the label set and 0 for all others, and the Gaussians."""

    name: str
    points: LabelledPoints
    labels: LabelSet
    gaussians: Gaussians

    @cached_property
    def significance(self) -> Doubles:
        """Significance d_i = s_x s_y s_z alpha_i.  Source: Dr. Splat Sec. C."""
        volumes = self.gaussians.scales.astype(np.float64).prod(1)
        return volumes * self.gaussians.opacities

    @cached_property
    def pseudo_labels(self) -> Ids:
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
    columns = {ARGMAX: ARGMAX_RULE}
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


def predicted_classes(scene: ScannetScene, folder: Path) -> Ids:
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


def predicted_scores(scene: ScannetScene, folder: Path, kind: str, number: int) -> Numbers | None:
    scores = read_array(scores_path(folder, scene.name, kind, number), len(scene.gaussians), "f")
    return None if scores is None else scores.astype(np.float32)


def segmentation_record(
    predicted: scorers.Labels, truth: scorers.Labels, labels: LabelSet, weights: Doubles | None = None
) -> Document:
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


def segmentation_document(
    protocol: str, scenes: Sequence[ScannetScene], manifests: Sequence[Manifest], records: Sequence[Document]
) -> Document:
    """Return the document of a protocol, with the means over scenes, which count alike, of each scene's record."""
    return {
        "protocol": protocol,
        "method": manifests[0].method,
        "label_set": scenes[0].labels.name,
        "thresholds": {ARGMAX: ARGMAX_RULE},
        "segmentation": {
            "scene_macro": {key: scorers.mean([record[key] for record in records]) for key in ("miou", "macc")},
            "by_scene": {scene.name: record for scene, record in zip(scenes, records, strict=True)},
        },
        "scenes": [{"name": manifest.scene, "inputs": dict(manifest.inputs)} for manifest in manifests],
    }
