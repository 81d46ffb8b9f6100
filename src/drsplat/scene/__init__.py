"""Parts of the world: Gaussians, posed views and their lenses, photos and their masks, boxes, units and frames.

What a mask and an encoder are is said here too, not what makes them. Begin with `gaussians` and `views`.

Imports nothing but base.
"""
