"""Outlines of things in photos: how strong a border is at each pixel, as a small learned network sees it.

Begin with `regions.py`, which also makes a hierarchy of regions of what the network sees. `world/outlines/` learns
the network, from HED's edges of real photos and from made rooms.
"""

from .regions import identity, outlines, region_tree, shipped_outlines

__all__ = ["identity", "outlines", "region_tree", "shipped_outlines"]
