"""Photos to features on disk: which photos, which masks and which crops of them are embedded; resumable.

Imports `encoders`, `scene`, `masks`, `formats`, `codes`, `evidence`, `objects`, `registration` and `query`.
"""
