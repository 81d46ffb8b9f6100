"""Pictures for people: renderings of a scene, answers in colour, palettes, sheets.

Imports `scene`, `formats` and `kernels`.
"""
