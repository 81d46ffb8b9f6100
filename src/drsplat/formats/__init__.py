"""Reading and writing other people's files: one small module per format, by header, never by position.

Imports `encoders`, `scene` and `masks`.
"""
