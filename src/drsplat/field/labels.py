"""Names that people gave to objects, kept beside a field: NAME.labels.json of NAME.field.

Outside of the folder, so that they outlive the field: of one that is made anew they name what overlaps most.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.arrays import Indices, RowIds, Spans, Vector3
from ..errors import FormatError, InputError
from ..formats.json_files import (
    are_rows,
    as_document,
    as_kind,
    count_in,
    ids_of,
    is_text,
    read_json,
    runs_of,
    spans_of,
    spans_of_runs,
    write_json,
)
from ..formats.replacing import claimed_output
from .forest import THING
from .language_field import LanguageField

FORMAT, VERSION = "drsplat labels", 1
MAX_NAME_CHARACTERS = 200
MAX_LABELS = 10_000
SAME_NODE_IOU = 0.5  # of Gaussians, from which on a label names a node


@dataclass(frozen=True, eq=False)
class Label:
    """name: as a person gave it. scene: fingerprint of the Gaussians that are meant.

    spans: which of its rows: from the first number of a pair to before the second, ascending. center: of the named
    object's box, in the world: for people who look for what has gone.

    Raises: InputError: a name that is empty, too long or cannot be written, or no rows.
    """

    name: str
    scene: str
    spans: Spans
    center: Vector3

    @classmethod
    def of(cls, name: str, scene: str, gaussian_ids: RowIds, center: Vector3) -> "Label":
        """Return the label of ascending rows of the scene."""
        return cls(name.strip(), scene, spans_of(gaussian_ids), center)

    def __post_init__(self) -> None:
        if not is_text(self.name) or not self.name.strip() or len(self.name) > MAX_NAME_CHARACTERS:
            raise InputError(f"a name: expected a text of 1 to {MAX_NAME_CHARACTERS} characters, got {self.name!a:.80}")
        if not are_rows(self.spans):
            raise InputError(f"label '{self.name}': expected ascending rows of a scene, one or more")

    def __len__(self) -> int:
        """Return how many Gaussians it names."""
        return count_in(self.spans)

    def is_of(self, field: LanguageField) -> bool:
        """Return True if the label names Gaussians of the field's scene."""
        return self.scene == field.scene and int(self.spans[-1, 1]) <= field.num_gaussians

    def gaussian_ids(self, field: LanguageField) -> Indices:
        """Return the rows of the field's scene, ascending; none where it is of another one."""
        if not self.is_of(field):
            return np.empty(0, np.int64)
        return ids_of(self.spans)

    def means(self, text: str) -> bool:
        """Return whether a text is this name, ignoring case."""
        return same_name(self.name, text)


def same_name(name: str, other: str) -> bool:
    """Return whether two texts are the same but for case and the space around them."""
    return name.strip().casefold() == other.strip().casefold()


class _Entry(NamedTuple):
    """A label in the file; its rows as `runs_of` says."""

    name: str
    scene: str
    center: Vector3
    runs: object


@dataclass(frozen=True)
class LabelFile:
    """The labels beside a field. Every change is whole or not at all, and one writer's at a time."""

    path: Path

    @classmethod
    def beside(cls, field: str | os.PathLike[str]) -> "LabelFile":
        """Return the label file of a field in a folder NAME.field: NAME.labels.json."""
        folder = Path(field)
        name = folder.stem if folder.suffix == ".field" else folder.name
        return cls(folder.with_name(f"{name}.labels.json"))

    def read(self) -> tuple[Label, ...]:
        """Read all of them, of whatever scene; () where there is no file.

        Raises: FormatError: the file is damaged, or written by a newer version.
        """
        if not self.path.exists():
            return ()
        where = str(self.path)
        document = as_document(read_json(self.path), where, FORMAT, VERSION)
        entries = as_kind(document.get("labels"), list[_Entry], f"{where}: labels")
        if len(entries) > MAX_LABELS:
            raise FormatError(f"{where}: expected up to {MAX_LABELS:,} labels, got {len(entries):,}. {_CURE}")
        labels = []
        for number, (name, scene, center, runs) in enumerate(entries):
            try:
                labels.append(Label(name, scene, spans_of_runs(runs, f"{where}: label {number}: runs"), center))
            except InputError as error:
                raise FormatError(f"{where}: label {number}: {error}. {_CURE}") from error
        return tuple(labels)

    def add(self, label: Label, instead: Sequence[Label] = ()) -> tuple[Label, ...]:
        """Keep a label, in place of those that it corrects; returns all there are now.

        Raises: InputError: another process writes the file, or it cannot be written. FormatError: as `read`.
        """
        return self._change(lambda old: any(_same(old, other) for other in instead), (label,))

    def carry(self, labels: Sequence[Label]) -> tuple[Label, ...]:
        """Keep labels that come from another field, in place of those of the same scene and name; return all.

        Raises: as `add`.
        """
        carried = {(label.name, label.scene) for label in labels}
        return self._change(lambda old: (old.name, old.scene) in carried, labels)

    def _change(self, is_replaced: Callable[[Label], bool], more: Sequence[Label]) -> tuple[Label, ...]:
        if not more:
            return self.read()
        with claimed_output(self.path):
            labels = (*(label for label in self.read() if not is_replaced(label)), *more)
            if len(labels) > MAX_LABELS:
                raise InputError(f"{self.path}: has {MAX_LABELS:,} labels, which is the most: remove some")
            entries = [
                _Entry(label.name, label.scene, label.center.tolist(), runs_of(label.spans))._asdict()
                for label in labels
            ]
            document = {"format": FORMAT, "version": VERSION, "labels": entries}
            write_json(self.path, document, overwrite=True, indent=None, ensure_ascii=False, separators=(",", ":"))
        return labels


_CURE = "Restore the file from a copy, or remove it to lose these names"


@dataclass(frozen=True, eq=False)
class Matched:
    """by_node: the label of each node that has one. orphans: labels that name nothing in this field, never dropped."""

    by_node: dict[int, Label]
    orphans: tuple[Label, ...]

    def called(self, name: str) -> list[int]:
        """Return the nodes that people gave this name."""
        return [node for node, label in self.by_node.items() if label.means(name)]


def matched(labels: Sequence[Label], field: LanguageField) -> Matched:
    """Return each label with the node that shares most Gaussians with it, from an IoU of 0.5 on.

    A node has one label and a label one node, the largest overlaps first; of equal ones a thing comes before its
    only part or group. Labels of other scenes are orphans, and all are where the field has no objects.
    """
    found = [
        (-iou, not is_thing, number, node)
        for number, label in enumerate(labels)
        for node, iou, is_thing in _overlaps(label, field)
    ]
    nodes: dict[int, int] = {}
    for _, _, number, node in sorted(found):
        if number not in nodes and node not in nodes.values():
            nodes[number] = node
    orphans = tuple(label for number, label in enumerate(labels) if number not in nodes)
    return Matched({node: labels[number] for number, node in nodes.items()}, orphans)


def _overlaps(label: Label, field: LanguageField) -> list[tuple[int, float, bool]]:
    objects = field.objects
    if objects is None or not label.is_of(field):
        return []
    rows = field.rows_of(label.gaussian_ids(field))
    common = objects.counts(rows[rows >= 0])
    ious = common / np.maximum(objects.sizes + len(label) - common, 1)
    return [
        (int(node), float(ious[node]), bool(objects.levels[node] == THING))
        for node in np.flatnonzero(ious >= SAME_NODE_IOU)
    ]


def _same(one: Label, other: Label) -> bool:
    return (one.name, one.scene) == (other.name, other.scene) and np.array_equal(one.spans, other.spans)
