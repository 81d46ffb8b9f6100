"""Parts of the world: Gaussians, posed views and their lenses, photos, boxes, units and frames.

Imports nothing but errors and words for people.
"""
