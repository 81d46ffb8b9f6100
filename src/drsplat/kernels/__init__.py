"""The native core: arrays in, arrays out. A function of the same name in tests/twins is its slow float64 twin.

`cuda` does the same on a GPU. Begin with `splatting`, which registers and draws.

Imports `scene`.
"""

from .algebra import pq_encode, weighted_rows
from .regions import Forest, MergeRule, agglomerate
from .scan import (
    GroupedRows,
    QueryTables,
    Scanning,
    group_codes,
    lookup_tables,
    rows_of_groups,
    scan_above,
    scan_best,
    scan_scores,
    scan_top,
)
from .splats import (
    Contributions,
    Rendering,
    SplatArrays,
    Triples,
    available_isas,
    compiler,
    default_isa,
    splat_arrays_at_origin,
)
from .splatting import heaviest_labels, render_channels, sh_colors, splat_arrays, topk_contributions, view_weights

__all__ = [
    "Contributions",
    "Forest",
    "GroupedRows",
    "MergeRule",
    "QueryTables",
    "Rendering",
    "Scanning",
    "SplatArrays",
    "Triples",
    "agglomerate",
    "available_isas",
    "compiler",
    "default_isa",
    "group_codes",
    "heaviest_labels",
    "lookup_tables",
    "pq_encode",
    "render_channels",
    "rows_of_groups",
    "scan_above",
    "scan_best",
    "scan_scores",
    "scan_top",
    "sh_colors",
    "splat_arrays",
    "splat_arrays_at_origin",
    "topk_contributions",
    "view_weights",
    "weighted_rows",
]  # fmt: skip
