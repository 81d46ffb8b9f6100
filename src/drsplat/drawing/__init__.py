"""Pictures for people: renderings of a scene, answers in colour, palettes, sheets.

Begin with `rendering`.

Imports `scene`, `formats` and `kernels`.
"""
