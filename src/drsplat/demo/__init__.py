"""A small scene that ships, asked in words and held against its truth.

Imports `scene`, `formats`, `kernels`, `codes`, `field`, `objects`, `registration`, `models`, `drawing`, `query`,
`embedding` and `evaluation`.
"""
