"""The native core: arrays in, arrays out. `kernels.reference` is its slow float64 twin."""

from .splatting import (
    Contributions,
    Rendering,
    SplatArrays,
    Triples,
    available_isas,
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
    "render_channels",
    "sh_colors",
    "splat_arrays",
    "topk_contributions",
    "view_weights",
]
