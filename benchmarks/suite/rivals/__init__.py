"""Other systems, from their papers, on the same Gaussians, masks and embeddings as ours; no code of theirs but gsplat.

`langsplat`, `legaussians` and `opengaussian` fit values of Gaussians by rendering them (`rasterising`); `things` are
rules that make objects of masks. `gsplat_training` trains through gsplat itself.
Occam's LGS and VALA are aggregators: `centre-pixel` and `vala` (`..aggregators`).
"""

LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN = "langsplat-m", "legaussians-m", "opengaussian"
FITTED = (LANGSPLAT, LEGAUSSIANS, OPENGAUSSIAN)
"""Rivals that are fitted; `fitting` makes them, and imports PyTorch."""
