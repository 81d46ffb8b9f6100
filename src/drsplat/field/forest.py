"""Objects: a forest of parts, things and groups over the rows of a field (docs/objects.md)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base.arrays import (
    Arrays,
    Bool,
    ByteValues,
    Embeddings,
    Flags,
    Float32,
    Ids,
    Indices,
    Int32,
    Matrices,
    Numbers,
    OtherFlags,
    OtherIds,
    OtherIndices,
    Points,
    RowIds,
    WholeNumbers,
)
from ..base.terminal import counted, numbers_text, rows_html
from ..errors import InputError

PART, THING, GROUP = 0, 1, 2
LEVELS = ("part", "thing", "group")
VOTED, JOINED = "voted", "joined"
MAX_MASKS_PER_NODE = 32
MAX_DESCRIPTORS_PER_NODE = 4
LENGTH_TOLERANCE = 1e-3
ORTHONORMAL_TOLERANCE = 1e-4
MAX_ROWS_SHOWN = 20  # in a notebook
MAX_NUMBER = 3.4e38  # of float32

ARRAYS = {
    "node_of": ("int32", "R"), "parents": ("int32", "T"), "levels": ("uint8", "T"), "sure": ("float32", "T"),
    "centers": ("float64", "T 3"), "axes": ("float64", "T 3 3"), "extents": ("float64", "T 3"),
    "masses": ("float32", "T"), "num_views": ("int32", "T"),
    "mask_starts": ("int64", "T1"), "masks": ("int32", "E"), "shares": ("float32", "E"),
    "descriptor_starts": ("int64", "T1"), "descriptors": ("float32", "P D"),
}  # fmt: skip
"""Dtype and dimensions of each array, in memory and on disk."""
RANGES = {
    "centers": (-MAX_NUMBER, MAX_NUMBER, "finite numbers"), "axes": (-2, 2, "unit vectors"),
    "extents": (0, MAX_NUMBER, "finite lengths of 0 or more"), "sure": (0, 1, "numbers from 0 to 1"),
    "masses": (0, MAX_NUMBER, "finite numbers of 0 or more"), "num_views": (0, np.inf, "counts"),
    "masks": (0, np.inf, "columns of the evidence"), "shares": (0, 1 + LENGTH_TOLERANCE, "numbers from 0 to 1"),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Objects:
    """A forest of what belongs together: parts, things and groups of a scene, found across photos.

    Node t has parents[t] > t, or -1. levels: 0 part, 1 thing, 2 group: on each way from a leaf to a root there are
    parts, then at most one thing, then groups. node_of: per row of the field the smallest node that it belongs to,
    -1 for none. sure: consensus of the photos in [0, 1]. centers, axes, extents: boxes as of `Match`, in the world,
    upright where the field knows what is up. masses: opacity summed. num_views: photos that see it.
    mask_starts, masks, shares: per node up to 32 columns of the evidence, with their shares of the node's weight,
    largest first. descriptor_starts, descriptors: per node up to 4 unit embeddings, of the most masks first. votes:
    VOTED where photos voted on what is one thing; JOINED where further ones have joined since, and not voted yet.

    Raises: InputError: arrays that are not so, or do not fit each other.
    """

    node_of: Int32[np.ndarray, " R"]
    parents: Ids
    levels: ByteValues
    sure: Numbers
    centers: Points
    axes: Matrices
    extents: Points
    masses: Numbers
    num_views: Ids
    mask_starts: OtherIndices
    masks: OtherIds
    shares: Float32[np.ndarray, " k"]
    descriptor_starts: OtherIndices
    descriptors: Float32[np.ndarray, "P D"]
    votes: str = ""

    def __post_init__(self) -> None:
        self._check_shapes()
        check_forest(self.node_of, self.parents, self.levels)
        for name, (low, high, expected) in RANGES.items():
            values = getattr(self, name)
            _check_all((values >= low) & (values <= high), f"{name}: expected {expected}")  # NaN is not
        products = np.einsum("tik,tjk->tij", self.axes, self.axes)
        _check_all(np.abs(products - np.eye(3)) < ORTHONORMAL_TOLERANCE, "axes: expected unit vectors at right angles")
        _check_starts("masks", self.mask_starts, len(self.masks), MAX_MASKS_PER_NODE)
        _check_starts("descriptors", self.descriptor_starts, len(self.descriptors), MAX_DESCRIPTORS_PER_NODE)
        _check_all(np.isin(self.votes, ("", VOTED, JOINED)), "votes: expected voted, joined or nothing")
        lengths = np.sqrt(np.einsum("pd,pd->p", self.descriptors, self.descriptors))
        _check_all(np.abs(lengths - 1) <= LENGTH_TOLERANCE, "descriptors: expected finite unit vectors")

    def __repr__(self) -> str:
        kinds = (int(np.count_nonzero(self.levels == level)) for level in (PART, GROUP))
        parts, groups = (counted(number, LEVELS[level]) for number, level in zip(kinds, (PART, GROUP), strict=True))
        return f"Objects({len(self)}, with {parts} and {groups})"

    def _repr_html_(self) -> str:
        names = ("object", "photos", "agreement", "mass", "centre", "size")
        rows = (
            (number, int(self.num_views[node]), f"{self.sure[node]:.2f}", f"{self.masses[node]:.1f}",
             numbers_text(self.centers[node]), numbers_text(self.extents[node]))
            for number, node in enumerate(self.things[:MAX_ROWS_SHOWN].tolist())
        )  # fmt: skip
        return rows_html(repr(self), names, rows, len(self))

    def __len__(self) -> int:
        """Return how many things there are."""
        return len(self.things)

    @property
    def num_nodes(self) -> int:
        return len(self.parents)

    @cached_property
    def things(self) -> Indices:
        """The nodes of things; object 0, 1, ... of people are these, the largest mass first."""
        nodes = np.flatnonzero(self.levels == THING)
        return nodes[np.argsort(-self.masses[nodes], kind="stable")]

    @cached_property
    def number_of(self) -> Ids:
        """Per node the number of the thing that it is, or is a part of; -1 for none."""
        numbers = np.full(self.num_nodes, -1, np.int32)
        numbers[self.things] = np.arange(len(self.things), dtype=np.int32)
        return np.append(numbers, np.int32(-1))[owner_nodes(self.parents, numbers >= 0)]

    def thing_of(self, rows: WholeNumbers | slice = slice(None)) -> Ids:
        """Return per row of the field, or of some, the number of the thing that it belongs to, -1 for none."""
        return np.append(self.number_of, np.int32(-1))[self.node_of[rows]]

    def piece_of(self) -> Ids:
        """Return per row of the field the part right below a thing that it belongs to, -1 for none."""
        return self._belonging(self._right_below)

    def single_of(self) -> Ids:
        """Return per row of the field the node that answers as a whole, -1 for loose rows.

        That is its thing, or the part right below a thing that is nothing but its parts, as one joined from pieces is.
        """
        has_own = np.bincount(self.node_of[self.node_of >= 0], minlength=self.num_nodes) > 0
        return self._belonging((self.levels == THING) & has_own | self._right_below & ~has_own[self.parents])

    @property
    def _right_below(self) -> Flags:
        """Parts of a thing that are no parts of another part."""
        return (self.parents >= 0) & (self.levels == PART) & (self.levels[self.parents] == THING)

    def _belonging(self, chosen: OtherFlags) -> Ids:
        """Return per row the chosen node that it belongs to, -1 for none."""
        return np.append(owner_nodes(self.parents, chosen), -1)[self.node_of].astype(
            np.int32
        )  # the last one is that of -1

    def rows(self, node: int) -> Indices:
        """Return the rows of the field in a node and in all below it, ascending.

        Raises: InputError: no such node.
        """
        order, starts = self._by_node
        children, first = self._by_parent
        within = [self._checked(node)]
        for one in within:  # which grows meanwhile
            within += children[first[one] : first[one + 1]].tolist()
        return np.sort(np.concatenate([order[starts[one] : starts[one + 1]] for one in within]))

    @cached_property
    def _by_parent(self) -> tuple[OtherIndices, Indices]:
        """The nodes in the order of their parents, and where those of each parent begin."""
        return by_number(self.parents, self.num_nodes)

    @cached_property
    def _by_node(self) -> tuple[OtherIndices, Indices]:
        """The rows in the order of their nodes, and where those of each node begin."""
        return by_number(self.node_of, self.num_nodes)

    def counts(self, rows: RowIds) -> Indices:
        """Return per node how many of some rows belong to it or to a node below it."""
        nodes = self.node_of[rows]
        return with_those_below(self.parents, np.bincount(nodes[nodes >= 0], minlength=self.num_nodes))

    @cached_property
    def sizes(self) -> Indices:
        """Rows of each node."""
        return self.counts(np.arange(len(self.node_of)))

    def above(self, node: int) -> int | None:
        """Return the node that this one is a part or member of. Raises: InputError: no such node."""
        parent = int(self.parents[self._checked(node)])
        return None if parent < 0 else parent

    def below(self, node: int) -> list[int]:
        """Return the nodes that this one is made of, ascending. Raises: InputError: no such node."""
        return np.flatnonzero(self.parents == self._checked(node)).tolist()

    def path(self, row: int) -> list[int]:
        """Return the nodes that a row of the field belongs to, smallest first: parts, thing, groups; [] for none.

        Raises: InputError: no such row.
        """
        if not 0 <= row < len(self.node_of):
            raise InputError(f"row {row} of a field of {len(self.node_of)}")
        node, path = int(self.node_of[row]), []
        while node >= 0:
            path.append(node)
            node = int(self.parents[node])
        return path

    def thing(self, number: int) -> int:
        """Return the node of object 0, 1, ...

        Raises: InputError: there is none of that number.
        """
        if not 0 <= number < len(self):
            known = f"there are 0 to {len(self) - 1}" if len(self) else "this field has none"
            raise InputError(f"there is no object {number}: {known}")
        return int(self.things[number])

    def masks_of(self, node: int) -> tuple[Ids, Numbers]:
        """Return the evidence's columns that speak for a node, with their shares. Raises: InputError: no such node."""
        part = slice(*self.mask_starts[self._checked(node) :][:2])
        return self.masks[part], self.shares[part]

    def descriptors_of(self, node: int) -> Embeddings:
        """Return the unit embeddings of a node. Raises: InputError: no such node."""
        return self.descriptors[slice(*self.descriptor_starts[self._checked(node) :][:2])]

    def tensors(self) -> Arrays:
        """Return its arrays by name, as they are written to files."""
        return {name: getattr(self, name) for name in ARRAYS}

    def check_field(self, rows: int, dim: int, masks: int | None) -> None:
        """Refuse those of another field. masks: columns of its evidence, None where it has none.

        Raises: InputError.
        """
        if len(self.node_of) != rows:
            raise InputError(f"objects: expected a node for each of {rows} rows, got {len(self.node_of)}")
        if len(self.descriptors) and self.descriptors.shape[1] != dim:
            raise InputError(f"objects: descriptors of {self.descriptors.shape[1]} numbers in a field of {dim}")
        if masks is not None and self.masks.max(initial=-1) >= masks:
            raise InputError(f"objects: masks up to {self.masks.max()} of evidence of {masks}")

    def _checked(self, node: int) -> int:
        if not 0 <= node < self.num_nodes:
            raise InputError(f"node {node} of {self.num_nodes}")
        return node

    def _check_shapes(self) -> None:
        known = {"T1": len(self.parents) + 1, "3": 3}
        for name, (dtype, dimensions) in ARRAYS.items():
            given, names = getattr(self, name), dimensions.split()
            lengths = [known.setdefault(*one) for one in zip(names, given.shape, strict=False)]
            if given.dtype != dtype or given.ndim != len(names) or list(given.shape) != lengths:
                raise InputError(f"{name}: expected {dtype} ({dimensions}), got {given.dtype} {given.shape}")


def owner_nodes(parents: RowIds, nodes: Flags) -> Indices:
    """Return for each node itself or the lowest of `nodes` above it, -1 for none."""
    up = np.append(np.where(nodes, np.arange(len(parents)), parents), -1)
    while (up != (further := up[up])).any():
        up = further
    return np.asarray(up[:-1])


def with_those_below(parents: RowIds, values: np.ndarray) -> np.ndarray:
    """Return each node's value and those of all nodes below it, added up; children come before their parents."""
    sums = values.tolist()
    for node, parent in enumerate(parents.tolist()):
        if parent >= 0:
            sums[parent] += sums[node]
    return np.array(sums, values.dtype)


def by_number(numbers: OtherIds, count: int) -> tuple[OtherIndices, Indices]:
    """Return the places of numbers in the order of these, and where those of 0, 1, ... `count` begin."""
    order = np.argsort(numbers, kind="stable")
    return order, np.searchsorted(numbers[order], np.arange(count + 1))


def check_forest(node_of: OtherIds, parents: Ids, levels: ByteValues) -> None:
    """Check that nodes stand after all that is in them, and that levels grow on the way up.

    Raises: InputError.
    """
    count = len(parents)
    _check_all((node_of >= -1) & (node_of < count), f"node_of: expected one of {count} nodes, or -1")
    own = np.arange(count)
    _check_all(((parents > own) | (parents == -1)) & (parents < count), "parents: expected a later node, or -1")
    _check_all(levels <= GROUP, "levels: expected 0 (part), 1 (thing) or 2 (group)")
    child = parents >= 0
    lower, upper = levels[child], levels[parents[child]]
    _check_all(
        (upper >= lower) & ((upper != THING) | (lower != THING)), "levels: expected parts below things below groups"
    )


def _check_all(fine: Bool[np.ndarray, "..."], message: str) -> None:
    if not fine.all():
        raise InputError(f"{message}; not so at {np.argwhere(~fine)[0].tolist()}")


def _check_starts(name: str, starts: Indices, total: int, most: int) -> None:
    ends = len(starts) and starts[0] == 0 and starts[-1] == total
    lengths = np.diff(starts)
    if not ends or not ((lengths >= 0) & (lengths <= most)).all():
        raise InputError(f"{name}: starts of up to {most} each do not fit {total} entries")
