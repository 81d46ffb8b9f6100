"""Pictures of a splat that has no photos: poses planned from the scene, renderings with these poses as a capture.

Imports `scene`, `formats`, `kernels`, `codes`, `drawing`, `filming` and `embedding`.
"""
