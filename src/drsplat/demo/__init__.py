"""Demo: a small scene in the package, searched in words and compared with its truth.

Imports `scene`, `formats`, `kernels`, `codes`, `field`, `objects`, `registration`, `models`, `drawing`, `query`,
`embedding` and `evaluation`.
"""
