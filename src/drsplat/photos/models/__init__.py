"""Models that cut photos and embed pictures and words: SAM, CLIP and similar ones, and the built-in ones.

Other libraries are imported when a model is loaded.
"""
