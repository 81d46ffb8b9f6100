"""Who cuts photos and who embeds pictures and words: SAM, CLIP and their like of other libraries, and the built-in
ones.

Other libraries are imported when a model is asked for.

Imports `encoders`, `masks`, `formats` and `kernels`.
"""
