"""Masks of photos by level, the choice among them, their crops, and the features of a photo."""
