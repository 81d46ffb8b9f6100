"""Photos to features on disk: the masks of each photo embedded, resumable.

Imports `scene`, `masks`, `models`, `formats` and the list of words of `query`.
"""
