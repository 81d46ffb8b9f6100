"""Pictures for people: a scene rendered, an answer kept in colour, palettes, sheets.

Imports `scene`, `formats` and `kernels`.
"""
