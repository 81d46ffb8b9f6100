"""Captures of photos or a video: features, pairs and poses by COLMAP's package, and an upright world.

COLMAP runs in a process of its own (`worker.py`), which is the only module that imports it.
"""
