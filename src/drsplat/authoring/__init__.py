"""Things that people make of a scene: edits, films, files for other programs and libraries, photographs of a splat.

Each room is one of these, and none of them decides what a query means. Begin with `editing`.

Imports `scene`, `formats`, `kernels`, `field`, `photos`, `drawing` and `query`.
"""
