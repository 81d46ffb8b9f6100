"""Outlines of things in photos: how strong a border is at each pixel, as a small learned network sees it.

Begin with `network.py`. `world/outlines/` learns the network, from HED's edges of real photos and from made rooms.
"""

from .network import outlines, shipped_outlines

__all__ = ["outlines", "shipped_outlines"]
