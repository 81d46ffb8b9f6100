"""Reading and writing other people's files: one small module per format, by header, never by position.

Begin with `scenes` and `captures`, which choose the reader of a file.

Imports `scene` and `kernels`.
"""
