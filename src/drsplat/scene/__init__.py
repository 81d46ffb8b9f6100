"""What the world is made of: Gaussians, posed views and their lenses, photos, boxes, units and frames.

Imports errors, words for people and file contents; nothing that computes a weight or knows a mask.
"""
