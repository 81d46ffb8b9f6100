"""The slow float64 twins that the native kernels are held to. Nothing that runs imports them, and what they share
with it, constants among it, is written twice.

Imports `scene` and `kernels`.
"""
