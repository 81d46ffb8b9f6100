"""Classes of a protocol: ids in the data's files, names, and prompts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import numpy as np

from ..base.arrays import Int32, Integer, Numbers
from ..base.contents import file_text
from ..errors import FormatError, InputError

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
    def _class_of(self) -> Int32[np.ndarray, " i"]:
        table = np.zeros(max(self.ids) + 1, np.int32)
        table[list(self.ids)] = np.arange(1, len(self) + 1)
        return table

    def classes(self, ids: Integer[np.ndarray, " n"]) -> Numbers:
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
