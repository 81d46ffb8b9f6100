"""Features of photos on disk: the photos, masks and crops that are embedded; resumable.

Imports `encoders`, `scene`, `masks`, `formats`, `codes`, `evidence`, `objects`, `registration` and `query`.
"""
