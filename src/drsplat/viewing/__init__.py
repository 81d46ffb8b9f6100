"""Seeing a scene answer: what is shown, picked, painted and saved, apart from how a browser shows it.

Only `window` and `catalogue_page` start viser. Source: Dr. Splat Sec. F "Broader application".

Imports `catalogue`, `editing`, `encoders`, `scene`, `formats`, `kernels`, `codes`, `evidence`, `field`, `models`,
`drawing`, `query` and `serving`.
"""
