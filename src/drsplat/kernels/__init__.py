"""The native core: arrays in, arrays out. `kernels.reference` is its slow float64 twin."""

from .algebra import pq_encode, pq_scores, weighted_rows
from .splatting import (
    Contributions,
    Rendering,
    SplatArrays,
    Triples,
    available_isas,
    default_isa,
    render_channels,
    sh_colors,
    splat_arrays,
    topk_contributions,
    view_weights,
)

__all__ = [
    "Contributions",
    "Rendering",
    "SplatArrays",
    "Triples",
    "available_isas",
    "default_isa",
    "pq_encode",
    "pq_scores",
    "render_channels",
    "sh_colors",
    "splat_arrays",
    "topk_contributions",
    "view_weights",
    "weighted_rows",
]
