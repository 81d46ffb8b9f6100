"""ScanNet's files: a labelled cloud, instances by segments, and the table of raw categories.

    SCENE/SCENE_vh_clean_2.labels.ply             vertex: x y z, ..., label (NYU40)
    SCENE/SCENE_vh_clean_2.0.010000.segs.json     {"segIndices": [segment of each vertex]}
    SCENE/SCENE.aggregation.json                  {"segGroups": [{"objectId", "segments", "label"}]}
    scannetv2-labels.combined.tsv                 id, raw_category, nyu40id, ...

Source: Dai et al. 2017 (ScanNet), its README; Rozenberszki et al. 2022 (ScanNet200).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Ids, Vectors
from ..base.contents import file_bytes, file_text
from ..errors import FormatError, InputError, MismatchError
from .json_files import as_fields, read_json
from .ply import gather, read_elements, read_header

MAX_LABEL = 1 << 20
MAX_TABLE_BYTES = 1 << 26
TABLE_NAME = "scannetv2-labels.combined.tsv"


@dataclass(frozen=True, eq=False)
class LabelledCloud:
    """World positions in metres and a label of each, 0 for none."""

    positions: Vectors
    labels: Ids


@dataclass(frozen=True, eq=False)
class Instances:
    """Annotated objects of a scan. objects: index into `names` of each vertex, or -1.

    names: the raw category of each object.
    """

    objects: Ids
    names: tuple[str, ...]


class _Group(NamedTuple):
    label: str
    segments: object


def scene_file(scene: Path, ending: str) -> Path:
    """Return SCENE/SCENE_ending or the only file of that ending.

    Raises: InputError: there is none, or several and none is named after the folder.
    """
    if not scene.is_dir():
        raise InputError(f"{scene}: expected the folder of a ScanNet scene")
    found = sorted(scene.glob(f"*{ending}"))
    named = [path for path in found if path.name == f"{scene.resolve().name}{ending}"]
    if len(named or found) != 1:
        listed = ", ".join(path.name for path in found[:4]) or "none"
        raise InputError(f"{scene}: expected one file {scene.resolve().name}{ending}, found {listed}")
    return (named or found)[0]


def read_scannet_labels(path: Path) -> LabelledCloud:
    """Read the vertices of a `_vh_clean_2.labels.ply`.

    Raises: InputError: there is no such file. FormatError: damaged, no `label`, positions that are not finite.
    """
    rows = _vertices(path)
    if "label" not in (rows.dtype.names or ()):
        raise FormatError(f"{path}: vertex has no property 'label': expected *_vh_clean_2.labels.ply")
    if rows.dtype["label"].kind not in "iu":
        raise FormatError(f"{path}: label: expected whole numbers, got {rows.dtype['label']}")
    labels = rows["label"].astype(np.int64)
    if len(labels) and not 0 <= labels.min() <= labels.max() <= MAX_LABEL:
        raise FormatError(f"{path}: label: expected 0 to {MAX_LABEL}, got {labels.min()} to {labels.max()}")
    missing = [name for name in "xyz" if name not in (rows.dtype.names or ())]
    if missing:
        raise FormatError(f"{path}: vertex has no {', '.join(missing)}")
    with np.errstate(over="ignore", invalid="ignore"):
        positions = gather(rows, ["x", "y", "z"])
    bad = np.flatnonzero(~np.isfinite(positions).all(1))
    if len(bad):
        raise FormatError(f"{path}: vertex {bad[0]}: expected a finite position")
    return LabelledCloud(positions, labels.astype(np.int32))


def read_scannet_instances(segments: Path, aggregation: Path) -> Instances:
    """Read the object of each vertex, from `.segs.json` and `.aggregation.json`.

    Raises: InputError: there is no such file. FormatError: damaged; the message names the group and the field.
    """
    of_vertex = _whole(
        as_fields(read_json(segments), str(segments), segIndices=object)["segIndices"], f"{segments}: segIndices"
    )
    groups = as_fields(read_json(aggregation), str(aggregation), segGroups=list[_Group])["segGroups"]
    present, inverse = np.unique(of_vertex, return_inverse=True)
    owner = np.full(len(present), -1, np.int32)
    for index, group in enumerate(groups):
        members = _whole(group.segments, f"{aggregation}: segGroups: {index} ({group.label[:60]!a}): segments")
        owner[np.isin(present, members)] = index
    return Instances(owner[inverse.reshape(-1)], tuple(group.label for group in groups))


def read_label_table(path: Path) -> dict[str, int]:
    """Return the category id of each raw category of `scannetv2-labels.combined.tsv`.

    Raises: InputError: there is no such file. FormatError: no such table; the message names the line.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: it comes with ScanNet's annotations")
    if path.stat().st_size > MAX_TABLE_BYTES:
        raise FormatError(f"{path}: too large for a table of categories")
    try:
        lines = file_text(path).splitlines()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: expected UTF-8: {error}") from error
    heading = lines[0].split("\t") if lines else []
    if "id" not in heading or "raw_category" not in heading:
        raise FormatError(f"{path}: line 1: expected columns 'id' and 'raw_category'")
    at, named = heading.index("id"), heading.index("raw_category")
    table: dict[str, int] = {}
    for number, line in enumerate(lines[1:], 2):
        cells = line.split("\t")
        if len(cells) <= max(at, named) or not (cells[at].isdecimal() and cells[at].isascii()):
            raise FormatError(f"{path}: line {number}: id: expected a whole number in column {at + 1}")
        if len(cells[at]) > 7 or int(cells[at]) > MAX_LABEL:
            raise FormatError(f"{path}: line {number}: id: expected at most {MAX_LABEL}")
        table.setdefault(cells[named], int(cells[at]))
    return table


def raw_category_labels(instances: Instances, table: Mapping[str, int]) -> Ids:
    """Return the category id of each vertex's object; 0 without one, or where the table has no such name."""
    ids = np.array([table.get(name, 0) for name in instances.names] + [0], np.int32)
    return ids[instances.objects]


def check_vertices(cloud: LabelledCloud, instances: Instances, where: str) -> None:
    """Refuse segments of another mesh. Raises: MismatchError."""
    if len(cloud.labels) != len(instances.objects):
        raise MismatchError(
            f"{where}: {len(cloud.labels)} labelled vertices but segments of {len(instances.objects)}: "
            "take both files from one scan, of the mesh vh_clean_2"
        )


def _vertices(path: Path) -> np.ndarray:
    data = file_bytes(path).data
    if not data.nbytes:
        raise FormatError(f"{path}: the file is empty")
    try:
        return read_elements(data, read_header(data), {"vertex"})["vertex"]
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error


def _whole(numbers: object, where: str) -> np.ndarray:
    """Return numbers of segments, millions of them."""
    if not isinstance(numbers, list) or not all(type(item) is int and abs(item) < 1 << 62 for item in numbers):
        raise FormatError(f"{where}: expected a list of whole numbers of segments")
    return np.array(numbers, np.int64)
