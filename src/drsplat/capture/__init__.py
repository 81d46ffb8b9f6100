"""Photos or a video -> posed photos: features, pairs and poses by COLMAP's package, and a world that stands upright.

COLMAP runs in a process of its own (`worker.py`), which is the only module that imports it.

Imports `scene` and `formats`.
"""
