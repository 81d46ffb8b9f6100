"""Photos to features on disk: the masks of each photo embedded, resumable.

Imports `encoders`, `scene`, `masks`, `formats`, `codes` and `query`.
"""
