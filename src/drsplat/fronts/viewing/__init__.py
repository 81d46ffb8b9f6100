"""Seeing a scene answer: what is shown, picked, painted and saved, apart from how a browser shows it.

`live` is what a browser talks to. Source: Dr. Splat Sec. F "Broader application".
"""
