"""A small scene that ships, asked in words and held against its truth.

Imports `scene`, `formats`, `kernels`, `codes`, `field`, `registration`, `models`, `drawing`, `query`, `objects`, `embedding`
and `evaluation`.
"""
