"""A small procedural household world with exact truth: things, rooms, cameras, photos, labels.

Used from a checkout only (`python -m world`); it is not part of the wheel. Order of the modules:
meshes, textures, looks, thing, things, rooms, cameras, engine, render, contours, layouts, crops.
"""
