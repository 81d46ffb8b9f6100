"""The slow float64 twins that the native kernels are held to, apart from what runs; only the training takes its
constants and its SSIM from here.

Imports `scene` and `kernels`.
"""
