"""Ground that everybody stands on: kinds of arrays, words for a terminal, progress, files and the system.

Nothing here knows of Gaussians. Begin with `arrays`.

Imports nothing but errors.
"""
