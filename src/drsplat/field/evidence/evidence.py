"""Evidence of a field: sparse weights, the masks behind them, and their embeddings."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...base.arrays import (
    Arrays,
    ArraysByName,
    Embedding,
    Embeddings,
    Ids,
    Indices,
    Numbers,
    OtherDoubles,
    OtherIndices,
    RowIds,
    Sparse,
    WholeNumbers,
)
from ...base.contents import release
from ...errors import FormatError, InputError
from ...formats.json_files import as_kind, document_in
from ...formats.tensors import check_tensors
from ...kernels import weighted_rows
from ...kernels.algebra import row_products

UNIT_TOLERANCE = 1e-3  # of an embedding's norm


class Explanation(NamedTuple):
    """Photo and mask behind an answer. share: its part of all positive support, (0, 1]."""

    view_name: str
    mask_id: int
    share: float


@dataclass(frozen=True, eq=False)
class MaskIds:
    """Columns of W. views: per column an index into view_names. ids: the mask in that view.

    times: when each view was taken, of a scene that moves; None of one that stands still. rendered_from: scene that the
    picture of each view is a rendering of, "" for photos (`View.rendered_from`); () where all are photos.

    Raises: InputError: shapes disagree, a column of no view, or times that are not finite.
    """

    view_names: tuple[str, ...]
    views: Ids
    ids: Ids
    times: OtherDoubles | None = None
    rendered_from: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, values in (("views", self.views), ("ids", self.ids)):
            if values.ndim != 1 or values.dtype != np.int32 or len(values) != len(self.views):
                raise InputError(f"masks: {name} must be int32 (M,), got {values.dtype} {values.shape}")
        if len(self.views) and not 0 <= self.views.min() <= self.views.max() < len(self.view_names):
            raise InputError(f"masks: a column names a view that is not among the {len(self.view_names)}")
        if self.times is not None and (
            self.times.shape != (len(self.view_names),) or not np.isfinite(self.times).all()
        ):
            raise InputError(f"masks: expected a finite time for each of {len(self.view_names)} views")
        if self.rendered_from and len(self.rendered_from) != len(self.view_names):
            raise InputError(f"masks: expected what each of {len(self.view_names)} views is a rendering of, or nothing")

    def __len__(self) -> int:
        return len(self.views)

    @property
    def sources(self) -> tuple[str, ...]:
        """`rendered_from` of every view."""
        return self.rendered_from or ("",) * len(self.view_names)

    def taken(self, views: Indices, columns: OtherIndices) -> "MaskIds":
        """Return some columns in this order, of some views in this order."""
        place = np.empty(len(self.view_names), np.int32)
        place[views] = np.arange(len(views), dtype=np.int32)
        names, sources = ([texts[view] for view in views] for texts in (self.view_names, self.sources))
        times, rendered = None if self.times is None else self.times[views], tuple(sources) if any(sources) else ()
        return MaskIds(tuple(names), place[self.views[columns]], self.ids[columns], times, rendered)


class Entries(NamedTuple):
    """Arrays of a sparse matrix by rows, named as in `scipy.sparse.csr_array`."""

    indptr: RowIds
    indices: WholeNumbers
    data: Numbers


@dataclass(frozen=True, eq=False)
class Evidence:
    """Sparse weights W (rows x M) with the masks of its columns and their unit embeddings.

    A row belongs to a Gaussian: all of them after registration, those with a feature in a field.

    Raises: InputError: shapes disagree, indices out of range, embeddings that are not unit vectors.
    """

    weights: Sparse
    masks: MaskIds
    embeddings: Embeddings

    def __post_init__(self) -> None:
        from scipy.sparse import csr_array

        weights = self.weights
        if not isinstance(weights, csr_array) or weights.dtype != np.float32:
            raise InputError("weights: expected a float32 scipy.sparse.csr_array")
        self._check(weights.shape[1])

    def _check(self, columns: int) -> None:
        embeddings, indices = self.embeddings, self.entries.indices
        if not embeddings.ndim == 2 or embeddings.dtype != np.float32:
            raise InputError(f"embeddings: expected float32 (M, D), got {embeddings.dtype} {embeddings.shape}")
        if not columns == len(self.masks) == len(embeddings):
            raise InputError(
                f"expected one mask and one embedding per column: {columns} columns, "
                f"{len(self.masks)} masks, {len(embeddings)} embeddings"
            )
        if len(indices) and not 0 <= indices.min() <= indices.max() < columns:
            raise InputError(f"weights: a column index is out of range ({columns} columns)")
        norms = np.sqrt(np.einsum("md,md->m", embeddings, embeddings))
        if not (np.abs(norms - 1) < UNIT_TOLERANCE).all():
            raise InputError("embeddings must be finite unit vectors: divide each row by its L2 norm")
        release(indices, embeddings)

    def __len__(self) -> int:
        return len(self.entries.indptr) - 1

    @property
    def entries(self) -> Entries:
        """Arrays of the weights; evidence of a file has them without loading SciPy."""
        weights = self.weights
        return Entries(weights.indptr, weights.indices, weights.data)

    @property
    def dim(self) -> int:
        return int(self.embeddings.shape[1])

    @property
    def num_seen(self) -> int:
        """Rows that any mask sees."""
        return int((np.diff(self.entries.indptr) > 0).sum())

    def check_weights(self) -> None:
        """Refuse bad weights. Raises: InputError: weights that are no numbers, infinite or negative."""
        data = self.entries.data
        if len(data) and not 0 <= data.min() <= data.max() < np.inf:  # NaN fails as well
            raise InputError("weights: expected finite numbers of 0 or more")

    def features(self, begin: int, end: int, *, threads: int = 0) -> Embeddings:
        """Return the weighted mean embedding of rows [begin, end), normalised; zero where there is none.

        Source: Dr. Splat Sec. A "Training stage".
        """
        return weighted_rows(*self.entries, self.embeddings, begin, end, threads=threads)

    def rows(self, index: WholeNumbers) -> "Evidence":
        """Return the evidence of some rows, in that order; weights are shared where only empty rows are dropped."""
        weights = self.weights
        lengths = np.diff(weights.indptr)[index]
        if (np.diff(index) > 0).all() and int(lengths.sum()) == weights.indptr[-1]:
            starts = np.append(weights.indptr[index], weights.indptr[-1])
            weights = csr_of(starts, weights.indices, weights.data, weights.shape[1])
        else:
            weights = weights[index]
        return Evidence(weights, self.masks, self.embeddings)

    def column_sums(self, rows: RowIds) -> Numbers:
        """Return the sum of W over some rows for each mask, added up row by row."""
        indptr, indices, data = self.entries
        lengths = indptr[rows + 1] - indptr[rows]
        at = np.arange(lengths.sum()) + np.repeat(indptr[rows + 1] - np.cumsum(lengths), lengths)
        sums = np.zeros(len(self.masks), np.float32)
        np.add.at(sums, indices[at], data[at])
        return sums

    def explain(self, row: int, query: Embedding, top: int = 5) -> list[Explanation]:
        """Return the photos and masks with the largest support W_ij <q, e_j> for `query` in a row.

        Only positive support is listed, so there may be fewer than `top`, or none.

        Raises: InputError: no such row, or a query of another dimension.
        """
        if not 0 <= row < len(self) or query.shape != (self.dim,):
            raise InputError(f"row {row} of {len(self)}, query {query.shape}: expected ({self.dim},)")
        indptr, indices, data = self.entries
        of_row = slice(indptr[row], indptr[row + 1])
        columns = indices[of_row]
        support = data[of_row] * row_products(self.embeddings[columns].astype(np.float64), query)
        total = support[support > 0].sum()
        order = np.argsort(-support, kind="stable")[:top]
        masks, best = self.masks, order[support[order] > 0]
        shown = zip(columns[best].tolist(), (support[best] / total).tolist(), strict=True)
        return [Explanation(masks.view_names[masks.views[j]], int(masks.ids[j]), share) for j, share in shown]

    def tensors(self) -> Arrays:
        """Return the arrays by name, as they are written to files; `metadata` holds the rest."""
        of_time = {} if self.masks.times is None else {"view_times": self.masks.times}
        return {
            **of_time,
            "indptr": self.weights.indptr,
            "indices": self.weights.indices,
            "data": self.weights.data,
            "embeddings": self.embeddings,
            "segment_views": self.masks.views,
            "segment_ids": self.masks.ids,
        }

    def metadata(self) -> dict[str, str]:
        """Return the texts of the file, beside its arrays: names and sources of the views."""
        rendered = self.masks.rendered_from
        more = {"rendered_from": json.dumps(rendered)} if rendered else {}
        return {"view_names": json.dumps(self.masks.view_names), **more}


class StoredEvidence(Evidence):
    """Evidence of a file, whose matrix is made on first access: a search needs no SciPy, which is slow to load."""

    @classmethod
    def of(cls, entries: Entries, masks: MaskIds, embeddings: Embeddings) -> "StoredEvidence":
        """Return the evidence of arrays whose row starts fit. Raises: InputError: as of `Evidence`."""
        evidence = cls.__new__(cls)
        evidence.__dict__.update(stored=entries, masks=masks, embeddings=embeddings)
        evidence._check(len(embeddings))
        return evidence

    @property
    def entries(self) -> Entries:
        return self.__dict__.get("stored") or super().entries

    @cached_property
    def weights(self) -> Sparse:  # type: ignore[override]
        return csr_of(*self.entries, len(self.embeddings))


def csr_of(starts: RowIds, indices: WholeNumbers, data: np.ndarray, columns: int) -> Sparse:
    """Return the matrix whose rows begin at `starts` among the entries.

    Starts get the type of most columns: SciPy gives both the wider one, and would make 12 bytes of 8.
    """
    from scipy.sparse import csr_array

    kind = np.int32 if starts[-1] < 1 << 31 else np.int64
    return csr_array((data, indices, starts.astype(kind, copy=False)), shape=(len(starts) - 1, columns))


_ARRAYS = {
    "indptr": ("int32 int64", "r"), "indices": ("int32 int64", "e"), "data": ("float32", "e"),
    "embeddings": ("float32", "m d"), "segment_views": ("int32", "m"), "segment_ids": ("int32", "m"),
}  # fmt: skip
_TIMES = {"view_times": ("float64", "v")}  # of scenes that move


def evidence_from_tensors(tensors: ArraysByName, metadata: Mapping[str, str], where: str) -> Evidence:
    """Return the evidence of a file's arrays without copying them: a memory map stays one.

    Raises: FormatError: an array is missing, of another type, or does not fit the others.
    """
    check_tensors(tensors, _ARRAYS | (_TIMES if "view_times" in tensors else {}), where)
    indptr, indices, data, embeddings, views, ids = (np.asarray(tensors[name]) for name in _ARRAYS)
    names, rendered = (
        as_kind(document_in(metadata.get(name, default), where), tuple[str, ...], f"{where}: {name}")
        for name, default in (("view_names", ""), ("rendered_from", "[]"))
    )
    try:
        check_starts(indptr, len(indices))
        masks = MaskIds(names, views, ids, tensors.get("view_times"), rendered)
        return StoredEvidence.of(Entries(indptr, indices, data), masks, embeddings)
    except ValueError as error:
        raise FormatError(f"{where}: {error}") from error


def check_starts(starts: RowIds, entries: int) -> None:
    """Refuse row starts that do not fit, of which SciPy would read where they point. Raises: InputError."""
    if not len(starts) or (starts[0], starts[-1]) != (0, entries) or (starts[1:] < starts[:-1]).any():
        raise InputError(f"row starts do not fit {entries} entries")
