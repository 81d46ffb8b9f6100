"""Predictions on disk, which the first half of a protocol writes and the second half reads.

FOLDER/SCENE/predictions.json    protocol, method, thresholds and how they were chosen, inputs
FOLDER/SCENE/COLUMN/...          masks of one choice of thresholds
FOLDER/SCENE/seen COLUMN/...     the same, of the part of the selection that is visible within the scene
FOLDER/SCENE/*.npy               labels and scores
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np
from PIL import Image

from ..base.arrays import Doubles, Flags, Float32, Mask, Numbers, OtherDoubles
from ..errors import FormatError, InputError, MismatchError
from ..formats.json_files import as_kind, excerpt, read_json, write_json
from ..formats.replacing import replacing

MANIFEST = "predictions.json"
MAX_OUTSIDE_GREY = 10  # lighter pixels are inside, as OpenGaussian reads its masks
FIXED, TUNED, SWEEP = "fixed", "tuned on test", "sweep"
AUTOMATIC = "automatic"
ANSWERED = "per query, as `drsplat select` answers"

Chooser = Callable[[Float32[np.ndarray, " N"]], float]
"""Function from a query's scores to a threshold, NaN where there is none; it never sees the truth."""
MIN_MIOU_GAIN = 1e-12


@dataclass(frozen=True)
class Manifest:
    """Record of the predictions for one scene.

    columns: each choice of thresholds, with its description. inputs: hashes and settings.
    leaked: labelled photos that the method was made from, None if unknown.
    """

    protocol: str
    method: str
    scene: str
    columns: Mapping[str, str]
    inputs: Mapping[str, object] = field(default_factory=dict)
    leaked: tuple[str, ...] | None = None

    def write(self, folder: Path) -> None:
        (folder / self.scene).mkdir(parents=True, exist_ok=True)
        write_json(folder / self.scene / MANIFEST, asdict(self), overwrite=True, default=str)


def read_manifest(folder: Path, scene: str, protocols: Sequence[str]) -> Manifest:
    """Read what `Manifest.write` wrote.

    Raises: InputError: nothing was predicted for the scene. FormatError: damaged. MismatchError: of
    another protocol or scene.
    """
    path = folder / scene / MANIFEST
    if not path.is_file():
        raise InputError(f"{path}: there are no predictions of '{scene}': predict before scoring")
    manifest: Manifest = as_kind(read_json(path), Manifest, str(path))
    if manifest.protocol not in protocols or manifest.scene != scene:
        raise MismatchError(
            f"{path}: expected predictions of {' or '.join(protocols)} for '{scene}', got "
            f"{excerpt(manifest.protocol)} for {excerpt(manifest.scene)}"
        )
    outside = [name for name in manifest.columns if set(name) & set("/\\\0") or name.startswith(".")]
    if outside:
        raise FormatError(f"{path}: columns: {excerpt(outside[0])} cannot name a folder")
    return manifest


def read_manifests(folder: Path, scenes: Sequence[str], *protocols: str) -> list[Manifest]:
    """Read the manifest of each scene. Raises: InputError: no scenes; as `read_manifest`."""
    if not scenes:
        raise InputError("expected at least one scene to score")
    return [read_manifest(folder, scene, protocols) for scene in scenes]


def common_columns(manifests: Sequence[Manifest]) -> dict[str, str]:
    """Return the columns of all scenes. Raises: MismatchError: scenes that were predicted in different ways."""
    first, *others = manifests
    for other in others:
        one, two = ((each.method, set(each.columns), each.inputs.get("label_set")) for each in (first, other))
        if one != two:
            raise MismatchError(
                f"'{other.scene}' was predicted by '{other.method}' in another way than '{first.scene}' by "
                f"'{first.method}': predict all scenes in one way, with the same classes and thresholds"
            )
    return dict(first.columns)


def shown_columns(columns: Mapping[str, str], means: Mapping[str, float]) -> dict[str, str]:
    """Return the columns to show by name: those of no sweep, and the best of the sweep as what is tuned on the test."""
    tuned = best_sweep(means)
    return {column: column for column in columns if not is_sweep(column)} | ({TUNED: tuned} if tuned else {})


def columns_of(threshold: float, sweep: Sequence[float], choosers: Mapping[str, tuple[Chooser, str]]) -> dict[str, str]:
    """Return each choice of thresholds, with its description."""
    fixed = {FIXED: f"{threshold:g} for all queries, chosen without these scenes"}
    chosen = {name: how for name, (_, how) in choosers.items()}
    return fixed | chosen | {sweep_column(t): f"{t:g} for all queries" for t in sweep}


def sweep_column(threshold: float) -> str:
    return f"{SWEEP} {threshold:.3f}"


def seen_column(column: str) -> str:
    """Return the folder name for masks of a selection as visible within the whole scene."""
    return f"seen {column}"


def is_sweep(column: str) -> bool:
    return column.startswith(f"{SWEEP} ")


def mask_path(folder: Path, scene: str, column: str, frame: str, category: str) -> Path:
    """Return FOLDER/SCENE/COLUMN/frame_00041_category.png, as OpenGaussian names its files."""
    safe = quote(category, safe=" '(),&+!-._")
    return folder / scene / column / f"{frame}_{safe}.png"


def write_mask(path: Path, mask: Mask) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, overwrite=True) as file:
        Image.fromarray(mask.astype(np.uint8) * 255).save(file, "PNG", compress_level=1)


def read_mask(path: Path, width: int, height: int) -> Mask | None:
    """Read a predicted mask; None where nothing was predicted.

    Raises: FormatError: not a picture, or of another size: predictions are never resized.
    """
    if not path.is_file():
        return None
    try:
        with Image.open(path, formats=("PNG",)) as picture:
            size = picture.size
            if size == (width, height):
                pixels = np.asarray(picture.convert("L"))
    except Exception as error:  # decoders of damaged files raise anything
        raise FormatError(f"{path}: cannot be read as a PNG: {error}") from error
    if size != (width, height):
        raise FormatError(f"{path}: expected {width}x{height} pixels as labelled, got {size[0]}x{size[1]}")
    return pixels > MAX_OUTSIDE_GREY


def read_array(path: Path, count: int, kinds: str) -> np.ndarray | None:
    """Map one value per Gaussian or point; None where nothing was predicted.

    Raises: FormatError: damaged, or another shape or type.
    """
    from ..formats.npy import map_npy

    if not path.is_file():
        return None
    array = map_npy(path)
    if array.shape != (count,) or array.dtype.kind not in kinds:
        raise FormatError(f"{path}: expected {count} values, got {array.dtype} {array.shape}")
    return array


def best_sweep(means: Mapping[str, float]) -> str | None:
    """Return the sweep's column with the best mean over the scenes; the lowest threshold of equal ones.

    Source: Dr. Splat Sec. B: "searching the thresholds that show the best mIoU on the scenes used
    for evaluation". One for all scenes and queries.
    """
    best: str | None = None
    for column in sorted(column for column in means if is_sweep(column)):
        if best is None or means[column] > means[best] + MIN_MIOU_GAIN:
            best = column
    return best


def sweep_weighted_ious(scores: Numbers, truth: Flags, weights: Doubles, thresholds: Sequence[float]) -> OtherDoubles:
    """Return Eq. 3's IoU of {score > t} for each threshold t, in one pass over the Gaussians.

    A score of NaN is above no threshold.

    >>> sweep_weighted_ious(
    ...     np.array([0.9, 0.6, 0.2, np.nan], np.float32), np.array([True, False, True, True]),
    ...     np.array([1.0, 2.0, 1.0, 4.0]), [0.5, 0.7])
    array([0.125     , 0.16666667])
    """
    edges = np.sort(np.asarray(thresholds, np.float32))
    above = np.searchsorted(edges, np.nan_to_num(scores, nan=-np.inf), side="left")
    size = len(edges) + 1
    both = np.bincount(above[truth], weights[truth], size).astype(float)
    only = np.bincount(above[~truth], weights[~truth], size).astype(float)
    selected_true = np.cumsum(both[::-1])[::-1][1:]  # above edge k: passed more than k edges
    selected_other = np.cumsum(only[::-1])[::-1][1:]
    union = both.sum() + selected_other
    ious = np.divide(selected_true, union, out=np.zeros(len(edges)), where=union > 0)
    return ious[np.searchsorted(edges, np.asarray(thresholds, np.float32))]
