"""Slow float64 twins that the native kernels are held to; constants that both need are written twice."""
